"""Numbers, words and tables as the Markdown pages write them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """Plain number with so many significant digits, as a power of ten where it is very small."""
    if 0 < abs(value) < 1e-3:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa} × 10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    text = f"{value:.0f}" if abs(value) >= 10 ** (digits - 1) else f"{value:#.{digits}g}"
    return text.rstrip(".").replace("-", "−")


def percent(fraction: float) -> str:
    """Fraction in per cent."""
    return f"{number(100 * fraction, 2 if abs(fraction) < 1 else 3)} %"


def words(key: str) -> str:
    """Key of a perturbation or an effect, as words."""
    return key.replace("_", " ")


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Table, without a line's end after the last row."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
