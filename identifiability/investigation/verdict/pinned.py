"""Which parameters of the final model the data do not pin down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.inference.widths import Width, Widths

_NOTHING = 1e-3  # share of an upper end that is none


@dataclass(frozen=True)
class Loose:
    """A parameter that the data leave open.

    Attributes
    ----------
    name, unit : str
    how : {"nothing", "below", "above", "both", "wide"}
        It may be nothing at all, up to `high`; it is not bounded below, above or either way; its
        interval is wide.
    low, high : float
        95 % interval.
    """

    name: str
    unit: str
    how: Literal["nothing", "below", "above", "both", "wide"]
    low: float
    high: float


def interval(row: Width) -> tuple[float, float, str]:
    """95 % interval of a parameter, and whether it is the posterior's or the profile's.

    The profile's where the sampler did not converge.
    """
    if row.verdict == "not converged":
        return (*row.profile_95, "profile")
    return (*row.posterior_95, "posterior")


def not_pinned_down(found: Widths, loose: float) -> tuple[Loose, ...]:
    """Parameters that the data leave open.

    Parameters
    ----------
    found : Widths
        Of the final model.
    loose : float
        Half the interval over the value from which a parameter counts as not pinned down.
    """
    out = []
    for row in found.rows:
        low, high, _ = interval(row)
        below, above = (side == "open" for side in row.profile_sides)
        how: Literal["nothing", "below", "above", "both", "wide"]
        if row.profile_sides == ("bound", "closed") and abs(row.optimum) < _NOTHING * high:
            how = "nothing"
        elif below or above:
            how = "both" if below and above else "below" if below else "above"
        elif np.isfinite(high - low) and 0.5 * (high - low) > loose * abs(row.optimum):
            how = "wide"
        else:
            continue
        out.append(Loose(row.name, row.unit, how, low, high))
    return tuple(out)
