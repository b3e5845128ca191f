"""Posterior moments by deterministic integration in up to three dimensions: the samplers' referee.

The integral is nested. The range of the first parameter comes from its profile, that of the second
from its profile with the first held, that of the third from its curvature with both held; each is
cut at the prior's bounds and filled with Gauss-Legendre nodes. So nodes follow the ridge of the
posterior, however narrow or bent, while its cuts at the bounds stay on the ends of intervals,
where they do no harm to the rule's convergence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.conditional import conditional_optima
from identifiability.inference.modes import modes_of
from identifiability.inference.problem import Problem
from identifiability.inference.profiles import reach

_DROP = 16.0  # what lies beyond weighs e^-16 = 1e-7
# Nodes a dimension, rule after rule, until the standard deviations stay what they are.
_NODES = {
    1: ((24,), (32,), (64,)),
    2: ((18, 14), (24, 18), (48, 32)),
    3: ((14, 12, 11), (18, 15, 14), (28, 22, 19), (40, 28, 22)),
}
_SETTLED = 0.02  # change by the finer rule, which by itself is ten times nearer and more
_ROUGH = 0.03  # log likelihood that optima may lack from which ranges are laid out
# An end is found where the density has fallen by the drop, or by half as much again, in so many
# looks, of which each goes a little beyond.
_LOOKS, _AMPLE, _BEYOND = 8, 1.6, 1.05


@dataclass(frozen=True, eq=False)
class Moments:
    """Posterior moments.

    Attributes
    ----------
    names : tuple of str
    mean, sd : array, shape (k,)
    covariance : array, shape (k, k)
    log_evidence : float
        Log of the integral of likelihood times prior (NaN for an unbounded prior); the likelihood
        is that of ``Problem.log_likelihood``, without its normalisation.
    error : float
        Largest relative change of the standard deviations against a coarser rule.
    n_evaluations : int
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    error: float
    n_evaluations: int


class _Part(NamedTuple):
    """Part of the range of the first parameter, and where its ridge begins."""

    ends: tuple[float, float]
    mode: np.ndarray


class _Integral(NamedTuple):
    """Log of an integral, and its moments."""

    log_mass: float
    mean: np.ndarray
    covariance: np.ndarray
    n_evaluations: int


def quadrature(
    problem: Problem,
    optimum: np.ndarray,
    *,
    local_optima: np.ndarray | None = None,
    refinement: float = 1.0,
) -> Moments:
    """Posterior moments by nested Gauss-Legendre quadrature.

    Parameters
    ----------
    problem : Problem
        With one to three free parameters.
    optimum : array, shape (k,)
    local_optima : array, shape (n, k), optional
        Where other starts of the fit ended: a mode that lies apart has nodes of its own.
    refinement : float
        Factor on the number of nodes per dimension.

    Returns
    -------
    Moments

    Raises
    ------
    InputError
        With more than three free parameters.
    """
    k = len(problem.names)
    if k not in _NODES:
        raise InputError(f"quadrature takes one to three free parameters, found {k}; fix some")
    parts = _parts(problem, modes_of(problem, np.asarray(optimum, float), local_optima))
    sd, error, evaluations = np.full(k, np.nan), np.inf, 0
    for rule in _NODES[k]:
        counts = [max(6, round(n * refinement)) for n in rule]
        before = sd
        whole = _together([_integrate(problem, part, counts) for part in parts])
        sd, evaluations = np.sqrt(np.diag(whole.covariance)), evaluations + whole.n_evaluations
        error = float(np.max(np.abs(sd / before - 1)))
        if error < _SETTLED:
            break
    volume = float(np.sum(np.log(problem.upper - problem.lower)))
    return Moments(
        problem.names,
        whole.mean,
        sd,
        whole.covariance,
        whole.log_mass - volume if np.isfinite(volume) else float("nan"),
        error,
        evaluations,
    )


def _parts(problem: Problem, modes: list[np.ndarray]) -> list[_Part]:
    """Range of the first parameter about each mode; where they meet, one range of the higher."""
    heights = problem.log_likelihood(np.array(modes))
    parts: list[_Part] = []
    for mode, height in zip(modes, heights, strict=True):
        low, high = reach(problem, mode, 0, _DROP - float(heights[0] - height), accuracy=_ROUGH)
        apart = [p for p in parts if p.ends[1] <= low or high <= p.ends[0]]
        met = [p for p in parts if p.ends[0] < high and low < p.ends[1]]
        ends = [(low, high), *(p.ends for p in met)]
        joined = min(e[0] for e in ends), max(e[1] for e in ends)
        parts = [*apart, _Part(joined, met[0].mode if met else mode)]
    return parts


def _together(parts: list[_Integral]) -> _Integral:
    """Integral over several parts."""
    logs = np.array([part.log_mass for part in parts])
    shares = np.exp(logs - logs.max())
    log_mass = float(logs.max() + np.log(shares.sum()))
    shares /= shares.sum()
    mean = np.sum([share * part.mean for share, part in zip(shares, parts, strict=True)], axis=0)
    covariance = np.zeros((mean.size, mean.size))
    for share, part in zip(shares, parts, strict=True):
        covariance += share * (part.covariance + np.outer(part.mean - mean, part.mean - mean))
    return _Integral(log_mass, mean, covariance, sum(part.n_evaluations for part in parts))


