"""What an investigation measures, as people read it: values with widths, odds and errors."""

from __future__ import annotations

from math import exp, floor, log, log10

from identifiability.joint.parameters import Parameter, plus_minus, with_unit
from identifiability.numerals import PLAIN, fixed, number, power_of_ten

NATS = "With 3 nats more something is 20 times as probable, with 7 a thousand times."
"""Below tables in nats."""

_NOTHING = 1e-6  # share of its usual value that is no value
_NARROW = 1e-4  # share of a value from which a width is given in per cent
_FEW = 1000.0  # times, until which a ratio is written out
_WITH_MILLI, _SMALL = ("s", "rad"), 0.1  # units that are read in thousandths, and below what value
_DIVERGED = 1e3  # E of a prediction that has nothing to do with the trial any more


def measured(
    value: float,
    sd: float | None,
    parameter: Parameter,
    *,
    at_bound: bool = False,
    unit: bool = True,
) -> str:
    """Return a parameter's value with its standard deviation, both with digits that mean something.

    Parameters
    ----------
    value : float
    sd : float or None
        ``None`` where it is not known.
    parameter : Parameter
    at_bound : bool
        Whether the value lies at a bound, where it has no width.
    unit : bool
        Whether the unit follows.
    """
    said = parameter.unit if unit else "1"
    nothing = abs(value) < _NOTHING * abs(parameter.nominal)
    if said in _WITH_MILLI and not nothing and max(abs(value), sd or 0.0) < _SMALL:
        value, sd, said = 1e3 * value, None if sd is None else 1e3 * sd, f"m{said}"
    if at_bound:
        return f"{with_unit('0' if nothing else number(value), said)} (at its bound)"
    if sd is None or not 0 < sd < float("inf"):
        return with_unit("0" if nothing else number(value, 4), said)
    if sd < _NARROW * abs(value):
        return f"{with_unit(fixed(value, 4), said)} ± {number(100 * sd / abs(value), 1)} %"
    power = floor(log10(max(abs(value), sd)))
    if power in PLAIN:
        return with_unit(plus_minus(value, sd), said)
    scaled = plus_minus(value / 10.0**power, sd / 10.0**power)
    return with_unit(f"({scaled}) × {power_of_ten(power)}", said)


def times(nats: float) -> str:
    """Return how many times as probable something is whose log evidence is so much larger."""
    if abs(nats) < log(_FEW):
        return number(exp(nats), 2)
    return power_of_ten(round(nats / log(10)))


def error_text(error: float, digits: int = 3) -> str:
    """E as text; "diverges" where a prediction has nothing to do with its trial any more."""
    return number(error, digits) if error < _DIVERGED else "diverges"


def vaf_text(error: float) -> str:
    """VAF [%] of an error E, which does not reach 100."""
    if not error < _DIVERGED:
        return ""
    vaf = 100 * (1 - error)
    return "> 99.99" if vaf >= 99.995 else f"{vaf:.2f}" if vaf > 90 else f"{vaf:.1f}"
