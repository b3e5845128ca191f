"""From a file to a trial, whatever its format: columns, units, sign, an even clock."""

from __future__ import annotations

import dataclasses
import hashlib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np
from scipy import interpolate

from identifiability.errors import InputError
from identifiability.measurement.filtering import HIGHEST_HZ
from identifiability.measurement.readers.columns import checked, located
from identifiability.measurement.readers.formats import READERS
from identifiability.measurement.readers.tables import Columns, Options, Table
from identifiability.measurement.trials import FloatArray, Trial
from identifiability.measurement.units import parse_unit

MAX_JITTER: Final = 0.05
"""Largest relative departure of a time step from the median one that is resampled away."""

_CLOCK_ROUNDING: Final = 1e-3  # of a step: a time column that was printed with few digits


def read_trial(
    path: str | Path,
    *,
    columns: Columns | None = None,
    variable: str | None = None,
    rate: float | None = None,
    restoring: bool = False,
    driven: Literal["torque", "angle"] = "torque",
    name: str | None = None,
) -> Trial:
    """Read one trial from a text file, a MATLAB file, or any format in `READERS`.

    Text files (.csv, .tsv, .txt, .dat) may be separated by comma, semicolon, tab or white space,
    with a decimal point or comma; lines that start with ``#`` are skipped. MATLAB files (.mat) may
    be of any version. Time steps that vary by less than 5 % are resampled to the median one,
    torque linearly and angle by monotone cubics (PCHIP), which the trial's notes tell.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : mapping, optional
        Quantity -> (column, unit), such as ``{"angle": (0, "rad"), "torque": (1, "Nm")}``. By
        default columns are found by headers that name quantity and unit, such as ``torque_Nm``,
        ``angle (deg)``, ``torque [N.m]`` or ``Time/s``. A header without a unit is never guessed.
    variable : str, optional
        In a MATLAB file, the matrix or the struct of vectors to read; needed where the file holds
        several.
    rate : float, optional
        Sampling rate (Hz), needed where there is no time column.
    restoring : bool
        The torque in the file is the joint's reaction: change its sign.
    driven : {"torque", "angle"}
        Which channel was imposed.
    name : str, optional
        Name of the trial, by default the file's name without suffix.

    Returns
    -------
    Trial
        In SI units, with the file's base name and SHA-256.

    Raises
    ------
    InputError
        If the file cannot be read as one trial; the sentence says what was found, and where.

    Warns
    -----
    UserWarning
        If the angle looks like degrees, or if an imposed angle met a torque of the wrong sign.
    """
    path = Path(path)
    wanted = None if columns is None else checked(columns)
    # Absurdly large numbers overflow quietly here and are then refused as not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            table, sha256 = _load(path, Options(variable, wanted))
            if wanted is None:
                wanted = located(table, rate)
            time, torque, angle, notes = _samples(table, wanted, rate)
            if restoring:
                torque = -torque
                notes = (*notes, "sign of torque changed (recorded as the joint's reaction)")
            trial = Trial(
                time,
                torque,
                angle,
                driven=driven,
                name=path.stem if name is None else name,
                source=path.name,
                sha256=sha256,
                notes=notes,
            )
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None
        _warn_of_sign(trial, restoring)
    return trial


def _load(path: Path, options: Options) -> tuple[Table, str]:
    if path.is_dir():
        raise InputError("this is a directory: give the path of one file")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"files with the suffix {path.suffix.lower()!r} are not read: give one of "
            f"{', '.join(READERS)}"
        )
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"there is no such file in {path.parent}: check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise InputError(f"the file cannot be opened: {error}") from None
    if not content:
        raise InputError("the file is empty (0 bytes)")
    return reader(path, options), hashlib.sha256(content).hexdigest()


_Samples = tuple[FloatArray, FloatArray, FloatArray, tuple[str, ...]]


def _samples(table: Table, columns: Columns, rate: float | None) -> _Samples:
    """Time, torque and angle in SI units on a uniform grid, and what was done to them."""
    if rate is not None and not 0.0 < rate < np.inf:
        raise InputError(f"the sampling rate is {rate} Hz, but must be above 0")
    places = {table.index(column) for column, _ in columns.values()}
    if len(places) < len(columns):
        raise InputError("one column is named for two quantities: name a column for each")
    values = {
        quantity: table.values(column) * parse_unit(unit, quantity)
        for quantity, (column, unit) in columns.items()
    }
    sizes = {quantity: v.size for quantity, v in values.items()}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{quantity} {size}" for quantity, size in sizes.items())
        raise InputError(f"the columns must be equally long, but their lengths are {found}")
    torque, angle = values["torque"], values["angle"]
    if "time" not in values:
        if rate is None:
            raise InputError(
                "there is no time column and no sampling rate: give the rate, such as --rate 1000, "
                "or the column of time, such as --columns time=0:s"
            )
        return np.arange(torque.size, dtype=np.float64) / rate, torque, angle, table.notes
    time, torque, angle, notes = _evenly(values["time"], torque, angle, table.rows)
    if rate is not None and time.size > 1:
        found_rate = (time.size - 1) / (time[-1] - time[0])
        if not abs(found_rate / rate - 1.0) <= 0.01:
            raise InputError(
                f"the rate is given as {rate:g} Hz, but the time column has {found_rate:.6g} Hz: "
                "leave the rate out, or correct the unit of time"
            )
    return time, torque, angle, (*table.notes, *notes)


