"""Tables of TDMS files, as LabVIEW and FlexLogger write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from identifiability.errors import InputError
from identifiability.measurement.readers.extras import require
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.variables import Variables, named, table_of

_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit")


def read_tdms(path: Path, options: Options) -> Table:
    """Table of one group of channels, with their units; its time from the clock of its channels."""
    require("nptdms", path.suffix)
    from nptdms import TdmsFile

    try:
        groups = {g.name: g.channels() for g in TdmsFile.read(path).groups()}
        variables: Variables = {name: _channels(group) for name, group in groups.items()}
    except Exception as error:  # the parser raises nearly anything on a damaged file
        raise InputError(
            f"the file cannot be read as TDMS ({type(error).__name__}): save it again, and close "
            "it before it is copied"
        ) from None
    return table_of(variables, options)


def _channels(group: list[Any]) -> dict[str, np.ndarray]:
    """Numeric channels of a group, and their time where all have one clock."""
    read = {c: np.asarray(c[:]) for c in group}
    read = {c: v for c, v in read.items() if v.dtype.kind in "biuf" and v.size > 1}
    clocks = {(c.properties.get("wf_increment", 0.0), v.size) for c, v in read.items()}
    found = {}
    if len(clocks) == 1:
        ((step, size),) = clocks
        if step > 0:
            found["time (s)"] = np.arange(size)[:, None] * step
    for channel, values in read.items():
        told = next((channel.properties[u] for u in _UNITS if u in channel.properties), "")
        found[named(channel.name, told)] = values[:, None]
    return found
