"""Which columns hold time, angle and torque, and in what unit."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from typing import Final

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import EXAMPLE, Columns, Table
from identifiability.measurement.units import Quantity, parse_unit

_SI: Final[dict[Quantity, str]] = {"time": "s", "angle": "rad", "torque": "Nm"}
_NAMES: Final[dict[Quantity, frozenset[str]]] = {
    "time": frozenset({"time", "t"}),
    "angle": frozenset({"angle", "ang", "position", "pos", "theta", "phi", "q"}),
    "torque": frozenset({"torque", "moment", "tau", "tq", "trq"}),
}


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


def _quantity(name: str) -> Quantity:
    for quantity in _SI:
        if name == quantity:
            return quantity
    raise InputError(f"{name!r} is not a quantity of a trial: name time, angle or torque")


def checked(columns: Columns, needed: Sequence[Quantity] = ("angle", "torque")) -> Columns:
    """Refuse columns that are no quantities, or have no unit of theirs."""
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
    missing = [quantity for quantity in needed if quantity not in columns]
    if missing:
        raise InputError(
            f"no column is named for {' and '.join(missing)}: name {' and '.join(needed)}, such "
            f"as {EXAMPLE}"
        )
    return columns


def located(
    table: Table, rate: float | None, needed: Sequence[Quantity] = ("torque", "angle")
) -> Columns:
    """Columns whose headers name a quantity and a unit of it."""
    if table.names is None:
        raise InputError(
            f"there is no header: name the columns by index, which counts from 0, such as {EXAMPLE}"
        )
    columns: dict[Quantity, tuple[str | int, str]] = {}
    sought = [quantity for quantity in _SI if quantity in ("time", *needed)]
    for quantity in sought:
        found = {
            index: unit
            for index, header in enumerate(table.names)
            if (unit := _unit_in(header, quantity)) is not None
        }
        if len(found) > 1:
            headers = ", ".join(table.names[index] for index in found)
            raise InputError(
                f"several columns may be {quantity} ({headers}): choose with "
                f"{_suggested(table.names, columns, rate, sought)}"
            )
        for index, unit in found.items():
            columns[quantity] = (index, unit)
    timed: tuple[Quantity, ...] = () if rate else ("time",)
    missing = [quantity for quantity in (*timed, *needed) if quantity not in columns]
    if missing:
        raise InputError(
            f"the header ({', '.join(table.names)}) does not tell which column is "
            f"{' and which is '.join(missing)}, and in what unit: write "
            f"{_suggested(table.names, columns, rate, sought)}, with the units the file really has"
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


def _suggested(
    names: Sequence[str], columns: Columns, rate: float | None, sought: Sequence[Quantity]
) -> str:
    """Write the options that would name the columns, with SI units where the header tells none."""
    words = ["--columns"]
    for quantity in sought:
        si = _SI[quantity]
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
