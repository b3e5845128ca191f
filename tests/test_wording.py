"""Words that must not promise more than was found."""

from dataclasses import replace

import pytest

from identifiability.investigation.next_experiment import Design, Limits, NextExperiment
from identifiability.investigation.wording.certainty import in_words
from identifiability.joint.parameters import plus_minus

FOLLOWING = NextExperiment(
    ("series_tendon", "nonlinear_tendon"),
    Design("a step of 4 Nm", 4.0, 0.1, 4.0, 30.0),
    (),
    Limits(8.0, 0.1, 0.5),
    20.0,
)


@pytest.mark.parametrize(("evidence", "proposed"), [(30.0, True), (0.2, True), (0.01, False)])
def test_what_nobody_would_repeat_so_often_is_not_proposed(evidence, proposed):
    best = replace(FOLLOWING.best, expected_evidence=evidence)
    assert replace(FOLLOWING, best=best).proposed is proposed


def test_no_probability_is_worded_more_strongly_than_blind_cases_bear_out():
    """Nine of ten names were right there, whatever probability was stated."""
    assert in_words(0.9999).split(" (")[0] == in_words(0.92).split(" (")[0] == "very likely"
    words = [in_words(p).split(" (")[0] for p in (0.7, 0.5, 0.2, 0.01)]
    assert len({*words, "very likely"}) == 5


def test_what_a_fit_leaves_of_nothing_is_nothing():
    assert plus_minus(6.907e-31) == "0"
    assert plus_minus(-2e-13, 0.1) == "0.00 ± 0.10"
    assert plus_minus(6.6e-7) == "6.6e-07"
