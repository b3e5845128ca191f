"""Best parameters of a problem: multistart bounded least squares, or the simplex of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.optimize

from identifiability.errors import InputError
from identifiability.inference.bounds import onto, size_of, strictly_inside, touching
from identifiability.inference.problem import Problem
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS


class LeastSquares(Protocol):
    """What `explore` asks of a problem: see `Problem`."""

    @property
    def model(self) -> Model:
        """The model."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the free parameters."""

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the free parameters."""

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals."""

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the whitened residuals."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit.

    Attributes
    ----------
    names : tuple of str
        Free parameters.
    values : array, shape (n_free,)
        The optimum.
    cost : float
        Half the sum of squared whitened residuals there.
    at_bound : tuple of str
        Parameters whose optimum lies on a bound of the prior.
    costs : array, shape (n_starts,)
        Cost reached from each start, infinite where a start failed.
    reached : array, shape (n_starts, n_free)
        Where each start ended: local optima.
    n_agreeing : int
        Number of starts that reached the best cost.
    method : str
    """

    names: tuple[str, ...]
    values: np.ndarray
    cost: float
    at_bound: tuple[str, ...]
    costs: np.ndarray
    reached: np.ndarray
    n_agreeing: int
    method: str

    def __getitem__(self, name: str) -> float:
        """Value of a parameter by name."""
        return float(self.values[self.names.index(name)])


def starting_points(problem: Problem, around: np.ndarray, n: int, seed: int) -> np.ndarray:
    """Starts: `around` itself, then log-uniform factors of up to five about it, inside the bounds.

    Parameters
    ----------
    problem : Problem
    around : array, shape (n_free,)
        The best guess.
    n : int
        Number of starts.
    seed : int

    Returns
    -------
    array, shape (n, n_free)
    """
    around = np.asarray(around, float)
    factors = 5.0 ** np.random.default_rng(seed).uniform(-1, 1, (n, around.size))
    factors[0] = 1.0
    return inside(problem, around * factors)


def fit(problem: Problem, starts: np.ndarray, *, polish: bool = True) -> Fit:
    """Fit by bounded least squares from every start, the best end by SciPy's again.

    By Levenberg-Marquardt steps where machine code takes them, else by SciPy (trust region
    reflective) from every start.

    Parameters
    ----------
    problem : Problem
    starts : array, shape (n_starts, n_free)
    polish : bool
        Whether to end with Newton steps on the full Hessian, which least squares, being built on
        the Gauss-Newton matrix, approaches only linearly where the residual does not vanish.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        Where no start leads to a finite response.
    """
    starts = inside(problem, np.atleast_2d(starts))
    best, costs, failures = None, np.full(len(starts), np.inf), []
    reached = starts.copy()
    order: Sequence[int] = range(len(starts))
    solved = problem.solved(starts, np.ones(starts.shape[1], bool))
    if solved is not None:
        reached, costs = solved[0], 0.5 * solved[1][:, 0, 0]
        starts, order = inside(problem, reached), [int(np.argmin(costs))]
    for i in order:
        start = starts[i]
        try:
            result = scipy.optimize.least_squares(
                problem.residuals,
                start,
                jac=problem.jacobian,
                bounds=(problem.lower, problem.upper),
                x_scale=size_of(start),
                ftol=1e-12,
                xtol=1e-10,
                gtol=1e-12,
                max_nfev=200,
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            failures.append(str(error))
            continue
        costs[i], reached[i] = result.cost, result.x
        if best is None or result.cost < best.cost:
            best = result
    if best is None:
        raise InputError(f"no start gave a finite response ({failures[0]}); check data and bounds")
    values, cost = best.x, float(best.cost)
    if polish:
        values, cost = _newton(problem, values, cost)
    return _finish(problem, values, cost, costs, reached, "least squares")


def explore(
    problem: LeastSquares,
    starts: np.ndarray,
    *,
    evaluations: int,
    further: int = 0,
    ftol: float = 1e-6,
) -> Fit:
    """Fit by bounded least squares with a limited number of evaluations from every start.

    A stiffness whose effect vanishes as it grows without bound is sought by its inverse, in which
    its ridge with K and B is nearly straight.

    Parameters
    ----------
    problem : LeastSquares
        Such as a `Problem`.
    starts : array, shape (n_starts, n_free)
    evaluations : int
        Most evaluations from one start.
    further : int
        Most evaluations more for each of the best two ends that are no optimum yet.
    ftol : float
        Relative change of the cost from which on a fit is at its end; a tenth of it at the ends
        that are carried on.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        Where no start leads to a finite response.
    """
    starts = inside(problem, np.atleast_2d(starts))
    endless = np.array([problem.model.parameters[name].endless for name in problem.names])
    stiff = endless & (problem.lower > 0)

    def turned(x: np.ndarray) -> np.ndarray:
        return np.where(stiff, 1 / np.where(stiff, x, 1.0), x)

    ends = np.sort([turned(problem.lower), turned(problem.upper)], axis=0)

    def descend(
        start: np.ndarray, most: int = evaluations, tight: float = 1.0
    ) -> tuple[float, np.ndarray, str, bool]:
        def jacobian(y: np.ndarray) -> np.ndarray:
            return problem.jacobian(turned(y)) * np.where(stiff, -(turned(y) ** 2), 1.0)

        try:
            result = scipy.optimize.least_squares(
                lambda y: problem.residuals(turned(y)),
                np.clip(turned(start), *ends),
                jac=jacobian,
                bounds=ends,
                x_scale="jac",
                ftol=ftol * tight,
                xtol=1e-7 * tight,
                gtol=1e-10,
                max_nfev=most,
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            return np.inf, start, str(error), True
        return float(result.cost), turned(result.x), "", result.status > 0

    problem.residuals(starts[0])  # compiled once, before the threads ask for it
    with ThreadPoolExecutor(THREADS) as pool:
        reports = list(pool.map(descend, starts))
        order = np.argsort([r[0] for r in reports], kind="stable")
        undone = [int(i) for i in order[:2] if not reports[i][3]] if further else []
        more = pool.map(lambda i: descend(reports[i][1], further, 0.1), undone)
        for i, report in zip(undone, list(more), strict=True):
            reports[i] = report if report[0] <= reports[i][0] else reports[i]
    costs, reached = np.array([r[0] for r in reports]), np.array([r[1] for r in reports])
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        failure = next(r[2] for r in reversed(reports) if r[2])
        raise InputError(f"no start gave a finite response ({failure}); check data and bounds")
    values = _onto_bounds(problem, reached[best])
    return _finish(problem, values, float(costs[best]), costs, reached, "least squares")


def fit_simplex(
    problem: Problem, starts: np.ndarray, *, xatol: float = 1e-4, fatol: float = 1e-4
) -> Fit:
    """Fit by the Nelder-Mead simplex, as the paper did, from every start.

    Parameters
    ----------
    problem : Problem
    starts : array, shape (n_starts, n_free)
    xatol, fatol : float
        Tolerances on parameters and cost; the defaults are those of MATLAB's ``fminsearch``.

    Returns
    -------
    Fit
    """
    starts = inside(problem, np.atleast_2d(starts))

    def cost(x: np.ndarray) -> float:
        return float(0.5 * np.sum(problem.residuals(x) ** 2))

    bounds = scipy.optimize.Bounds(problem.lower, problem.upper)
    most = 200 * starts.shape[1]  # iterations and evaluations, fminsearch's default too
    options = {"xatol": xatol, "fatol": fatol, "maxiter": most, "maxfev": most}
    results = [
        scipy.optimize.minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options)
        for start in starts
    ]
    costs = np.array([r.fun for r in results])
    best = results[int(np.argmin(costs))]
    reached = np.array([r.x for r in results])
    return _finish(problem, best.x, float(best.fun), costs, reached, "Nelder-Mead")


def at_bounds(problem: LeastSquares, values: np.ndarray) -> tuple[str, ...]:
    """Names of the free parameters that lie on a bound, to within 1e-6 of their size."""
    at_lower, at_upper = touching(values, problem.lower, problem.upper)
    on = at_lower | at_upper
    return tuple(name for name, is_on in zip(problem.names, on, strict=True) if is_on)


def inside(problem: LeastSquares, points: np.ndarray) -> np.ndarray:
    """Points moved strictly inside the problem's bounds."""
    return strictly_inside(points, problem.lower, problem.upper)


