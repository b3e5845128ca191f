"""Modes of a posterior: the optima that starts of a fit ended in and that could hold mass."""

from __future__ import annotations

import numpy as np

from identifiability.inference.problem import Problem

# An optimum this far below the best, in log likelihood, holds no mass that matters.
_NEGLIGIBLE = 15.0
_APART, _LOWER = 0.02, 1e-2  # in the parameters' size, in log likelihood


def modes_of(
    problem: Problem, optimum: np.ndarray, local_optima: np.ndarray | None
) -> list[np.ndarray]:
    """Modes of the posterior, the best first.

    Parameters
    ----------
    problem : Problem
    optimum : array, shape (k,)
        Maximum of the posterior.
    local_optima : array, shape (n, k), or None
        Where starts of the fit ended.
    """
    modes = [optimum]
    top = float(problem.log_likelihood(optimum[None])[0])
    for point in [] if local_optima is None else local_optima:
        height = float(problem.log_likelihood(point[None])[0])
        size = np.maximum(np.abs(point), 1e-3)
        apart = all(np.max(np.abs(point - mode) / size) > _APART for mode in modes)
        if apart and top - _NEGLIGIBLE < height < top - _LOWER:
            modes.append(point)
    return modes
