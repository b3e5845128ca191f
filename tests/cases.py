"""A spread of settings, windows and readings, and their widths, worked out once a session.

All windows have 101 samples, whatever their length, so that one compilation serves them all.
"""

from dataclasses import dataclass
from functools import cache

from identifiability.inference.fitting import Fit, fit
from identifiability.inference.problem import Prior, Problem
from identifiability.inference.quadrature import Moments, quadrature
from identifiability.inference.widths import Widths, widths
from identifiability.joint.model import KBI
from identifiability.measurement.noise import Reading
from identifiability.measurement.perturbations import Impulse
from identifiability.study.setting import Setting, measured_problem

SAMPLES = 101


@dataclass(frozen=True)
class Case:
    """One fit of KBI to the impulse response of a musculoskeletal model."""

    K_CE: float
    B_CE: float
    K_SE: float
    window: float
    reading: Reading = "contour"
    bounded: bool = True
    dE: float = 1e-3

    @property
    def setting(self) -> Setting:
        return Setting(self.K_CE, self.B_CE, self.K_SE, 0.1)

    def __str__(self) -> str:
        bounds = "" if self.bounded else ", no bounds"
        values = f"{self.K_CE:g} {self.B_CE:g} {self.K_SE:g}"
        return f"{values}, {1000 * self.window:g} ms, {self.reading}{bounds}"


@cache
def problem_of(case: Case) -> Problem:
    return measured_problem(
        case.setting,
        Impulse(),
        case.window,
        reading=case.reading,
        dE=case.dE,
        rate=(SAMPLES - 1) / case.window,
        prior=None if case.bounded else Prior.unbounded(KBI()),
    )


@cache
def fit_of(case: Case) -> Fit:
    return fit(problem_of(case), case.setting.starts())


@cache
def moments_of(case: Case) -> Moments:
    best = fit_of(case)
    return quadrature(problem_of(case), best.values, local_optima=best.reached)


@cache
def widths_of(case: Case) -> Widths:
    return widths(problem_of(case), starts=case.setting.starts(), seed=seed_of(case))


def seed_of(case: Case) -> int:
    """A seed of its own for every case, the same in every session."""
    return sum(ord(letter) * (i + 1) for i, letter in enumerate(str(case)))


# Verdicts on K, B and I. In the energy reading the posterior is narrow, and the quadratic width
# holds unless a bound is near; in the contour reading it seldom does.
A, C, T = "agrees", "curved", "truncated"
SPREAD = {
    Case(32, 3.2, 100, 0.05): (T, T, T),
    Case(32, 3.2, 100, 0.1): (T, T, T),
    Case(10, 30, 50, 0.05): (T, T, T),
    Case(32, 3.2, 100, 0.003): ("non-identifiable", T, T),
    Case(50, 5, 250, 0.1): (C, C, C),
    Case(32, 3.2, 100, 0.05, "energy"): (T, T, T),
    Case(32, 3.2, 100, 0.1, "energy"): (A, A, A),
    Case(32, 3.2, 100, 0.2, "energy"): (A, A, A),
    Case(100, 16, 500, 0.2, "energy"): (A, A, A),
    Case(32, 10, 320, 0.1, "energy"): (A, A, A),
    Case(200, 30, 2000, 0.2, "energy"): (A, A, A),
}