def _evenly(
    time: FloatArray, torque: FloatArray, angle: FloatArray, rows: Sequence[int]
) -> _Samples:
    """Bring the channels to a uniform time grid, or refuse."""
    steps = np.diff(time)
    backward = np.flatnonzero(steps <= 0.0)
    if backward.size:
        at = int(backward[0]) + 1
        raise InputError(
            f"row {rows[at]}: time must increase, but {time[at]:.9g} s comes after "
            f"{time[at - 1]:.9g} s"
        )
    if time.size < 3 or not np.isfinite(steps).all():
        return time, torque, angle, ()  # for Trial to refuse
    start, step = float(time[0]), float((time[-1] - time[0]) / steps.size)
    notes = []
    if np.spacing(abs(start)) > 1e-8 * step:
        notes.append(f"time counted from {start:.12g} s")
        time, start = time - start, 0.0
    grid = start + step * np.arange(time.size, dtype=np.float64)
    departure = float(np.abs(time - grid).max()) / step
    if departure <= _CLOCK_ROUNDING:
        if departure > 1e-6:
            notes.append(f"rounding of time undone (up to {departure:.1g} of a step)")
        return grid, torque, angle, tuple(notes)

    typical = float(np.median(steps))
    jitter = np.abs(steps / typical - 1.0)
    uneven = np.flatnonzero(jitter >= MAX_JITTER)
    if uneven.size:
        at = int(uneven[0])
        raise InputError(
            f"row {rows[at + 1]}: the time step is {steps[at]:.6g} s where {typical:.6g} s "
            f"is usual, a jitter of {100 * jitter[at]:.3g} % where less than "
            f"{100 * MAX_JITTER:g} % is resampled: cut the recording there, or resample it"
        )
    n_steps = int((time[-1] - start) / typical * (1.0 + 1e-12))
    grid = start + typical * np.arange(n_steps + 1, dtype=np.float64)
    notes.append(
        f"resampled to {typical:.9g} s (torque linear, angle PCHIP): time steps varied by "
        f"{100 * jitter.max():.2g} %"
    )
    resampled = interpolate.PchipInterpolator(time, angle)(np.minimum(grid, time[-1]))
    return grid, np.interp(grid, time, torque), resampled, tuple(notes)


def _warn_of_sign(trial: Trial, restoring: bool) -> None:
    """Warn where torque regressed on an imposed angle gives stiffness and inertia below zero."""
    if trial.driven != "angle" or trial.n_samples < 50:
        return
    # Scaled to avoid overflow; the signs stay. Smoothed, for the acceleration of a sampled angle.
    smooth = dataclasses.replace(
        trial,
        torque=trial.torque / np.abs(trial.torque).max(),
        angle=trial.angle / np.abs(trial.angle).max(),
    )
    if 200.0 < smooth.sampling_rate < 1e6:
        smooth = smooth.lowpass(HIGHEST_HZ)
    velocity = np.gradient(smooth.angle, smooth.dt)
    design = np.stack([smooth.angle, velocity, np.gradient(velocity, smooth.dt)], axis=1)
    design, torque = design - design.mean(axis=0), smooth.torque - smooth.torque.mean()
    scale = np.abs(design).max(axis=0)
    if not (np.isfinite(scale).all() and scale.all() and torque.any()):
        return
    coefficients = np.linalg.lstsq(design / scale, torque, rcond=None)[0]
    explained = 1.0 - np.var(torque - design / scale @ coefficients) / np.var(torque)
    if coefficients[0] < 0.0 and coefficients[2] < 0.0 and explained > 0.5:
        remedy = (
            "if it was recorded as applied to the joint, leave --restoring out"
            if restoring
            else "if it was recorded as the joint's reaction, add --restoring"
        )
        warnings.warn(
            f"{trial.source}: torque regressed on the imposed angle gives a negative stiffness "
            f"and a negative inertia, so the sign of the torque looks reversed: {remedy}",
            UserWarning,
            stacklevel=3,
        )
