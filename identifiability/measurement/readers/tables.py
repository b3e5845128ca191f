"""What a reader is given and what it gives: columns as they were written, and their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from identifiability.errors import InputError
from identifiability.measurement.trials import FloatArray
from identifiability.measurement.units import Quantity

EXAMPLE: Final = "--columns angle=0:rad torque=1:Nm"

Columns = Mapping[Quantity, tuple[str | int, str]]
"""Quantity -> (column, unit); a column is a name, or an index that counts from 0."""


@dataclass(frozen=True)
class Options:
    """What the caller says about a file, beyond its name.

    Attributes
    ----------
    variable : str or None
        Variable to read, in files that hold several.
    columns : mapping or None
        Where angle, torque and time are, if that was said; a reader may need it to choose among
        variables.
    """

    variable: str | None = None
    columns: Columns | None = None

    def refuse_variable(self, suffix: str) -> None:
        """Refuse the name of a variable, for formats that hold none."""
        if self.variable is not None:
            raise InputError(
                f"variable {self.variable!r} is named, but {suffix} files hold none, as .mat and "
                ".h5 files do: leave it out"
            )


@dataclass(frozen=True)
class Table:
    """Columns of a file, text not yet converted.

    Attributes
    ----------
    columns : tuple of sequence
        Cells as text, or arrays.
    names : tuple of str or None
        ``None`` where the file has no header.
    rows : sequence of int
        Row of the file, from 1, of each sample.
    decimal : str
        Decimal mark.
    notes : tuple of str
        What was done to the columns.
    """

    columns: tuple[Sequence[str] | NDArray[Any], ...]
    names: tuple[str, ...] | None
    rows: Sequence[int]
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
                    f"counts from 0, such as {EXAMPLE}"
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
            numbers = [number(cell, self.decimal) for cell in cells]
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


def number(cell: str, decimal: str) -> float | None:
    """Number in a cell, ``None`` where there is none."""
    if "_" in cell:  # 1_000 is a number to Python alone
        return None
    try:
        return float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return None
