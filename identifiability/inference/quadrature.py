"""Posterior moments by deterministic integration in up to three dimensions: the samplers' referee.

The integral is nested. The range of the first parameter comes from its profile, that of the second
from its profile with the first held, that of the third from its curvature with both held; each is
cut at the prior's bounds and filled with Gauss-Legendre nodes. So nodes follow the ridge of the
posterior, however narrow or bent, while its cuts at the bounds stay on the ends of intervals,
where they do no harm to the rule's convergence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.conditional import conditional_optima
from identifiability.inference.problem import Problem
from identifiability.inference.profiles import reach

_DROP = 20.0  # what lies beyond weighs e^-20 = 2e-9
_NODES = {1: (64,), 2: (48, 32), 3: (40, 28, 22)}


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


def quadrature(problem: Problem, optimum: np.ndarray, *, refinement: float = 1.0) -> Moments:
    """Posterior moments by nested Gauss-Legendre quadrature.

    Parameters
    ----------
    problem : Problem
        With one to three free parameters and a posterior with one mode.
    optimum : array, shape (k,)
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
    optimum = np.asarray(optimum, float)
    counts = [max(8, round(n * refinement)) for n in _NODES[k]]
    coarse = _integrate(problem, optimum, [max(6, round(0.75 * n)) for n in counts])
    fine = _integrate(problem, optimum, counts)
    log_integral, mean, covariance, evaluations = fine
    sd, coarse_sd = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(coarse[2]))
    volume = float(np.sum(np.log(problem.upper - problem.lower)))
    return Moments(
        problem.names,
        mean,
        sd,
        covariance,
        log_integral - volume if np.isfinite(volume) else float("nan"),
        float(np.max(np.abs(sd / coarse_sd - 1))),
        evaluations + coarse[3],
    )


def _integrate(
    problem: Problem, optimum: np.ndarray, counts: list[int]
) -> tuple[float, np.ndarray, np.ndarray, int]:
    k = len(optimum)
    low, high = reach(problem, optimum, 0, _DROP)
    nodes, weights = _legendre(np.array([low]), np.array([high]), counts[0])
    points = np.broadcast_to(optimum, (counts[0], k)).copy()
    points[:, 0] = nodes[0]
    log_weights = np.log(weights[0])
    top = float(problem.log_likelihood(optimum[None])[0])
    for held in range(1, k):
        solved = conditional_optima(problem, tuple(range(held)), points)
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
    return float(np.log(norm) + shift), mean, covariance, len(points)


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
        for _ in range(20):
            short = (distance < room) & (room > 0)
            if not short.any():
                break
            moved = points[short].copy()
            moved[:, index] += sign * distance[short]
            if index == moved.shape[1] - 1:
                fallen = problem.log_likelihood(moved)
            else:
                fallen = conditional_optima(problem, tuple(range(index + 1)), moved).log_likelihood
            lacking = fallen > tops[short] - _DROP
            if not lacking.any():
                break
            where = np.flatnonzero(short)[lacking]
            distance[where] = np.minimum(1.5 * distance[where], room[where])
        distances[side] = np.where(room > 0, distance, 0.0)
    return distances


def _legendre(lower: np.ndarray, upper: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on each interval, shape (n_intervals, n)."""
    x, w = np.polynomial.legendre.leggauss(n)
    half = 0.5 * np.maximum(upper - lower, 1e-300)
    return (0.5 * (lower + upper))[:, None] + half[:, None] * x, half[:, None] * w
