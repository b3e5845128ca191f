"""Profile likelihood: how far a parameter can move when all others make up for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.inference.conditional import conditional_optima
from identifiability.inference.curvature import Curvature, curvature
from identifiability.inference.evaluation import CONVERGED
from identifiability.inference.problem import Problem

# Drops of the log likelihood at the ends of one parameter's 68.27 and 95 % intervals (chi²).
DROPS = {"68": 0.5, "95": 1.9207}
_REACH, _SHORT_REACH = 0.5 * 3.5**2, 0.5 * 2.5**2
_FIRST, _FIRST_SHORT = 4.0, 2.5  # quadratic widths that the first points reach
POINTS = 24

Side = Literal["closed", "bound", "open"]


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile of one parameter.

    Attributes
    ----------
    name : str
    values : array, shape (n,)
        Values at which it was held, ascending.
    drops : array, shape (n,)
        Optimum's log likelihood minus the best one there.
    paths : array, shape (n, k)
        All free parameters along the profile.
    intervals : dict of str to (float, float)
        Ends of the ``"68"`` and ``"95"`` % intervals.
    sides : dict of str to (Side, Side)
        For each interval how its lower and upper side end: ``"closed"`` by the likelihood, cut by
        the parameter's own ``"bound"``, or ``"open"``: never closed within the search.
    pinned : tuple of str
        Other parameters that sit on a bound somewhere within the 95 % interval.
    improved : bool
        Whether a better optimum than the fit's was met on the way.
    """

    name: str
    values: np.ndarray
    drops: np.ndarray
    paths: np.ndarray
    intervals: dict[str, tuple[float, float]]
    sides: dict[str, tuple[Side, Side]]
    pinned: tuple[str, ...]
    improved: bool

    @property
    def half_width(self) -> float:
        """Half the 68 % interval."""
        low, high = self.intervals["68"]
        return 0.5 * (high - low)


def profile(
    problem: Problem,
    optimum: np.ndarray,
    name: str,
    *,
    points: int = POINTS,
    shape: Curvature | None = None,
) -> Profile:
    """Profile of one free parameter around the optimum.

    Parameters
    ----------
    problem : Problem
    optimum : array, shape (k,)
    name : str
    points : int
        Number on each side. With fewer than 24 the ends of intervals are interpolated only.
    shape : Curvature, optional
        At the optimum, where it is known already.

    Returns
    -------
    Profile
    """
    index = problem.names.index(name)
    optimum = np.asarray(optimum, float)
    top = float(problem.log_likelihood(optimum[None])[0])
    if shape is None:
        shape = curvature(problem, optimum)
    paths, drops = [optimum[None]], [np.zeros(1)]
    ends: dict[str, list[tuple[float, Side]]] = {level: [] for level in DROPS}
    for direction in (-1, 1):
        side_paths, side_drops = _follow(
            problem,
            optimum,
            top,
            shape,
            index,
            direction,
            _REACH if points >= POINTS else _SHORT_REACH,
            points,
        )
        bound = (problem.lower if direction < 0 else problem.upper)[index]
        for level, drop in DROPS.items():
            ends[level].append(
                _end(
                    problem,
                    index,
                    top,
                    drop,
                    optimum,
                    side_paths,
                    side_drops,
                    bound,
                    rounds=2 if points >= POINTS else 0,
                )
            )
        paths.append(side_paths)
        drops.append(side_drops)
    path, drop_all = np.concatenate(paths), np.concatenate(drops)
    order = np.argsort(path[:, index], kind="stable")
    path, drop_all = path[order], drop_all[order]
    intervals = {level: (low[0], high[0]) for level, (low, high) in ends.items()}
    within = path[(path[:, index] >= intervals["95"][0]) & (path[:, index] <= intervals["95"][1])]
    on = np.any((within <= problem.lower) | (within >= problem.upper), axis=0)
    return Profile(
        name,
        path[:, index],
        drop_all,
        path,
        intervals,
        {level: (low[1], high[1]) for level, (low, high) in ends.items()},
        tuple(n for i, n in enumerate(problem.names) if on[i] and i != index),
        bool(drop_all.min() < -1e-3),
    )


