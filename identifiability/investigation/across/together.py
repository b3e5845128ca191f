"""One model fitted to several records together, some of its parameters shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from identifiability.investigation.across.alone import FittedAlone, standard_deviations

_STARTS, _EVALUATIONS = 2, 100  # of a fit
_AT_BOUND = 1e-6  # relative distance from a bound that is none


@dataclass(frozen=True)
class Together:
    """All records, with some parameters shared.

    Attributes
    ----------
    values, sds : dict of str to float
        Of what is shared; what is at a bound has no standard deviation.
    chi_square : float
        What sharing costs.
    at_optimum : bool
        Whether the fit came to its end.
    """

    values: dict[str, float]
    sds: dict[str, float]
    chi_square: float
    at_optimum: bool


def fit_together(fits: Sequence[FittedAlone], shared: Sequence[str]) -> Together:
    """All records fitted together, in the noise of each, with some parameters shared."""
    names, n = fits[0].names, len(shared)
    common = [names.index(name) for name in shared]
    rest = [i for i in range(len(names)) if i not in common]
    size, ends = len(names), n + len(rest) * len(fits)
    places = []  # of each record's parameters among all unknowns
    for k in range(len(fits)):
        at = np.empty(size, int)
        at[common] = np.arange(n)
        at[rest] = n + len(rest) * k + np.arange(len(rest))
        places.append(at)

    def residuals(u: np.ndarray) -> np.ndarray:
        return np.concatenate([one.residuals(u[at]) for one, at in zip(fits, places, strict=True)])

    def jacobian(u: np.ndarray) -> np.ndarray:
        blocks = []
        for one, at in zip(fits, places, strict=True):
            own = one.jacobian(u[at])
            block = np.zeros((own.shape[0], ends))
            block[:, at] = own
            blocks.append(block)
        return np.concatenate(blocks)

    lower, upper = np.full(ends, -np.inf), np.full(ends, np.inf)
    for one, at in zip(fits, places, strict=True):
        low, high = one.bounds
        lower[at] = np.maximum(lower[at], low)
        upper[at] = np.minimum(upper[at], high)
    # From what is shared as each record has it, and from the middle of these.
    own = np.array([one.recorded(one.found.x) for one in fits])
    starts = []
    for middle in (*own, np.median(own, axis=0)):
        u = np.empty(ends)
        for x, at in zip(own, places, strict=True):
            u[at] = x
        u[:n] = middle[common]
        starts.append(u)
    inside = [np.clip(u, np.nextafter(lower, np.inf), np.nextafter(upper, -np.inf)) for u in starts]
    squares = [float(np.sum(residuals(u) ** 2)) for u in inside]
    tried = [
        optimize.least_squares(
            residuals, inside[i], jacobian, (lower, upper), x_scale="jac", max_nfev=_EVALUATIONS
        )
        for i in np.argsort(squares)[:_STARTS]
    ]
    best = min(tried, key=lambda one: one.cost)
    within = np.minimum(best.x - lower, upper - best.x)
    free = within > _AT_BOUND * np.maximum(np.abs(best.x), np.abs(best.x - within))
    sds = np.zeros(ends)  # what is at a bound has none
    sds[free] = standard_deviations(best.jac[:, free])
    lost = 2 * best.cost - sum(one.squares for one in fits)
    return Together(
        dict(zip(shared, map(float, best.x), strict=False)),
        dict(zip(shared, map(float, sds), strict=False)),
        max(0.0, float(lost)),
        best.status > 0,
    )
