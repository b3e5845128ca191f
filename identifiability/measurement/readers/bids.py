"""Tables of BIDS motion recordings: numbers in one file, their names and units in its sidecars."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.text import lines_of, read_text, table_of_lines
from identifiability.measurement.readers.variables import named

MOTION = "_motion.tsv"
SIDECARS = ("_channels.tsv", "_events.tsv", "_scans.tsv", "_sessions.tsv", "participants.tsv")
"""Ends of the names of tables that go with recordings, and are none."""


def read_bids(path: Path, options: Options) -> Table:
    """Table of a recording; named by its ``_channels.tsv``, timed by its ``_motion.json``."""
    table = read_text(path, options)
    stem = path.name.lower().removesuffix(MOTION)
    beside = path.with_name(path.name[: len(stem)] + "_channels.tsv")
    # Channels are the same for all tracking systems' parts of a run; one file may serve them.
    if table.names is not None or not beside.exists():
        return table
    channels = table_of_lines(lines_of(beside))
    if channels.names is None or not {"name", "units"} <= set(channels.names):
        raise InputError(
            f"its sidecar {beside.name} has no columns 'name' and 'units', as BIDS asks for: mend "
            "it, or name the columns by index"
        )
    names, units = (channels.columns[channels.index(c)] for c in ("name", "units"))
    if len(names) != len(table.columns):
        raise InputError(
            f"its sidecar {beside.name} lists {len(names)} channels, where the file has "
            f"{len(table.columns)} columns: mend it"
        )
    headers = tuple(named(str(n), str(u)) for n, u in zip(names, units, strict=True))
    table = replace(table, names=headers, notes=(*table.notes, f"channels by {beside.name}"))
    return _timed(table, path.with_suffix(".json"))


def _timed(table: Table, sidecar: Path) -> Table:
    """With the time of the sampling rate that the sidecar tells, where that is there."""
    assert table.names is not None
    if not sidecar.exists():
        return table
    try:
        rate = float(json.loads(sidecar.read_text(encoding="utf-8"))["SamplingFrequency"])
    except (ValueError, KeyError, TypeError, OSError):
        rate = np.nan
    if not 0 < rate < np.inf:
        raise InputError(
            f"its sidecar {sidecar.name} tells no SamplingFrequency above 0, as BIDS asks for: "
            "mend it"
        )
    time = np.arange(len(table.rows)) / rate
    return replace(
        table,
        columns=(time, *table.columns),
        names=("time (s)", *table.names),
        notes=(*table.notes, f"{rate:g} Hz by {sidecar.name}"),
    )
