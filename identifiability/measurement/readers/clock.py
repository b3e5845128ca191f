"""An even clock for the samples of a file, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy import interpolate

from identifiability.errors import InputError
from identifiability.measurement.trials import FloatArray
from identifiability.measurement.units import Quantity

MAX_JITTER: Final = 0.05
"""Relative departure of a time step from the median one, up to which it is no late sample."""

RARELY: Final = 0.01
"""Share of the time steps that may be late or early by more, without being asked for."""

LONGEST_GAP: Final = 5.0
"""Time between two samples, in median steps, across which motion is interpolated."""

_CLOCK_ROUNDING: Final = 1e-3  # of a step: a time column that was printed with few digits
_FASTER: Final = 1.01  # than the file's own rate, that samples may be asked for


class Samples(NamedTuple):
    """Channels on an even clock, and what was done to them."""

    time: FloatArray
    torque: FloatArray
    angle: FloatArray
    notes: tuple[str, ...] = ()


def evenly(samples: Samples, rows: Sequence[int], resample: float | None = None) -> Samples:
    """Bring the channels to an even clock.

    One that was printed with few digits is taken as even. Where steps vary by less than
    `MAX_JITTER`, or a logger was late no more often than `RARELY`, the channels are interpolated to
    the median step, torque linearly and angle by monotone cubics (PCHIP).

    Parameters
    ----------
    samples : Samples
    rows : sequence of int
        Rows of the file that they come from.
    resample : float, optional
        Samples a second [Hz] to be interpolated to, or a multiple if the file has more, however
        often a logger was late.

    Raises
    ------
    InputError
        Where time does not increase, where the logger was late too often or for too long, or where
        more samples are asked for than there are.
    """
    time, steps = samples.time, np.diff(samples.time)
    backward = np.flatnonzero(steps <= 0.0)
    if backward.size:
        at = int(backward[0]) + 1
        raise InputError(
            f"row {rows[at]}: time must increase, but {time[at]:.9g} s comes after "
            f"{time[at - 1]:.9g} s"
        )
    if time.size < 3 or not np.isfinite(steps).all():
        return samples  # for Trial to refuse
    samples = _counted_from_zero(samples)
    time = samples.time
    step = float((time[-1] - time[0]) / steps.size)
    grid = float(time[0]) + step * np.arange(time.size, dtype=np.float64)
    departure = float(np.abs(time - grid).max()) / step
    if departure <= _CLOCK_ROUNDING and resample is None:
        note = (f"rounding of time undone (up to {departure:.1g} of a step)",)
        return samples._replace(time=grid, notes=samples.notes + note * (departure > 1e-6))
    typical = float(np.median(steps))
    varied = _check_steps(steps / typical, typical, rows, resample is not None)
    if resample is None:
        return _interpolated(samples, typical, varied)
    if not 0.0 < resample <= _FASTER / typical:
        raise InputError(
            f"{resample:g} Hz is asked for, but the file has {1 / typical:.6g} samples a second: "
            "resample to that or fewer"
        )
    # As finely as the file has them; what is to be left out needs a filter first.
    return _interpolated(samples, 1 / (resample * np.ceil(1 / (resample * typical) - 0.01)), varied)


def _counted_from_zero(samples: Samples) -> Samples:
    """Samples whose clock does not count so high that steps are lost in rounding."""
    time, start = samples.time, float(samples.time[0])
    if np.spacing(abs(start)) <= 1e-8 * (time[-1] - start) / (time.size - 1):
        return samples
    note = f"time counted from {start:.12g} s"
    return samples._replace(time=time - start, notes=(*samples.notes, note))


def _check_steps(ratio: FloatArray, typical: float, rows: Sequence[int], asked: bool) -> str:
    """How much the steps vary, in words; or why they vary too much.

    Parameters
    ----------
    ratio : array, shape (n - 1,)
        Steps over the median one.
    typical : float
        That one [s].
    rows : sequence of int
    asked : bool
        Whether resampling was asked for.
    """
    jitter = np.abs(ratio - 1.0)
    uneven = np.flatnonzero(jitter >= MAX_JITTER)
    if not uneven.size:
        return f"time steps varied by {100 * jitter.max():.2g} %"
    longest = int(np.argmax(ratio))
    found = f"the time step is {ratio[longest] * typical:.6g} s where {typical:.6g} s is usual"
    if ratio[longest] > LONGEST_GAP:
        raise InputError(
            f"row {rows[longest + 1]}: {found}, and motion is interpolated across no more than "
            f"{LONGEST_GAP:g} of these: cut the recording there"
        )
    often = f"{uneven.size} of {ratio.size} time steps differ by {100 * MAX_JITTER:g} % or more"
    if uneven.size > max(1.0, RARELY * ratio.size) and not asked:
        at = int(uneven[0])
        raise InputError(
            f"row {rows[at + 1]}: the time step is {ratio[at] * typical:.6g} s where "
            f"{typical:.6g} s is usual, and {often}: record with an even clock, or interpolate "
            f"with --resample {1 / typical:.3g} (resample={1 / typical:.3g} in Python)"
        )
    return f"{often}, the longest is {ratio[longest]:.3g} times the usual one"


def _interpolated(samples: Samples, step: float, varied: str) -> Samples:
    time = samples.time
    n_steps = int((time[-1] - time[0]) / step * (1.0 + 1e-12))
    grid = float(time[0]) + step * np.arange(n_steps + 1, dtype=np.float64)
    inside = np.minimum(grid, time[-1])
    note = f"resampled to {step:.9g} s (torque linear, angle PCHIP): {varied}"
    torque, angle = (
        between(inside, time, getattr(samples, quantity), quantity)
        for quantity in ("torque", "angle")
    )
    return Samples(grid, torque, angle, (*samples.notes, note))


def between(
    moments: FloatArray, time: FloatArray, values: FloatArray, quantity: Quantity
) -> FloatArray:
    """Values between their samples: torque by straight lines, angle by monotone cubics (PCHIP)."""
    if quantity == "torque":
        return np.interp(moments, time, values)
    return np.asarray(interpolate.PchipInterpolator(time, values)(moments))
