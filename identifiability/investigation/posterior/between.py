"""What a recording does not tell of an imposed motion between its samples.

Where a motion turns within a few samples, its acceleration is known no better than its samples
allow, and the torque folds what is faster back. How much that is shows when every other sample is
left out, one way and the other: at a corner of the acceleration the error is four times as large
then, and a third of what changes is what the recording itself is wrong by. It is noise of its own
size in every sample, the same for all models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import maximum_filter1d

from identifiability.measurement.perturbations import MOTION_DEGREE
from identifiability.measurement.prepared import Prepared
from identifiability.measurement.trials import Trial

_SHARE = 1 / 3  # of what changes: errors fall with the square of the interval
_FEWEST = 2 * (MOTION_DEGREE + 1)  # samples of which every other one still makes a spline
_AROUND = 3  # compared samples to either side over which an error spreads
_USUAL, _OFTEN = 2.0, 0.25  # times what changes in so many of the samples is noise at most


def left_out(trials: Sequence[Trial], first: int) -> list[Trial]:
    """Trials without every other sample, those that are left in their place.

    Parameters
    ----------
    trials : sequence of Trial
        As they were recorded.
    first : {0, 1}
        The first sample that is kept.
    """
    out = []
    for trial in trials:
        if trial.n_samples < _FEWEST:
            out.append(trial)
            continue
        channels = []
        for values in (trial.torque, trial.angle):
            kept = slice(first, None, 2)
            spline = make_interp_spline(trial.time[kept], values[kept], k=MOTION_DEGREE)
            inside = (trial.time >= trial.time[kept][0]) & (trial.time <= trial.time[kept][-1])
            channels.append(np.where(inside, spline(trial.time), values))
        out.append(replace(trial, torque=channels[0], angle=channels[1]))
    return out


def changes(prepared: Sequence[Prepared], others: Sequence[Prepared]) -> list[np.ndarray]:
    """What changes from some trials to others, one array by trial, shape (n, 4).

    Of the torque, and of the imposed angle and its two derivatives.
    """
    return [
        np.column_stack([q.response - p.response, (q.drive.states - p.drive.states)[:, :3]])
        for p, q in zip(prepared, others, strict=True)
    ]


def variances(
    changed: Sequence[Sequence[np.ndarray]], joint: np.ndarray, spans: Sequence[tuple[int, slice]]
) -> list[np.ndarray]:
    """Variance [Nm²] of what a joint's torque is wrong by at the compared samples.

    Parameters
    ----------
    changed : sequence of sequence of array
        What `changes` gave, without the even samples and without the odd ones.
    joint : array, shape (3,)
        K, B and I.
    spans : sequence of (int, slice)
        Of each stretch, its trial and its compared samples.
    """
    torque = np.concatenate([[1.0], -np.asarray(joint, float)])
    squares = []
    for trial, samples in spans:
        errors = [of_one[trial][samples] @ torque for of_one in changed]
        square = np.max([(e - np.median(e)) ** 2 for e in errors], axis=0)
        squares.append(maximum_filter1d(square, 2 * _AROUND + 1))
    usual = _USUAL**2 * float(np.quantile(np.concatenate(squares), _OFTEN))
    return [_SHARE**2 * np.maximum(square - usual, 0.0) for square in squares]
