"""Posteriors that once defeated the sampler: a second optimum, and a box that holds little."""

import pytest

from identifiability.inference.widths import judge, widths
from identifiability.measurement.perturbations import Impulse
from identifiability.study.setting import Setting, measured_problem


@pytest.mark.parametrize(
    ("setting", "window"),
    [(Setting(96, 30, 960), 0.2), (Setting(10, 2, 20), 0.05)],
    ids=["second optimum", "little of the proposal within the bounds"],
)
def test_sampler_and_quadrature_agree(setting, window):
    problem = measured_problem(setting, Impulse(), window)
    result = widths(problem, starts=setting.starts(), seed=1)
    assert result.posterior.converged
    for row in result.rows:
        difference = abs(row.posterior_sd - row.quadrature_sd)
        assert difference < max(5 * row.posterior_sd_mcse, 0.03 * row.quadrature_sd)
        assert row.verdict != "not converged"


def test_a_contradiction_of_the_quadrature_is_not_passed_over():
    verdict, reason = judge(
        name="K",
        optimum=50.0,
        quadratic=2.0,
        posterior_sd=2.0,
        posterior_68=(48.0, 52.0),
        posterior_95=(46.08, 53.92),
        sides=("closed", "closed"),
        bounds=(0.0, 2000.0),
        pinned=(),
        at_bound=(),
        unmet=(),
        referee="sampling gives 2, quadrature 20",
    )
    assert (verdict, reason) == ("not converged", "sampling gives 2, quadrature 20")
