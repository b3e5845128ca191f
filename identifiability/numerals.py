"""Numbers as people read them: few digits, and powers of ten in the place of exponents."""

from __future__ import annotations

from math import floor, isfinite, log10

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
PLAIN = range(-3, 5)
"""Powers of ten that are written out."""
_MOST_DECIMALS = 7


def number(x: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, such as "0.0123" or "1.2 × 10⁻⁵"."""
    if not isfinite(x):
        return "unknown"
    rounded = f"{x:.{digits - 1}e}"
    mantissa, _, exponent = rounded.partition("e")
    power = int(exponent)
    if x == 0 or power in PLAIN:
        return f"{float(rounded):.10g}"
    return f"{float(mantissa):.10g} × {power_of_ten(power)}"


def power_of_ten(power: int) -> str:
    """Return a power of ten, such as "10⁻⁵"."""
    return "10" + str(power).translate(_SUPERSCRIPTS)


def fixed(x: float, digits: int) -> str:
    """Return a number with all its significant digits, zeros at the end too, such as "30.00"."""
    decimals = max(digits - 1 - floor(log10(abs(x))), 0) if x else 0
    return f"{x:.{decimals}f}" if decimals <= _MOST_DECIMALS else number(x, digits)


def range_text(low: float, high: float) -> str:
    """Return two numbers with the digits that tell them apart, such as "29.98 to 30.02"."""
    apart, size = high - low, max(abs(low), abs(high))
    if not (isfinite(apart) and apart > 0):
        return f"{number(low)} to {number(high)}"
    place = floor(log10(apart))
    if floor(log10(size)) in PLAIN and place > -_MOST_DECIMALS:
        decimals = max(1 - place, 0)
        return f"{low:.{decimals}f} to {high:.{decimals}f}"
    digits = 2 + floor(log10(size)) - place
    return f"{number(low, digits)} to {number(high, digits)}"
