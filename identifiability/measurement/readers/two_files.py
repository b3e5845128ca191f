"""Angle and torque of one trial from two files, at rates and on clocks of their own."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from identifiability.errors import InputError
from identifiability.measurement.readers.clock import Samples, between, evenly
from identifiability.measurement.readers.columns import checked, located
from identifiability.measurement.readers.tables import Columns, Options
from identifiability.measurement.readers.trial_file import (
    REVERSED,
    check_rate,
    clock_of,
    loaded,
    numbers,
    warn_of_sign,
)
from identifiability.measurement.trials import MIN_SAMPLES, FloatArray, Trial, thinned
from identifiability.measurement.units import Quantity

_SAME_RATE = 1e-3  # relative difference of two rates that count as one


@dataclass(frozen=True)
class ChannelFile:
    """A file that has one of the channels.

    Attributes
    ----------
    path : str or Path
        Of any format that `read_trial` reads.
    columns : mapping or None
        As for `read_trial`: where the channel is, and time. By default they are found by headers.
    variable : str or None
        In a file that holds several.
    rate : float or None
        Sampling rate [Hz], where there is no time column; time is then 0 at the first sample.
    """

    path: str | Path
    columns: Columns | None = None
    variable: str | None = None
    rate: float | None = None


@dataclass(frozen=True, eq=False)
class _Channel:
    """Samples of one quantity on an even clock."""

    time: FloatArray
    values: FloatArray
    source: str
    sha256: str
    notes: tuple[str, ...]

    @property
    def interval(self) -> float:
        return float(self.time[-1] - self.time[0]) / (self.time.size - 1)


def read_two_files(
    angle: ChannelFile,
    torque: ChannelFile,
    *,
    late: float = 0.0,
    restoring: bool = False,
    driven: Literal["torque", "angle"] = "torque",
    name: str | None = None,
) -> Trial:
    """Read one trial whose angle is in one file and whose torque is in another.

    Both are laid on one clock, that of the channel with fewer samples a second, where both were
    recorded; the other is thinned to it, freed of what would fold back. How late a clock is is not
    guessed from the channels: a joint that lags and a logger that is late look alike. Give what a
    shared trigger tells; what remains is the effect ``sensor_delay``.

    Parameters
    ----------
    angle, torque : ChannelFile
    late : float
        Seconds that the torque's clock shows less than the angle's at the same moment: they are
        added to it.
    restoring : bool
        The torque in the file is the joint's reaction: change its sign.
    driven : {"torque", "angle"}
        Which channel was imposed.
    name : str, optional
        Name of the trial, by default that of the angle's file without suffix.

    Returns
    -------
    Trial
        In SI units; its notes say how the two were laid together. Its SHA-256 is that of the two
        files' hashes, one after the other.

    Raises
    ------
    InputError
        If a file cannot be read, or both share less than three samples.
    """
    if not np.isfinite(late):
        raise InputError(f"the torque's clock is said to be late by {late} s, expected a number")
    moved, pushed = _channel(angle, "angle"), _channel(torque, "torque")
    pushed = replace(pushed, time=pushed.time + late)
    if restoring:
        pushed = replace(pushed, values=-pushed.values)
    try:
        time, angles, torques, note = _together(moved, pushed)
        notes = [f"torque from {pushed.source}", note]
        if late:
            notes.insert(1, f"its clock set {late:g} s later")
        if restoring:
            notes.append(REVERSED)
        trial = Trial(
            time,
            torques,
            angles,
            driven=driven,
            name=Path(angle.path).stem if name is None else name,
            source=f"{moved.source} + {pushed.source}",
            sha256=hashlib.sha256((moved.sha256 + pushed.sha256).encode()).hexdigest(),
            notes=(*moved.notes, *pushed.notes, *notes),
        )
    except InputError as error:
        raise InputError(f"{moved.source} and {pushed.source}: {error}") from None
    warn_of_sign(trial, restoring)
    return trial


def _channel(source: ChannelFile, quantity: Quantity) -> _Channel:
    """One quantity of a file, on an even clock of its own."""
    path, rate = Path(source.path), source.rate
    columns = None if source.columns is None else checked(source.columns, (quantity,))
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            table, sha256 = loaded(path, Options(source.variable, columns))
            if columns is None:
                columns = located(table, rate, (quantity,))
            found = numbers(table, columns)
            values = found[quantity]
            time = clock_of(found, values.size, rate)
            if time.size < MIN_SAMPLES:
                raise InputError(f"found {time.size} samples, expected {MIN_SAMPLES} or more")
            # Each of the two is interpolated in its own way: only that of the quantity is taken.
            samples = evenly(Samples(time, values, values, table.notes), table.rows)
            check_rate(found, rate)
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None
    values = samples.angle if quantity == "angle" else samples.torque
    return _Channel(samples.time, values, path.name, sha256, samples.notes)


def _together(angle: _Channel, torque: _Channel) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    """Time, angle and torque on the clock of the one with fewer samples, and what was done."""
    slow, fast = (angle, torque) if angle.interval >= torque.interval else (torque, angle)
    slack = 1e-6 * fast.interval
    start, stop = max(c.time[0] for c in (slow, fast)), min(c.time[-1] for c in (slow, fast))
    shared = np.flatnonzero((slow.time >= start - slack) & (slow.time <= stop + slack))
    if shared.size < MIN_SAMPLES:
        raise InputError(
            f"the angle was recorded from {angle.time[0]:g} to {angle.time[-1]:g} s and the torque "
            f"from {torque.time[0]:g} to {torque.time[-1]:g} s, with {shared.size} samples in "
            f"both, where {MIN_SAMPLES} are needed: say how late the torque's clock is "
            "(--torque-late)"
        )
    time, kept = slow.time[shared], slow.values[shared]
    ratio = slow.interval / fast.interval
    factor = 1 if ratio < 1 + _SAME_RATE else int(np.ceil(ratio * (1 - _SAME_RATE)))
    grid = time[0] + slow.interval / factor * np.arange((time.size - 1) * factor + 1)
    inside = np.clip(grid, fast.time[0], fast.time[-1])
    channel: Quantity = "angle" if fast is angle else "torque"
    finely = between(inside, fast.time, fast.values, channel)
    # Whether the joint rests at the ends is read from the angle.
    angle_finely = finely if fast is angle else np.interp(grid, time, kept)
    other = thinned(finely, factor, angle_finely)
    how = f"at {1 / slow.interval:.6g} Hz, from {time[0]:g} to {time[-1]:g} s"
    if factor > 1:
        how += f" ({channel} recorded at {1 / fast.interval:.6g} Hz, freed of what folds back)"
    if fast is angle:
        return time, other, kept, how
    return time, kept, other, how
