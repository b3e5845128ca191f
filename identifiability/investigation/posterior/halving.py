"""Recordings without the upper half of their band, and models that are seen through that filter.

What is above the frequency to which an imposed angle is known is cut off, in both channels. A
linear model keeps its parameters then. A torque with corners, such as dry friction's, reaches
beyond that band: what it makes of the motion below is not what of the recorded torque is below.
Models that are not linear are given the whole motion, and their torque passes the same filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal
from scipy.ndimage import correlate1d

from identifiability.inference.problem import Observation, observe
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import imposed_motion
from identifiability.measurement.prepared import Prepared
from identifiability.measurement.trials import ends_in_motion, extended

_TAPS = signal.firwin(23, 0.5)
_REACH = _TAPS.size // 2

KEPT = float(np.sqrt(np.sum(_TAPS**2)))
"""Standard deviation that the filter leaves of white noise."""


def halve(values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Values without the upper half of their band; beyond the ends as the angle moves there."""
    return np.convolve(extended(values, _REACH, angle), _TAPS, mode="valid")


def halved(prepared: Prepared) -> tuple[Prepared, Prepared]:
    """A trial without the upper half of its band, and the same moved by the whole motion.

    Compared where the filter knew all it needed.
    """
    trial = prepared.trial
    angle = halve(trial.angle, trial.angle)
    # At a beginning at rest, which `prepared` shows by comparing it, the filter has no guess to do.
    at_rest = prepared.first < _REACH // 2 + 1
    whole = replace(
        prepared,
        response=halve(prepared.response, trial.angle),
        first=prepared.first if at_rest else max(prepared.first, _REACH),
        last=min(prepared.last, trial.n_samples - _REACH),
    )
    drive = imposed_motion(trial.time, angle)
    return replace(whole, trial=replace(trial, angle=angle), drive=drive), whole


@dataclass(frozen=True, eq=False)
class Window:
    """An observation of the whole motion; all that the filter needs of it is computed.

    Attributes
    ----------
    observation : Observation
        Its measured response has passed the filter already.
    first, last : int
        Of its samples that are compared, of which every other one is.
    turned : bool
        Whether what is before its trial is what follows, turned about the beginning: see
        `extended`.
    """

    observation: Observation
    first: int
    last: int
    turned: bool

    @classmethod
    def of(cls, whole: Prepared, piece: Observation, span: slice) -> Window:
        """Where a piece of a trial lies, of which the samples of a span are compared."""
        begin = span.stop - piece.measured.size
        end = min(span.stop + _REACH, whole.response.size)
        drive = replace(
            whole.drive,
            states=whole.drive.states[begin:end],
            impulses=whole.drive.impulses[begin:end],
        )
        first, last = span.start - begin, span.stop - begin
        needed = np.arange(_first_needed(first), end - begin)
        seen = observe(drive, whole.response[begin:end], Noise(1.0), select=needed)
        return cls(seen, first, last, ends_in_motion(whole.trial.angle, _REACH)[0])

    def compared(
        self, rows: np.ndarray, every: int, measured: np.ndarray | None = None
    ) -> np.ndarray:
        """What the filter leaves of residuals and their derivatives, shape (n, k).

        Parameters
        ----------
        rows : array, shape (n, k)
            The first column is the residual, or its difference from another.
        every : int
            One sample in so many is compared.
        measured : array, shape (n,), optional
            What the residual is of. It has passed the filter, and does not pass it again: only what
            the model makes of the motion does. None where all columns are differences.
        """
        n = self.observation.measured.size
        begin, end = _first_needed(self.first), min(self.last + _REACH, n)
        values = rows[begin:end].copy()
        if measured is not None:
            values[:, 0] += measured[begin:end]
        before = begin + _REACH - self.first
        beyond = np.repeat(values[:1], before, axis=0)
        if self.turned:
            beyond = 2 * beyond - values[before:0:-1]
        passed = correlate1d(np.concatenate([beyond, values]), _TAPS, axis=0)
        found = passed[_REACH : _REACH + self.last - self.first : every]
        if measured is not None:
            found[:, 0] -= measured[self.first : self.last : every]
        return found


def _first_needed(first: int) -> int:
    """First sample that the filter is given, of which this one is the first to be compared.

    That one itself where there are too few before it: these are the spline's loose end.
    """
    return first - _REACH if first >= _REACH else first


def without_level(columns: Sequence[np.ndarray], trial: np.ndarray) -> list[np.ndarray]:
    """Columns by stretch, of which each trial's level is unknown, without it."""
    n = 1 + int(trial[-1])
    totals, sizes = np.zeros((n, columns[0].shape[1])), np.zeros((n, 1))
    for number, one in zip(trial, columns, strict=True):
        totals[number] += one.sum(axis=0)
        sizes[number] += len(one)
    levels = totals / sizes
    return [one - levels[number] for number, one in zip(trial, columns, strict=True)]
