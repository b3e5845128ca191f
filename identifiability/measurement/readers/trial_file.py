"""From a file to a trial, whatever its format: columns, units, sign, an even clock."""

from __future__ import annotations

import dataclasses
import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from identifiability.errors import InputError
from identifiability.measurement.filtering import HIGHEST_HZ
from identifiability.measurement.readers.clock import Samples, evenly
from identifiability.measurement.readers.columns import checked, located
from identifiability.measurement.readers.formats import READERS, reader_of
from identifiability.measurement.readers.tables import Columns, Options, Table
from identifiability.measurement.trials import FloatArray, Trial
from identifiability.measurement.units import Quantity, parse_unit

REVERSED = "sign of torque changed (recorded as the joint's reaction)"
"""Note of a trial whose torque was."""


def read_trial(
    path: str | Path,
    *,
    columns: Columns | None = None,
    variable: str | None = None,
    rate: float | None = None,
    resample: float | None = None,
    restoring: bool = False,
    driven: Literal["torque", "angle"] = "torque",
    name: str | None = None,
) -> Trial:
    """Read one trial from a file of any format in `READERS`.

    Text files (.csv, .tsv, .txt, .dat) may be separated by comma, semicolon, tab or white space,
    with a decimal point or comma; lines that start with ``#`` are skipped. MATLAB files (.mat) may
    be of any version. In HDF5 files (.h5, .hdf5) vectors lie side by side in one group, or one
    matrix or table holds them; OpenSim's files (.sto, .mot) say whether angles are in degrees; BIDS
    motion recordings (_motion.tsv) have names, units and rate in their sidecars. With the extra
    ``readers``: MATLAB tables and objects, the analog channels of C3D files, TDMS. Time
    steps that vary by less than 5 %, or that are late now and then, are resampled to the median
    one, torque linearly and angle by monotone cubics (PCHIP), which the trial's notes tell.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : mapping, optional
        Quantity -> (column, unit), such as ``{"angle": (0, "rad"), "torque": (1, "Nm")}``. By
        default columns are found by headers that name quantity and unit, such as ``torque_Nm``,
        ``angle (deg)``, ``torque [N.m]`` or ``Time/s``. A header without a unit is never guessed.
    variable : str, optional
        In a MATLAB or HDF5 file, the matrix, struct or group of vectors to read; needed where the
        file holds several.
    rate : float, optional
        Sampling rate (Hz), needed where there is no time column.
    resample : float, optional
        Samples a second (Hz) to be interpolated to, however uneven the clock is; no more than the
        file has. Fewer are freed of what would fold back.
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
            table, sha256 = loaded(path, Options(variable, wanted))
            if wanted is None:
                wanted = located(table, rate)
            time, torque, angle, notes = _samples(table, wanted, rate, resample)
            if restoring:
                torque = -torque
                notes = (*notes, REVERSED)
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
            if resample is not None:
                trial = trial.thinned(round(trial.sampling_rate / resample))
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None
        warn_of_sign(trial, restoring)
    return trial


def loaded(path: Path, options: Options) -> tuple[Table, str]:
    """Columns of a file, and its SHA-256."""
    if path.is_dir():
        raise InputError("this is a directory: give the path of one file")
    reader = reader_of(path)
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


def _samples(table: Table, columns: Columns, rate: float | None, resample: float | None) -> Samples:
    """Time, torque and angle in SI units on an even clock, and what was done to them."""
    values = numbers(table, columns)
    torque, angle = values["torque"], values["angle"]
    time = clock_of(values, torque.size, rate)
    recorded = Samples(time, torque, angle, table.notes)
    if "time" not in values and resample is None:
        return recorded
    samples = evenly(recorded, table.rows, resample)
    check_rate(values, rate)
    return samples


def numbers(table: Table, columns: Columns) -> dict[Quantity, FloatArray]:
    """Columns by quantity, in SI units."""
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
    return values


def clock_of(
    values: Mapping[Quantity, FloatArray], n_samples: int, rate: float | None
) -> FloatArray:
    """Time [s] as the file has it, or from 0 at a rate."""
    if rate is not None and not 0.0 < rate < np.inf:
        raise InputError(f"the sampling rate is {rate} Hz, but must be above 0")
    if "time" in values:
        return values["time"]
    if rate is None:
        raise InputError(
            "there is no time column and no sampling rate: give the rate, such as --rate 1000, "
            "or the column of time, such as --columns time=0:s"
        )
    return np.arange(n_samples, dtype=np.float64) / rate


def check_rate(values: Mapping[Quantity, FloatArray], rate: float | None) -> None:
    """Refuse a rate that the file's own time contradicts."""
    if rate is None or "time" not in values or values["time"].size < 2:
        return
    time = values["time"]
    found_rate = (time.size - 1) / (time[-1] - time[0])
    if not abs(found_rate / rate - 1.0) <= 0.01:
        raise InputError(
            f"the rate is given as {rate:g} Hz, but the time column has {found_rate:.6g} Hz: "
            "leave the rate out, or correct the unit of time"
        )


def warn_of_sign(trial: Trial, restoring: bool) -> None:
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