def _integrate(problem: Problem, part: _Part, counts: list[int]) -> _Integral:
    """Integral over a part, by a rule of so many nodes a dimension."""
    ends, optimum = part
    k = len(optimum)
    nodes, weights = _legendre(np.array(ends[:1]), np.array(ends[1:]), counts[0])
    points = np.broadcast_to(optimum, (counts[0], k)).copy()
    points[:, 0] = nodes[0]
    log_weights = np.log(weights[0])
    top = float(problem.log_likelihood(optimum[None])[0])
    for held in range(1, k):
        solved = conditional_optima(problem, tuple(range(held)), points, accuracy=_ROUGH)
        # A start that failed must not lose its node: the optimum itself is another.
        alive = solved.log_likelihood > top - _DROP - 8
        points, log_weights = solved.points[alive], log_weights[alive]
        distances = _fall(problem, solved, alive, held)
        lower = np.maximum(points[:, held] - distances[0], problem.lower[held])
        upper = np.minimum(points[:, held] + distances[1], problem.upper[held])
        nodes, weights = _legendre(lower, upper, counts[held])
        # Later parameters start on the ridge that the curvature predicts.
        spread = np.repeat(points, counts[held], axis=0)
        moved = nodes.ravel() - spread[:, held]
        spread[:, held] = nodes.ravel()
        later = list(range(held + 1, k))
        if later:
            information = solved.information[alive]
            slope = np.linalg.solve(
                information[:, later][:, :, later] + 1e-300 * np.eye(len(later)),
                -information[:, later, held, None],
            )[:, :, 0]
            spread[:, later] += np.repeat(slope, counts[held], axis=0) * moved[:, None]
        points = spread
        log_weights = np.repeat(log_weights, counts[held]) + np.log(weights.ravel())
    log_density = problem.log_likelihood(points)
    total = log_density + log_weights
    shift = total.max()
    mass = np.exp(total - shift)
    norm = mass.sum()
    mean = mass @ points / norm
    centred = points - mean
    covariance = (mass[:, None] * centred).T @ centred / norm
    return _Integral(float(np.log(norm) + shift), mean, covariance, len(points))


def _fall(
    problem: Problem, solved: tuple[np.ndarray, ...], alive: np.ndarray, index: int
) -> np.ndarray:
    """Distances below and above the conditional optimum at which the density has fallen away.

    First from gradient and curvature, g d + d²/(2 s²) = drop, with the later parameters free to
    follow; then the density there is looked at and the distance stretched until it has fallen.

    Returns
    -------
    array, shape (2, n)
    """
    points, tops, gradient, information = (np.asarray(a)[alive] for a in solved)
    free = list(range(index, points.shape[1]))
    block = information[:, free][:, :, free]
    size = np.sqrt(np.clip(np.einsum("nii->ni", block), 1e-300, None))
    scaled = block / (size[:, :, None] * size[:, None, :])
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    variance = np.maximum(inverse[:, 0, 0], 1e-12) / size[:, 0] ** 2
    slope = gradient[:, index]
    distances = np.empty((2, len(points)))
    for side, sign in enumerate((-1, 1)):
        rise = np.maximum(sign * slope, 0.0)
        distance = variance * (-rise + np.sqrt(rise**2 + 2 * _DROP / variance))
        bound = (problem.lower if sign < 0 else problem.upper)[index]
        room = np.abs(bound - points[:, index])
        distance = np.minimum(np.maximum(distance, 1e-12), np.where(room > 0, room, np.inf))
        settled = room <= 0
        for _ in range(_LOOKS):
            asked = np.flatnonzero(~settled)
            if not asked.size:
                break
            moved = points[asked].copy()
            moved[:, index] += sign * distance[asked]
            if index == moved.shape[1] - 1:
                fallen = problem.log_likelihood(moved)
            else:
                held = tuple(range(index + 1))
                found = conditional_optima(problem, held, moved, accuracy=_ROUGH)
                fallen = found.log_likelihood
            drop = np.maximum(tops[asked] - fallen, 1e-3)
            # A parabola's drop grows with the square of the distance; more than enough is kept
            # where a parabola would stop short.
            factor = np.clip(np.sqrt(_DROP / drop), 0.5, 2.0)
            near = (drop >= _DROP) & (drop <= _AMPLE * _DROP)
            moved_to = np.minimum(distance[asked] * factor * _BEYOND, room[asked])
            at_bound = (distance[asked] == room[asked]) & (drop < _DROP)
            distance[asked] = np.where(near | at_bound, distance[asked], moved_to)
            settled[asked] = near | at_bound
        distances[side] = np.where(room > 0, distance, 0.0)
    return distances


_rule = cache(np.polynomial.legendre.leggauss)


def _legendre(lower: np.ndarray, upper: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on each interval, shape (n_intervals, n)."""
    x, w = _rule(n)
    half = 0.5 * np.maximum(upper - lower, 1e-300)
    return (0.5 * (lower + upper))[:, None] + half[:, None] * x, half[:, None] * w