def _onto_bounds(problem: LeastSquares, x: np.ndarray) -> np.ndarray:
    """The same point, on the bounds that it is pushed to and all but touches.

    All but touches: within a thousandth of its slice width, where the cost hardly differs.
    """
    residuals, jacobian = problem.residuals(x), problem.jacobian(x)
    gradient = jacobian.T @ residuals
    with np.errstate(divide="ignore"):
        near = 1e-3 / np.linalg.norm(jacobian, axis=0)
    at_lower, at_upper = touching(x, problem.lower, problem.upper, near)
    pushed = at_lower & (gradient > 0), at_upper & (gradient < 0)
    return onto(x, problem.lower, problem.upper, pushed)


def _newton(
    problem: Problem, x: np.ndarray, cost: float, steps: int = 8
) -> tuple[np.ndarray, float]:
    """Newton steps within the face of active bounds, kept only while they lower the cost."""
    for _ in range(steps):
        residuals, jacobian = problem.residuals(x), problem.jacobian(x)
        gradient, hessian = jacobian.T @ residuals, problem.hessian(x)
        size = size_of(x)
        at_lower, at_upper = touching(x, problem.lower, problem.upper)
        pinned = at_lower & (gradient > 0), at_upper & (gradient < 0)
        # What the reflective method leaves a hair inside a bound belongs on it.
        x = onto(x, problem.lower, problem.upper, pinned)
        free = ~(pinned[0] | pinned[1])
        if not free.any():
            break
        scaled = hessian[np.ix_(free, free)] * np.outer(size[free], size[free])
        if np.linalg.eigvalsh(scaled)[0] <= 0:
            break
        move = np.zeros_like(x)
        move[free] = -size[free] * np.linalg.solve(scaled, size[free] * gradient[free])
        trial = np.clip(x + move, problem.lower, problem.upper)
        trial_cost = float(0.5 * np.sum(problem.residuals(trial) ** 2))
        if not trial_cost <= cost:
            break
        x, cost = trial, trial_cost
        if np.max(np.abs(move) / size) < 1e-10:
            break
    return x, float(0.5 * np.sum(problem.residuals(x) ** 2))


def _finish(
    problem: LeastSquares,
    values: np.ndarray,
    cost: float,
    costs: np.ndarray,
    reached: np.ndarray,
    method: str,
) -> Fit:
    agreeing = int(np.sum(costs <= cost * (1 + 1e-3) + 1e-14))
    bounds = at_bounds(problem, values)
    return Fit(problem.names, values, cost, bounds, costs, reached, agreeing, method)
