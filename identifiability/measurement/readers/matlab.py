"""Tables from MATLAB files of any version."""

from __future__ import annotations

from pathlib import Path

import h5py

from identifiability.errors import InputError
from identifiability.measurement.readers.matlab5 import variables_of_5
from identifiability.measurement.readers.matlab73 import variables_of_73
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.variables import table_of


def read_matlab(path: Path, options: Options) -> Table:
    """Table of one variable of a MATLAB file, a matrix or a struct of vectors."""
    try:
        found = variables_of_73(path) if h5py.is_hdf5(path) else variables_of_5(path)
    except Exception as error:  # the parsers raise nearly anything on a damaged file
        raise InputError(
            f"the file cannot be read as a MATLAB file ({type(error).__name__}): "
            "save it again with MATLAB's save"
        ) from None
    return table_of(found, options)
