"""How an imposed torque runs between its samples, as the response tells.

The joint feels the torque between the samples too. Straight lines lose (w h)²/12 of what a
frequency w has that is sampled at intervals h: a twentieth of a torque with nine samples a cycle,
which is more than many an effect. A curve through the samples loses next to nothing of it, but
overshoots where the torque has corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import explore
from identifiability.inference.noisy import fit_noisy
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.inference.starts import first_guess
from identifiability.joint.model import KBI
from identifiability.measurement.noise import Noise
from identifiability.measurement.prepared import Prepared

Between = Literal["auto", "straight", "smooth"]
"""How a torque runs between its samples; "auto": as the response tells."""

MATTERS = 1e-3
"""Share of the misfit that the difference is, below which it cannot be told."""

_MOST, _SETTLED = 4096, 0.25  # samples of a trial that are looked at; share not compared in motion
_EVALUATIONS, _FURTHER = 20, 40


def joined(prepared: Sequence[Prepared], between: Between = "auto") -> tuple[Prepared, ...]:
    """Trials with their torque straight or smooth between the samples, whichever is likelier.

    By K, B and I and their noise, fitted to them one way and the other: what passes for little by
    least squares may be many standard deviations in noise of another colour. Straight where the
    angle was imposed.

    Parameters
    ----------
    prepared : sequence of Prepared
    between : {"auto", "straight", "smooth"}
        Which, where that is known.
    """
    straight = tuple(prepared)
    if between == "straight" or straight[0].trial.driven == "angle":
        return straight
    if between == "smooth":
        return tuple(p.smooth() for p in straight)
    try:
        smooth = tuple(p.smooth() for p in straight)
        guess = first_guess([p.trial for p in straight], Prior.recorded(KBI()))
        starts = np.array([guess, guess * [3.0, 0.3, 1.0]])
        (lines, chosen), (curves, _) = _problem(straight), _problem(smooth)
        by_lines = explore(lines, starts, evaluations=_EVALUATIONS, further=_FURTHER).values
        left = lines.residuals(by_lines)
        differ = curves.residuals(by_lines) - left
        if differ @ differ < MATTERS**2 * (left @ left):
            return straight
        by_curves = explore(
            curves, by_lines[None], evaluations=_EVALUATIONS, further=_FURTHER
        ).values
        one, other = fit_noisy(lines, chosen, by_lines), fit_noisy(curves, chosen, by_curves)
    except (InputError, ValueError, np.linalg.LinAlgError):
        return straight  # nothing to be told by K, B and I; their fit says so
    return smooth if other.log_likelihood > one.log_likelihood else straight


def _problem(prepared: Sequence[Prepared]) -> tuple[Problem, list[list[np.ndarray]]]:
    """K, B and I of the beginning of each trial, and the samples that are compared."""
    observations, stretches = [], []
    for p in prepared:
        n = min(p.response.size, _MOST)
        drive = replace(p.drive, states=p.drive.states[:n], impulses=p.drive.impulses[:n])
        first = 0 if p.recorded_lead.n_samples else round(_SETTLED * n)
        chosen = np.arange(first, n)
        segment = np.zeros(chosen.size, int) if p.has_offset else None
        compared = observe(drive, p.response[:n], Noise(1.0), select=chosen, segment=segment)
        observations.append(compared)
        stretches.append([chosen])
    return Problem(KBI(), observations, Prior.recorded(KBI())), stretches
