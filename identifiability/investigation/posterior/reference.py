"""K, B and I with their noise: what every other model is evaluated against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.bounds import touching
from identifiability.inference.fitting import explore
from identifiability.inference.likelihood.estimate import Contender, Order, contenders
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.evidence import EVALUATIONS, Evaluator
from identifiability.investigation.posterior.noises import (
    Reference,
    Weighed,
    Weights,
    raw_residuals,
)
from identifiability.investigation.posterior.prior import joint_widths_of
from identifiability.joint.model import KBI

_ROUNDS, _SETTLED = 5, 1e-3
_ANYTHING = 0.5  # change of the inertia in one of the last two, from which it may be anything
_COARSE = 2048  # samples of a long record by which fits are begun
_BLINDS = 0.5  # share of what is left that is noise of the angle, where it hides the inertia


def evaluator_of(band: Band, values: Mapping[str, float], *, seed: int = 1) -> Evaluator:
    """Fit K, B and I with their noise, and make ready to evaluate other models.

    Parameters
    ----------
    band : Band
    values : mapping of str to float
        K, B and I to start from.
    seed : int
        Of the probes.

    Raises
    ------
    InputError
        Where noise of an imposed angle leaves no inertia to be seen.
    """
    angle = band.angle_imposed
    every = contenders(carried=(True,) if angle else (False, True))
    problem = band.problem(KBI())
    x, tried = problem.free_vector(values), every
    reference, shortlist = Reference.of(band, problem.complete(x)[:3], problem, seed), every

    def left_at(x: np.ndarray) -> tuple[Reference, list[np.ndarray], Weights]:
        here = replace(reference, joint=problem.complete(x)[:3])
        raw, _ = raw_residuals(problem, band, x)
        return here, raw, here.weights(raw, tried)

    def without_inertia() -> bool:
        return angle and bool(touching(x, problem.lower, problem.upper)[0][2])

    start, changes = x, [np.zeros(x.size)]
    for rounds in range(_ROUNDS):
        reference, raw, weights = left_at(x)
        weighed = Weighed(reference.probe_problem or problem, band, weights, True)
        before, x = x, explore(weighed, x[None], evaluations=2 * EVALUATIONS).values
        # The order is chosen at the start and once more, then kept.
        tried = every if rounds == 0 else weights.contenders[:1]
        if rounds <= 1:
            shortlist = weights.contenders
        if without_inertia() and weights.excess < _BLINDS * band.n_samples:
            # Not for noise of the angle: K, B and I are no picture of this joint, such as one whose
            # torque is recorded late. What they leave tells no colour of the noise.
            x, tried = start, every
            reference, raw, weights = left_at(x)
            shortlist = weights.contenders
            break
        larger = np.maximum(np.maximum(np.abs(x), np.abs(before)), 1e-300)
        changes.append(np.abs(x - before) / larger)
        if np.max(changes[-1]) < _SETTLED:
            break
    hidden = angle and weights.excess >= _BLINDS * band.n_samples
    if without_inertia() or (hidden and np.max(changes[-2:], axis=0)[2] > _ANYTHING):
        raise InputError(
            f"found no inertia that the trials agree on ({before[2]:.2g} kg m², then {x[2]:.2g}) "
            "once the noise's colour counts: the angle is too coarse for its acceleration; record "
            "it finer, or impose the torque"
        )
    widths = joint_widths_of(raw, band.scale)
    white = reference.weights(raw, [Contender(Order(0, 0, angle))])
    return Evaluator(reference, shortlist, widths, (weights, white), _coarse(band, values, seed))


def _coarse(band: Band, values: Mapping[str, float], seed: int) -> Evaluator | None:
    """What begins the fits of a long record; nothing where that has too few pieces."""
    fewer = replace(band, most=_COARSE)
    if band.most == _COARSE or fewer.n_samples > 0.5 * band.n_samples:
        return None
    try:
        return evaluator_of(fewer, values, seed=seed)
    except InputError:
        return None
