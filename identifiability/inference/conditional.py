"""Optima with some parameters held, for a whole batch of held values at once.

Profiles follow such optima, and the quadrature is laid along them: thousands of small problems,
which machine code solves in the time that SciPy needs for a few. Tests compare it with SciPy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.optimize

from identifiability.inference.evaluation import CONVERGED
from identifiability.inference.fitting import inside
from identifiability.inference.problem import Problem

_FEW_EVALUATIONS = 5


class Conditional(NamedTuple):
    """Optima of the free parameters that are not held.

    Attributes
    ----------
    points : array, shape (n, k)
        All free parameters, held ones included.
    log_likelihood : array, shape (n,)
    gradient : array, shape (n, k)
        Of the negative log likelihood.
    information : array, shape (n, k, k)
        J'J of the whitened residuals.
    """

    points: np.ndarray
    log_likelihood: np.ndarray
    gradient: np.ndarray
    information: np.ndarray


def conditional_optima(
    problem: Problem, held: tuple[int, ...], points: np.ndarray, *, accuracy: float = CONVERGED
) -> Conditional:
    """Maximise the likelihood over the parameters that are not held.

    Parameters
    ----------
    problem : Problem
    held : tuple of int
        Positions, among the free parameters, of those that keep their value in `points`.
    points : array, shape (n, k)
        Held values, and starts for the others.
    accuracy : float
        Log likelihood that an optimum may lack, about; SciPy, which solves what machine code does
        not know, keeps to its own.

    Returns
    -------
    Conditional
    """
    inside_bounds = np.clip(np.asarray(points, float), problem.lower, problem.upper)
    moves = np.array([i not in held for i in range(inside_bounds.shape[1])])
    solved = problem.solved(inside_bounds, moves, accuracy)
    if solved is None:
        return one_by_one(problem, held, points)
    found, products = solved
    return Conditional(found, -0.5 * products[:, 0, 0], products[:, 1:, 0], products[:, 1:, 1:])


def one_by_one(problem: Problem, held: tuple[int, ...], points: np.ndarray) -> Conditional:
    """The same as `conditional_optima`, by SciPy, to a thousandth of a unit of log likelihood.

    For few points and responses that take long, or that machine code does not know.
    """
    points = np.clip(np.asarray(points, float), problem.lower, problem.upper)
    n, k = points.shape
    rest = [i for i in range(k) if i not in held]
    found = Conditional(points.copy(), np.empty(n), np.empty((n, k)), np.empty((n, k, k)))
    for i, point in enumerate(inside(problem, points)):
        # What is held keeps its value even on a bound.
        point = np.where(np.isin(np.arange(k), held), points[i], point)

        def whole(moved: np.ndarray, point: np.ndarray = point) -> np.ndarray:
            full = point.copy()
            full[rest] = moved
            return full

        best = point
        if rest:
            solved = scipy.optimize.least_squares(
                lambda moved: problem.residuals(whole(moved)),
                point[rest],
                jac=lambda moved: problem.jacobian(whole(moved))[:, rest],
                bounds=(problem.lower[rest], problem.upper[rest]),
                x_scale="jac",
                ftol=1e-3 / max(problem.n_samples, 1),
                xtol=1e-9,
                gtol=1e-12,
                max_nfev=_FEW_EVALUATIONS,
            )
            best = whole(solved.x)
        white, jacobian = problem.residuals(best), problem.jacobian(best)
        found.points[i] = best
        found.log_likelihood[i] = -0.5 * white @ white
        found.gradient[i] = jacobian.T @ white
        found.information[i] = jacobian.T @ jacobian
    return found
