"""Which parameters of the final model the data do not pin down."""

from __future__ import annotations

import numpy as np

from identifiability.inference.widths import Width, Widths
from identifiability.joint.parameters import with_unit

LOOSE = 0.5
"""Half the 95 % interval over the value from which a parameter counts as not pinned down: a
convention, with which its value is known to a factor of three at best."""
_NOTHING = 1e-3  # share of an upper end that is none


def interval(row: Width) -> tuple[float, float, str]:
    """95 % interval of a parameter, and whether it is the posterior's or the profile's.

    The profile's where the sampler did not converge.
    """
    if row.verdict == "not converged":
        return (*row.profile_95, "profile")
    return (*row.posterior_95, "posterior")


def not_pinned_down(found: Widths) -> tuple[str, ...]:
    """A sentence for each parameter that the data leave open.

    Parameters
    ----------
    found : Widths
        Of the final model.

    Returns
    -------
    tuple of str
    """
    out = []
    for row in found.rows:
        low, high, _ = interval(row)
        name = row.name.replace("_", " ")
        upper = with_unit(f"{high:.3g}", row.unit)
        if row.profile_sides == ("bound", "closed") and abs(row.optimum) < _NOTHING * high:
            out.append(f"{name} is small, or nothing at all: at most {upper} (95 %).")
            continue
        sides = [
            words
            for words, side in zip(("below", "above"), row.profile_sides, strict=True)
            if side == "open"
        ]
        if sides:
            out.append(f"The data do not bound {name} {' or '.join(sides)}.")
        elif np.isfinite(high - low) and 0.5 * (high - low) > LOOSE * abs(row.optimum):
            out.append(f"{name} is hardly known: anywhere from {low:.3g} to {upper} (95 %).")
    return tuple(out)
