"""How an imposed torque runs between its samples, as the response tells.

The joint feels the torque between the samples too. Straight lines lose (w h)²/12 of what a
frequency w has that is sampled at intervals h: a twentieth of a torque with nine samples a cycle,
which is more than many an effect. A curve through the samples loses next to nothing of it, but
overshoots where the torque has corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import explore
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.inference.starts import first_guess
from identifiability.joint.model import KBI
from identifiability.measurement.noise import Noise, correlation_time
from identifiability.measurement.prepared import Prepared

_MOST, _SETTLED = 4096, 0.25  # samples of a trial that are looked at; share not compared in motion
_MATTERS = 1e-3  # share of the misfit that the difference is, below which it cannot be told
_DECISIVE = 5.0  # nats: less may be an effect that K, B and I lack, which the curve mends a little
_EVALUATIONS, _FURTHER = 20, 40


def joined(prepared: Sequence[Prepared]) -> tuple[Prepared, ...]:
    """Trials with their torque straight or smooth between the samples, whichever fits better.

    By K, B and I fitted to them one way and the other. Straight, where that is not clearly worse,
    or where the angle was imposed.

    Parameters
    ----------
    prepared : sequence of Prepared
    """
    straight = tuple(prepared)
    if straight[0].trial.driven == "angle":
        return straight
    try:
        smooth = tuple(p.smooth() for p in straight)
        guess = first_guess([p.trial for p in straight], Prior.recorded(KBI()))
        starts = np.array([guess, guess * [3.0, 0.3, 1.0]])
        lines, curves = _problem(straight), _problem(smooth)
        by_lines = explore(lines, starts, evaluations=_EVALUATIONS, further=_FURTHER)
        left = lines.residuals(by_lines.values)
        differ = curves.residuals(by_lines.values) - left
        if differ @ differ < _MATTERS**2 * (left @ left):
            return straight
        by_curves = explore(
            curves, by_lines.values[None], evaluations=_EVALUATIONS, further=_FURTHER
        )
    except InputError:
        return straight  # nothing to be told by K, B and I; their fit says so
    pieces = [row[row != 0] for row in lines.by_observation(left)]
    worth = lines.n_samples / correlation_time(*pieces)
    gained = 0.5 * worth * np.log(by_lines.cost / by_curves.cost)
    return smooth if gained > _DECISIVE else straight


def _problem(prepared: Sequence[Prepared]) -> Problem:
    """K, B and I of the beginning of each trial, each weighing by its own energy."""
    observations = []
    for p in prepared:
        n = min(p.response.size, _MOST)
        drive = replace(p.drive, states=p.drive.states[:n], impulses=p.drive.impulses[:n])
        first = 0 if p.recorded_lead.n_samples else round(_SETTLED * n)
        chosen = np.arange(first, n)
        segment = np.zeros(chosen.size, int) if p.has_offset else None
        noise = Noise(float(np.std(p.response[:n])) or 1.0)
        observations.append(observe(drive, p.response[:n], noise, select=chosen, segment=segment))
    return Problem(KBI(), observations, Prior.recorded(KBI()))
