"""Every width of a fitted model's parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.problem import Problem
from identifiability.inference.widths import Widths, widths
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.pieces import owners
from identifiability.joint.scheme import Scheme
from identifiability.measurement.noise import correlation_time

_MOST_WORK = 3e6
"""Compared samples times parameters, and these once more for their derivatives, up to which widths
are profiled and sampled."""


def parameter_widths(bench: Workbench, candidate: Candidate, *, seed: int = 1) -> Widths:
    """Every width of a fitted model's parameters, as of K, B and I.

    The noise is the residual's, with its variance times its autocorrelation time.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
    seed : int

    Raises
    ------
    InputError
        Where a record is too long for them.
    """
    split = bench.split
    problem = bench.problem(
        candidate.model, split.fitted, refined=candidate.refined, scheme=candidate.scheme
    )
    samples = sum(int(np.count_nonzero(o.scale > 0)) for o in problem.observations)
    if samples * len(problem.names) ** 2 > _MOST_WORK:
        raise InputError(
            f"{samples} samples are too many to profile and to sample {len(problem.names)} "
            "parameters; the standard deviations that are given are those of the curvature"
        )
    noises = [
        float(np.sqrt(np.mean(left**2) * correlation_time(left - left.mean())))
        for left in candidate.fitted.by_trial
    ]
    sharpened = split.weights_sd(split.fitted) / np.maximum(noises, 1e-300)
    observations = [
        replace(o, scale=o.scale * sharpened[i])
        for o, i in zip(problem.observations, owners(problem.observations), strict=True)
    ]
    sharper = replace(problem, observations=observations)
    start = problem.free_vector(candidate.values)
    sharper = sharper.with_scheme(_scheme_about(sharper, start))
    return widths(sharper, starts=start[None], seed=seed, referee=False, quick=True)


def _scheme_about(problem: Problem, optimum: np.ndarray) -> Scheme:
    """The finest scheme that parameters within three standard errors of the optimum ask for."""
    if problem.integration.exact:
        return problem.integration
    jacobian = problem.jacobian(optimum)
    reach = 3 * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    scheme = problem.integration
    for sign in (-1, 1):
        for move in np.diag(sign * reach):
            place = np.clip(optimum + move, problem.lower, problem.upper)
            asked = problem.suited(problem.complete(place))
            scheme = asked if asked.is_finer_than(scheme) else scheme
    return scheme