def reach(
    problem: Problem, optimum: np.ndarray, index: int, drop: float, *, accuracy: float = CONVERGED
) -> tuple[float, float]:
    """Range of a parameter outside of which its profile lies more than `drop` below the optimum."""
    optimum = np.asarray(optimum, float)
    top = float(problem.log_likelihood(optimum[None])[0])
    shape = curvature(problem, optimum)
    limits = []
    for direction in (-1, 1):
        path, drops = _follow(
            problem, optimum, top, shape, index, direction, drop, accuracy=accuracy
        )
        bound = (problem.lower if direction < 0 else problem.upper)[index]
        limits.append(_end(problem, index, top, drop, optimum, path, drops, bound, rounds=0)[0])
    return limits[0], limits[1]


def _follow(
    problem: Problem,
    optimum: np.ndarray,
    top: float,
    shape: Curvature,
    index: int,
    direction: int,
    drop: float = _REACH,
    points: int = POINTS,
    accuracy: float = CONVERGED,
) -> tuple[np.ndarray, np.ndarray]:
    """Profile on one side, outwards, until it has fallen by `drop` or meets the bound."""
    bound = (problem.lower if direction < 0 else problem.upper)[index]
    information = shape.gauss_newton
    rest = [i for i in range(len(optimum)) if i != index]
    # Slope of the ridge, from the quadratic approximation.
    slope = np.zeros(len(optimum))
    slope[index] = 1.0
    if rest:
        slope[rest] = -np.linalg.lstsq(
            information[np.ix_(rest, rest)], information[rest, index], rcond=None
        )[0]
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(shape.covariance[index, index])
    if not np.isfinite(sd) or sd == 0:
        sd = max(abs(optimum[index]), 1e-3)
    span = abs(bound - optimum[index])
    if span == 0:
        return optimum[None].copy(), np.zeros(1)
    paths, drops = np.empty((0, len(optimum))), np.empty(0)
    first = _FIRST if points >= POINTS else _FIRST_SHORT
    start, near, far = optimum, 0.0, min(first * sd, span)
    for _ in range(12 if points >= POINTS else 3):
        # Denser near the optimum, where the intervals end.
        fractions = np.linspace(0, 1, points + 1)[1:] ** (1.5 if near == 0 else 1.0)
        distances = near + (far - near) * fractions
        values = optimum[index] + direction * distances
        if far == span:
            values[-1] = bound
        ridge = start + np.outer(values - start[index], slope)
        still = np.broadcast_to(start, ridge.shape).copy()
        still[:, index] = values
        ridge[:, index] = values
        tried = [ridge, still] if points >= POINTS else [ridge]
        solved = conditional_optima(problem, (index,), np.concatenate(tried), accuracy=accuracy)
        likelihoods = solved.log_likelihood.reshape(len(tried), -1)
        better = np.argmax(likelihoods, axis=0)
        found = solved.points.reshape(len(tried), len(values), -1)[better, np.arange(len(values))]
        paths = np.concatenate([paths, found])
        drops = np.concatenate([drops, top - likelihoods.max(axis=0)])
        if drops[-1] > drop or far == span:
            break
        start, near, far = found[-1], far, min(4 * far, span)
    return paths, drops


def _end(
    problem: Problem,
    index: int,
    top: float,
    drop: float,
    optimum: np.ndarray,
    path: np.ndarray,
    drops: np.ndarray,
    bound: float,
    rounds: int,
) -> tuple[float, Side]:
    """Where the profile has fallen by `drop`, by interpolation, then refined by solving again."""
    beyond = np.flatnonzero(drops > drop)
    if beyond.size == 0:
        at_bound = path[-1, index] == bound
        return float(path[-1, index]), "bound" if at_bound else "open"
    first = beyond[0]
    inner = path[first - 1] if first else optimum
    outer = path[first]
    low_drop, high_drop = (drops[first - 1] if first else 0.0), drops[first]
    for _ in range(rounds):
        fractions = np.linspace(0, 1, 10)[1:-1]
        between = inner + np.outer(fractions, outer - inner)
        solved = conditional_optima(problem, (index,), between)
        inside = np.concatenate([[low_drop], top - solved.log_likelihood, [high_drop]])
        points = np.concatenate([inner[None], solved.points, outer[None]])
        first = int(np.flatnonzero(inside > drop)[0])
        inner, outer = points[first - 1], points[first]
        low_drop, high_drop = inside[first - 1], inside[first]
    # Drops grow with the square of the distance, so interpolate in their root.
    roots = np.sqrt(np.clip([low_drop, drop, high_drop], 0, None))
    share = (roots[1] - roots[0]) / (roots[2] - roots[0]) if roots[2] > roots[0] else 1.0
    return float(inner[index] + share * (outer[index] - inner[index])), "closed"
