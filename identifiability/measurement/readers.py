"""Files of measured torque and angle, read into trials."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import shlex
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, io

from identifiability.errors import InputError
from identifiability.measurement.trials import FloatArray, Trial
from identifiability.measurement.units import Quantity, parse_unit

Columns = Mapping[Quantity, tuple[str | int, str]]
"""Quantity -> (column, unit); a column is a name, or an index that counts from 0."""

MAX_JITTER: Final = 0.05
"""Largest relative departure of a time step from the median one that is resampled away."""

_CLOCK_ROUNDING: Final = 1e-3  # of a step: a time column that was printed with few digits
_TEXT_SUFFIXES: Final = (".csv", ".tsv", ".txt", ".dat")
_SI: Final[dict[Quantity, str]] = {"time": "s", "angle": "rad", "torque": "Nm"}
_NAMES: Final[dict[Quantity, frozenset[str]]] = {
    "time": frozenset({"time", "t"}),
    "angle": frozenset({"angle", "ang", "position", "pos", "theta", "phi", "q"}),
    "torque": frozenset({"torque", "moment", "tau", "tq", "trq"}),
}
# In the order of trial: a decimal comma only where a decimal point does not explain the lines.
_FORMATS: Final = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (None, "."),
    (None, ","),
)


def parse_columns(texts: Sequence[str]) -> dict[Quantity, tuple[str | int, str]]:
    """Read the command-line form of the columns, ``quantity=column:unit``.

    Parameters
    ----------
    texts : sequence of str
        Such as ``["time=time:s", "angle=position:deg", "torque=torque:Nm"]``. A column that is a
        whole number is an index that counts from 0: ``angle=0:rad``.

    Returns
    -------
    dict
        Quantity -> (column, unit), as `read_trial` takes it.

    Raises
    ------
    InputError
        If a text has another form, a quantity or a unit is unknown, or a quantity occurs twice.
    """
    columns: dict[Quantity, tuple[str | int, str]] = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        column, colon, unit = rest.rpartition(":")
        column, unit = column.strip(), unit.strip()
        if not (equals and colon and column and unit):
            raise InputError(
                f"{text!r} does not name a column: write quantity=column:unit, such as "
                "angle=position:deg or, by index from 0, torque=1:Nm"
            )
        quantity = _quantity(name.strip())
        if quantity in columns:
            raise InputError(f"the column of {quantity} is named twice: name it once")
        parse_unit(unit, quantity)
        columns[quantity] = (int(column) if re.fullmatch(r"-?[0-9]+", column) else column, unit)
    return columns


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
    """Read one trial from a text file or a MATLAB file.

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
    wanted = None if columns is None else _checked(columns)
    # Absurdly large numbers overflow quietly here and are then refused as not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            table, sha256 = _load(path, variable, wanted)
            if wanted is None:
                wanted = _located(table, rate)
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


@dataclass(frozen=True)
class _Table:
    """Columns of a file, text not yet converted."""

    columns: tuple[Sequence[str] | NDArray[Any], ...]
    names: tuple[str, ...] | None
    rows: Sequence[int]  # of the file, from 1, for each sample
    decimal: str = "."
    notes: tuple[str, ...] = ()

    def index(self, column: str | int) -> int:
        """Position of a column that is given by name or index."""
        if self.names is not None and str(column) in self.names:
            if self.names.count(str(column)) > 1:
                raise InputError(
                    f"{self.names.count(str(column))} columns are named {column!r}: "
                    "give the index, which counts from 0"
                )
            return self.names.index(str(column))
        if isinstance(column, str):
            if self.names is None:
                raise InputError(
                    f"there is no header, so no column is named {column!r}: give the index, which "
                    f"counts from 0, such as {_EXAMPLE}"
                )
            raise InputError(
                f"no column is named {column!r}: the columns are {', '.join(self.names)}"
            )
        if not 0 <= column < len(self.columns):
            raise InputError(
                f"column {column} is out of range: there are {len(self.columns)} columns, "
                f"0 to {len(self.columns) - 1}"
            )
        return column

    def values(self, column: str | int) -> FloatArray:
        """Numbers of a column, all finite."""
        index = self.index(column)
        cells = self.columns[index]
        label = f"column {index}" if self.names is None else f"column {self.names[index]!r}"
        if isinstance(cells, np.ndarray):
            values = cells.astype(np.float64)
        else:
            numbers = [_number(cell, self.decimal) for cell in cells]
            if None in numbers:
                at = numbers.index(None)
                found = f"{cells[at][:40]!r} is not a number" if cells[at] else "the cell is empty"
                raise InputError(
                    f"row {self.rows[at]}, {label}: {found}, where a number is expected"
                )
            values = np.array(numbers, dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"row {self.rows[bad[0]]}, {label}: the value is {values[bad[0]]}, the first of "
                f"{bad.size} that are not finite: remove or fill them"
            )
        return values


