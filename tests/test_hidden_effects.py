"""The investigation against hidden effects of a simulator that shares no equation with it.

The quick tier: one case of each sort with fewer and shorter trials. The whole is
``identifiability benchmark investigation``.
"""

import pytest

from identifiability.benchmark.cases import hidden_cases
from identifiability.benchmark.run import score

QUICK = hidden_cases("quick", 1)
EVERY_TIME = ("white", "ar1", "coulomb_friction", "sensor_delay", "time_varying_stiffness")


@pytest.mark.parametrize(
    "spec",
    [
        pytest.param(
            spec,
            id=spec.name,
            marks=() if spec.name.rsplit("-", 1)[1] in EVERY_TIME else pytest.mark.long,
        )
        for spec in QUICK
    ],
)
def test_verdict(spec):
    found = score("quick", spec)
    assert not found.failure
    assert found.outcome in ("right", "right among others"), (found.verdict, found.named)


def test_the_score_does_not_forgive_a_wrong_name():
    """Negative control: the same verdict scored against another truth."""
    from identifiability.benchmark.score import outcome_of

    assert outcome_of("known", ("gravity",), "explained", [["coulomb_friction"]]) == "wrong"
    assert outcome_of("none", (), "explained", [["coulomb_friction"]]) == "wrong"
