"""Named parameters with units, bounds and the value at which they vanish."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

_NOTHING = 1e-9  # in SI units


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit, where it has one: "1" is none."""
    return number if unit == "1" else f"{number} {unit}"


def plus_minus(value: float, sd: float | None = None) -> str:
    """Return a number with its standard deviation, to as many digits as that has two of.

    What a fit leaves of a parameter at its bound of nothing is nothing.
    """
    value = value if abs(value) > _NOTHING else 0.0
    if sd is None or not 0 < sd < float("inf"):
        return f"{value:.4g}"
    decimals = 1 - floor(log10(sd))
    if decimals <= 0:
        return f"{round(value, decimals):.0f} ± {round(sd, decimals):.0f}"
    return f"{value:.{decimals}f} ± {sd:.{decimals}f}"


@dataclass(frozen=True)
class Parameter:
    """One parameter of a joint model.

    Attributes
    ----------
    name : str
        Name inside its effect; the model prefixes it with the effect's key.
    symbol : str
        Mathtext symbol for figures, without dollar signs.
    unit : str
        SI unit, angles in rad.
    nominal : float
        A typical value, used where a start is needed and nothing better is known.
    lower, upper : float
        Physical bounds; the default prior is uniform between them.
    description : str
        What it is, in words.
    null : float or None
        Value at which the effect vanishes, together with its other parameters that have one;
        ``None`` where the value alone does not make it vanish.
    plain : float or None
        Value that gives the effect its plain form, for a parameter that only refines it; ``None``
        for a parameter that the effect cannot do without.
    spread : float or None
        Standard deviation about the lower bound, of what joints have little of; ``None`` where all
        that the bounds allow is as likely.
    with_level : {-1, 0, 1}
        By how much it grows with the angle [rad] that is taken for the operating point: 1 for the
        posture there, -1 for a place as seen from there, 0 for what has no place.
    is_delay : bool
        Whether it is a delay, along which a fit's cost is wavy: fits go over its whole range.
    ends_form : bool
        Whether its bounds are where the form ends (a function that repeats itself, friction as
        abrupt as it is integrated), not where joints do: values there speak for no other effect.
    """

    name: str
    symbol: str
    unit: str
    nominal: float
    lower: float
    upper: float
    description: str
    null: float | None = None
    plain: float | None = None
    spread: float | None = None
    with_level: int = 0
    is_delay: bool = False
    ends_form: bool = False

    @property
    def endless(self) -> bool:
        """Whether the effect vanishes as this grows without end: the stiffness of a link."""
        return self.null == float("inf")

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(f"{self.name}: lower bound {self.lower} is not below {self.upper}")
        if not self.lower <= self.nominal <= self.upper:
            raise ValueError(f"{self.name}: nominal {self.nominal} lies outside its bounds")
