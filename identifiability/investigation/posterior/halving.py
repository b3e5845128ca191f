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
from identifiability.measurement.perturbations import Drive, imposed_motion
from identifiability.measurement.prepared import Prepared
from identifiability.measurement.trials import extended

_TAPS = signal.firwin(23, 0.5)
_REACH = _TAPS.size // 2
_LOOSE = 5  # samples at its end that a spline through an angle does not know well

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
    earlier : int
        Samples that it begins before the piece of the motion below the cut-off.
    first, last : int
        Of its samples that are compared, of which every other one is.
    """

    observation: Observation
    earlier: int
    first: int
    last: int

    @classmethod
    def of(cls, whole: Prepared, piece: Observation, span: slice) -> Window:
        """Where a piece of a trial lies, of which the samples of a span are compared."""
        # From before where the filter reaches back to, if need be before the trial.
        own = span.stop - piece.measured.size
        begin = min(own, span.start - _REACH - _LOOSE)
        end = min(span.stop + _REACH, whole.response.size)
        earlier, first, last = own - begin, span.start - begin, span.stop - begin
        drive, response = whole.drive, whole.response
        if begin < 0:
            drive = _begun_before(whole, -begin)
            response = np.concatenate([np.full(-begin, response[0]), response])
            begin, end = 0, end - begin
        drive = replace(drive, states=drive.states[begin:end], impulses=drive.impulses[begin:end])
        needed = np.arange(first - _REACH, end - begin)
        seen = observe(drive, response[begin:end], Noise(1.0), select=needed)
        return cls(seen, earlier, first, last)

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
        begin, end = self.first - _REACH, min(self.last + _REACH, n)
        values = rows[begin:end].copy()
        if measured is not None:
            values[:, 0] += measured[begin:end]
        passed = correlate1d(values, _TAPS, axis=0)
        found = passed[_REACH : _REACH + self.last - self.first : every]
        if measured is not None:
            found[:, 0] -= measured[self.first : self.last : every]
        return found


def _begun_before(whole: Prepared, n: int) -> Drive:
    """What moves a trial, with so many samples more before it: as the filter takes them to be.

    Were the torque taken to go on as at the first sample instead, so would the noise that it has of
    the angle, and what the spline makes of its loose end.
    """
    angle = extended(whole.drive.signals[:, 0], n, whole.trial.angle, within=_REACH)[:-n]
    return imposed_motion(whole.drive.interval * np.arange(angle.size), angle)


def without_level(columns: Sequence[np.ndarray], trial: np.ndarray) -> list[np.ndarray]:
    """Columns by stretch, of which each trial's level is unknown, without it."""
    n = 1 + int(trial[-1])
    totals, sizes = np.zeros((n, columns[0].shape[1])), np.zeros((n, 1))
    for number, one in zip(trial, columns, strict=True):
        totals[number] += one.sum(axis=0)
        sizes[number] += len(one)
    levels = totals / sizes
    return [one - levels[number] for number, one in zip(trial, columns, strict=True)]