_EXAMPLE: Final = "--columns angle=0:rad torque=1:Nm"


def _quantity(name: str) -> Quantity:
    for quantity in _SI:
        if name == quantity:
            return quantity
    raise InputError(f"{name!r} is not a quantity of a trial: name time, angle or torque")


def _checked(columns: Columns) -> Columns:
    for name, place in columns.items():
        quantity = _quantity(name)
        match place:
            case (str() | int(), str() as unit):
                parse_unit(unit, quantity)
            case _:
                raise InputError(
                    f"the column of {name} is given as {place!r}: give the column and its unit, "
                    'such as ("position", "deg") or, by index from 0, (1, "deg")'
                )
    missing = [quantity for quantity in ("angle", "torque") if quantity not in columns]
    if missing:
        raise InputError(
            f"no column is named for {' and '.join(missing)}: name angle and torque, such as "
            f"{_EXAMPLE}"
        )
    return columns


def _load(path: Path, variable: str | None, columns: Columns | None) -> tuple[_Table, str]:
    suffix = path.suffix.lower()
    if path.is_dir():
        raise InputError("this is a directory: give the path of one file")
    if suffix not in (*_TEXT_SUFFIXES, ".mat"):
        raise InputError(
            f"files with the suffix {suffix!r} are not read: give one of "
            f"{', '.join(_TEXT_SUFFIXES)}, .mat"
        )
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"there is no such file in {path.parent}: check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise InputError(f"the file cannot be opened: {error}") from None
    if not content:
        raise InputError("the file is empty (0 bytes)")
    sha256 = hashlib.sha256(content).hexdigest()
    if suffix == ".mat":
        return _mat_table(_mat_variables(path), variable, columns), sha256
    if variable is not None:
        raise InputError(
            f"variable {variable!r} is named, but only .mat files hold variables: leave it out"
        )
    return _text_table(content), sha256


# Text ------------------------------------------------------------------------------------------


