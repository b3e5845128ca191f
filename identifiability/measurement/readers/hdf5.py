"""Tables from HDF5 files: matrices, or vectors side by side in one group."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.variables import Variables, is_matrix, named, table_of

_UNITS = ("units", "unit", "Units", "Unit")


def read_hdf5(path: Path, options: Options) -> Table:
    """Table of one matrix, one table with named fields, or one group of vectors.

    A vector with an attribute ``units`` is named with it, as ``torque (Nm)``.
    """
    try:
        with h5py.File(path) as file:
            variables = _variables(file)
    except Exception as error:  # the parser raises nearly anything on a damaged file
        raise InputError(
            f"the file cannot be read as HDF5 ({type(error).__name__}): write it again, and close "
            "it before it is copied"
        ) from None
    return table_of(variables, options)


def _variables(file: h5py.File) -> Variables:
    variables: Variables = {}

    def visit(name: str, value: object) -> None:
        if not isinstance(value, h5py.Dataset):
            return
        read = np.asarray(value[()])
        group, _, own = name.rpartition("/")
        if read.dtype.names:  # a table, such as h5py and PyTables write
            fields = {n: np.atleast_2d(read[n]).T for n in read.dtype.names}
            variables[name] = {n: v for n, v in fields.items() if is_matrix(v)}
            return
        matrix: NDArray[Any] = np.atleast_2d(read).T if read.ndim == 1 else read
        if not is_matrix(matrix):
            return
        own = named(own, _unit(value))
        if not group:
            variables[own] = matrix
        elif min(matrix.shape) > 1:
            variables[name] = matrix
        else:
            vectors = variables.setdefault(group, {})
            assert isinstance(vectors, dict)
            vectors[own] = matrix

    file.visititems(visit)
    return variables


def _unit(value: h5py.Dataset) -> str:
    found = next((value.attrs[key] for key in _UNITS if key in value.attrs), "")
    return found.decode() if isinstance(found, bytes) else str(found)
