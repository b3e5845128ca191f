"""Parameters that the data leave open, in words."""

from __future__ import annotations

from identifiability.investigation.verdict.pinned import Loose
from identifiability.investigation.wording.verdict import plain
from identifiability.joint.parameters import with_unit
from identifiability.numerals import number


def loose_sentence(loose: Loose) -> str:
    """How a parameter is left open."""
    name = plain(loose.name)
    upper = with_unit(number(loose.high), loose.unit)
    if loose.how == "nothing":
        return f"{name} is small, or nothing at all: at most {upper} (95 %)."
    if loose.how == "wide":
        return f"{name} is hardly known: anywhere from {number(loose.low)} to {upper} (95 %)."
    sides = "below or above" if loose.how == "both" else loose.how
    return f"The data do not bound {name} {sides}."