def _text_table(content: bytes) -> _Table:
    lines = re.split(r"\r\n|\r|\n", _decoded(content))
    kept = [
        (row, line)
        for row, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not kept:
        raise InputError("the file holds no data, only blank lines or comments")
    separator, decimal = _sniffed([line for _, line in kept[:50]])
    cells = [_cells(line, separator) for _, line in kept]
    rows = [row for row, _ in kept]

    names = None
    if all(_number(cell, decimal) is None for cell in cells[0]):
        names = tuple(cells.pop(0))
        rows.pop(0)
        if not cells:
            raise InputError(f"the file holds a header ({', '.join(names)}) and no samples")
    width = len(cells[0]) if names is None else len(names)
    for row, found in zip(rows, cells, strict=True):
        if len(found) != width:
            first = "the first row" if names is None else "the header"
            raise InputError(
                f"row {row} has {len(found)} values, where {first} has {width}: rows must be "
                "equally long"
            )
    return _Table(tuple(zip(*cells, strict=True)), names, rows, decimal)


def _decoded(content: bytes) -> str:
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            return content.decode("utf-16")
        if b"\0" not in content:
            return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" not in content:
            return content.decode("latin-1")
    raise InputError("this is not a text file: it holds bytes that no text has")


def _sniffed(lines: Sequence[str]) -> tuple[str | None, str]:
    """Separator and decimal mark that explain the most lines as rows of numbers."""

    def explained(form: tuple[str | None, str]) -> tuple[float, int]:
        share = 0.0
        for line in lines:
            cells = _cells(line, form[0])
            numeric = sum(_number(cell, form[1]) is not None for cell in cells)
            share += numeric / len(cells) if numeric >= 2 else 0.0
        return share, len(_cells(lines[0], form[0])) if share == 0.0 else 0

    return max(_FORMATS, key=explained)


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [cell.strip().strip("\"'").strip() for cell in line.split(separator)]
    # Some programs end every line with a separator.
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _number(cell: str, decimal: str) -> float | None:
    if "_" in cell:  # 1_000 is a number to Python alone
        return None
    try:
        return float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return None


# MATLAB ----------------------------------------------------------------------------------------

_Variables = dict[str, "NDArray[Any] | dict[str, NDArray[Any]]"]


def _mat_variables(path: Path) -> _Variables:
    """Numeric matrices of a MATLAB file, and structs of them, by name."""
    try:
        if h5py.is_hdf5(path):
            return _hdf5_variables(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about class objects, left out below
            contents = io.loadmat(path)
    except Exception as error:  # the parsers raise nearly anything on a damaged file
        raise InputError(
            f"the file cannot be read as a MATLAB file ({type(error).__name__}): "
            "save it again with MATLAB's save"
        ) from None
    variables: _Variables = {}
    for name, value in contents.items():
        if name.startswith("__") or isinstance(value, io.matlab.MatlabOpaque):
            continue
        if _is_matrix(value):
            variables[name] = value
        elif isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            fields = {field: value[field].item() for field in value.dtype.names}
            variables[name] = {field: v for field, v in fields.items() if _is_matrix(v)}
    return {name: value for name, value in variables.items() if len(value)}


def _hdf5_variables(path: Path) -> _Variables:
    variables: _Variables = {}
    with h5py.File(path) as file:
        for name, value in file.items():
            if isinstance(value, h5py.Group) and not name.startswith("#"):
                fields = {field: _hdf5_matrix(v) for field, v in value.items()}
                variables[name] = {field: v for field, v in fields.items() if v is not None}
            elif (matrix := _hdf5_matrix(value)) is not None:
                variables[name] = matrix
    return {name: value for name, value in variables.items() if len(value)}


def _hdf5_matrix(value: object) -> NDArray[Any] | None:
    if not isinstance(value, h5py.Dataset) or value.attrs.get("MATLAB_class") == b"char":
        return None
    matrix = np.asarray(value[()]).T  # MATLAB stores by columns
    return matrix if _is_matrix(matrix) else None


def _is_matrix(value: object) -> bool:
    return (
        isinstance(value, np.ndarray)
        and value.dtype.kind in "biuf"
        and value.ndim == 2
        and value.size > 1
    )


def _is_vector(value: NDArray[Any]) -> bool:
    return min(value.shape) == 1


def _mat_table(variables: _Variables, variable: str | None, columns: Columns | None) -> _Table:
    chosen = _chosen(variables, variable, columns)
    if isinstance(chosen, dict):
        vectors = {name: value.ravel() for name, value in chosen.items() if _is_vector(value)}
        longest = max((vector.size for vector in vectors.values()), default=0)
        return _Table(tuple(vectors.values()), tuple(vectors), range(1, longest + 1))
    if _is_vector(chosen):
        raise InputError(
            f"the variable is one vector of {chosen.size} values, where torque and angle are "
            f"needed: name a matrix or a struct; {_listed(variables)}"
        )
    if columns is None:
        raise InputError(
            "a matrix has no header: name its columns by index, which counts from 0, such as "
            f"{_EXAMPLE}; {_listed(variables)}"
        )
    notes: tuple[str, ...] = ()
    if chosen.shape[0] < chosen.shape[1]:
        chosen, notes = chosen.T, ("matrix transposed (channels were in rows)",)
    return _Table(tuple(chosen.T), None, range(1, len(chosen) + 1), notes=notes)


def _chosen(
    variables: _Variables, variable: str | None, columns: Columns | None
) -> NDArray[Any] | dict[str, NDArray[Any]]:
    if variable is not None:
        if variable not in variables:
            raise InputError(
                f"there is no numeric variable {variable!r} in the file: {_listed(variables)}"
            )
        return variables[variable]
    arrays = {name: v for name, v in variables.items() if not isinstance(v, dict)}
    structs = [v for v in variables.values() if isinstance(v, dict)]
    vectors = {name: v for name, v in arrays.items() if _is_vector(v)}
    matrices = [v for v in arrays.values() if not _is_vector(v)]
    named = [] if columns is None else [column for column, _ in columns.values()]
    if named and all(name in vectors for name in named):
        return vectors
    if len(matrices) == 1:
        return matrices[0]
    if not matrices and len(structs) == 1:
        return structs[0]
    if not matrices and not structs and len(vectors) > 1:
        return vectors
    raise InputError(
        f"the file does not hold one matrix or one struct: name a variable; {_listed(variables)}"
    )


def _listed(variables: _Variables) -> str:
    if not variables:
        return "the file holds no numeric matrix or struct"
    found = [
        f"{name} (struct of {', '.join(value)})"
        if isinstance(value, dict)
        else f"{name} ({value.shape[0]} x {value.shape[1]})"
        for name, value in variables.items()
    ]
    return f"the file holds {', '.join(found)}"


# Columns ---------------------------------------------------------------------------------------


def _located(table: _Table, rate: float | None) -> Columns:
    """Columns whose headers name a quantity and a unit of it."""
    if table.names is None:
        raise InputError(
            "there is no header: name the columns by index, which counts from 0, "
            f"such as {_EXAMPLE}"
        )
    columns: dict[Quantity, tuple[str | int, str]] = {}
    for quantity in _SI:
        found = {
            index: unit
            for index, header in enumerate(table.names)
            if (unit := _unit_in(header, quantity)) is not None
        }
        if len(found) > 1:
            headers = ", ".join(table.names[index] for index in found)
            raise InputError(
                f"several columns may be {quantity} ({headers}): choose with "
                f"{_suggested(table.names, columns, rate)}"
            )
        for index, unit in found.items():
            columns[quantity] = (index, unit)
    needed: tuple[Quantity, ...] = ("torque", "angle") if rate else ("time", "torque", "angle")
    missing = [quantity for quantity in needed if quantity not in columns]
    if missing:
        raise InputError(
            f"the header ({', '.join(table.names)}) does not tell which column is "
            f"{' and which is '.join(missing)}, and in what unit: write "
            f"{_suggested(table.names, columns, rate)}, with the units the file really has"
        )
    return columns


def _unit_in(header: str, quantity: Quantity) -> str | None:
    """Return the unit that a header gives, if it names the quantity and a unit of it."""
    for name, unit in _splits(header):
        if not _names(name, quantity):
            continue
        try:
            parse_unit(unit, quantity)
        except InputError:
            continue
        return unit
    return None


def _splits(header: str) -> Iterator[tuple[str, str]]:
    """Ways to split a header into name and unit."""
    if bracketed := re.fullmatch(r"(.+?)\s*[\[({](.*)[\])}]", header):
        yield bracketed[1], bracketed[2]
    for mark in re.finditer(r"[/_\s]+", header):
        yield header[: mark.start()], header[mark.end() :]


def _names(text: str, quantity: Quantity) -> bool:
    """Tell whether a word of the text stands for the quantity."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)
    return not _NAMES[quantity].isdisjoint(word.lower() for word in words)


def _suggested(names: Sequence[str], columns: Columns, rate: float | None) -> str:
    """Write the options that would name the columns, with SI units where the header tells none."""
    words = ["--columns"]
    for quantity, si in _SI.items():
        similar = [name for name in names if _names(name, quantity)]
        column, unit = columns.get(quantity, (similar[0] if similar else "COLUMN", si))
        if quantity == "time" and rate is not None and quantity not in columns:
            continue
        if quantity == "time" and column == "COLUMN":
            words.insert(0, "--rate HZ")
            continue
        column = names[column] if isinstance(column, int) else column
        words.append(shlex.quote(f"{quantity}={column}:{unit}"))
    return " ".join(words)


# Samples ---------------------------------------------------------------------------------------


_Samples = tuple[FloatArray, FloatArray, FloatArray, tuple[str, ...]]


def _samples(table: _Table, columns: Columns, rate: float | None) -> _Samples:
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
        smooth = smooth.lowpass(50.0)
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
