"""Spellings of units and their factors to SI."""

from __future__ import annotations

import math
import re
from typing import Final, Literal

from identifiability.errors import InputError

Quantity = Literal["time", "angle", "torque"]

# Separators inside a torque ("N.m", "N*m", "N m") carry no meaning.
_SEPARATORS: Final = re.compile(r"[\s.*·⋅×_-]+")

_FACTORS: Final[dict[Quantity, dict[str, float]]] = {
    "time": {
        "s": 1.0,
        "sec": 1.0,
        "second": 1.0,
        "seconds": 1.0,
        "ms": 1e-3,
        "msec": 1e-3,
        "millisecond": 1e-3,
        "milliseconds": 1e-3,
        "us": 1e-6,
        "µs": 1e-6,  # micro sign
        "μs": 1e-6,  # Greek mu
        "min": 60.0,
    },
    "angle": {
        "rad": 1.0,
        "radian": 1.0,
        "radians": 1.0,
        "mrad": 1e-3,
        "deg": math.pi / 180.0,
        "degree": math.pi / 180.0,
        "degrees": math.pi / 180.0,
        "°": math.pi / 180.0,
    },
    "torque": {
        "Nm": 1.0,
        "mNm": 1e-3,
        "Nmm": 1e-3,
        "Ncm": 1e-2,
        "kNm": 1e3,
    },
}

# Case may be ignored only where no prefix is at stake: "NM" is Nm, but "MNm" is not mNm.
_ANY_CASE: Final[dict[Quantity, tuple[str, ...]]] = {
    "time": ("s", "sec", "second", "seconds"),
    "angle": ("rad", "radian", "radians", "deg", "degree", "degrees"),
    "torque": ("Nm",),
}


def parse_unit(text: str, quantity: Quantity) -> float:
    """Return the factor that turns a value in the unit `text` into SI (s, rad, Nm).

    Parameters
    ----------
    text : str
        Spelling of the unit, such as ``"deg"``, ``"N.m"`` or ``"ms"``.
    quantity : {"time", "angle", "torque"}
        What the unit has to measure.

    Returns
    -------
    float
        Factor to s, rad or Nm.

    Raises
    ------
    InputError
        If the spelling is unknown, or belongs to another quantity.
    """
    factor = _factor(text, quantity)
    if factor is not None:
        return factor
    accepted = ", ".join(_FACTORS[quantity])
    for other in _FACTORS:
        if _factor(text, other) is not None:
            raise InputError(
                f"{text.strip()!r} is a unit of {other}, where a unit of {quantity} is needed: "
                f"write one of {accepted}"
            )
    raise InputError(f"unit {text.strip()!r} of {quantity} is not known: write one of {accepted}")


def _factor(text: str, quantity: Quantity) -> float | None:
    spelling = _SEPARATORS.sub("", text) if quantity == "torque" else text.strip()
    table = _FACTORS[quantity]
    if spelling in table:
        return table[spelling]
    for known in _ANY_CASE[quantity]:
        if spelling.casefold() == known.casefold():
            return table[known]
    return None
