"""Comparison and location as plain records, for JSON."""

from __future__ import annotations

from typing import Any

from identifiability.files import plain
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """All numbers of a comparison, by the names of its fields.

    Returns
    -------
    dict
        As JSON has it: a standard error that is infinite, since a group does not determine the
        value, is ``None``.
    """
    record = plain(comparison)
    record["constancy"] = {aspect.pop("by"): aspect for aspect in record["constancy"]}
    return dict(record)


def location_record(location: Location) -> dict[str, Any]:
    """All numbers of a location: under "views", by name, every field of every view.

    Returns
    -------
    dict
        As JSON has it: a coherence that is not known is ``None``.
    """
    return dict(plain(location))
