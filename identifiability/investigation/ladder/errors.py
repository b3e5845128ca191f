"""How much of a misfit is gone from one model to another."""

from __future__ import annotations

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.split import Split


def removed_share(split: Split, before: Candidate, after: Candidate) -> float | None:
    """Share of the misfit beyond the noise that is gone from one model to another.

    On the held-out trials where there are any; ``None`` where there was no misfit.
    """
    held = bool(split.held_out)
    first, last = ((c.held_out if held else c.fitted).error for c in (before, after))
    floor = split.noise_floor(split.held_out if held else split.fitted) or 0.0
    if first <= floor:
        return None
    return float((first - max(last, floor)) / (first - floor))
