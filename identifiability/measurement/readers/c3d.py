"""Tables of the analog channels of C3D files, as motion laboratories record them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identifiability.measurement.readers.apart import apart
from identifiability.measurement.readers.extras import require
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.variables import Variables, named, table_of

_GROUP = "ANALOG"


def read_c3d(path: Path, options: Options) -> Table:
    """Table of all analog channels, with their labels and units, and the time of their rate."""
    options.refuse_variable(path.suffix)
    require("ezc3d", path.suffix)
    return table_of(apart(variables, path, "C3D"), options)


def variables(path: Path) -> Variables:
    """Analog channels of a file, as one group of vectors."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    parameters, analogs = file["parameters"][_GROUP], file["data"]["analogs"][0]
    rate = float(parameters["RATE"]["value"][0])
    labels = [*parameters["LABELS"]["value"], *[""] * len(analogs)]
    units = [*parameters["UNITS"]["value"], *[""] * len(analogs)]
    channels = {"time (s)": np.arange(analogs.shape[1])[:, None] / rate} if len(analogs) else {}
    for i, values in enumerate(analogs):
        channels[named(labels[i].strip() or f"channel {i}", units[i])] = values[:, None]
    return {_GROUP: channels}
