"""Variables of MATLAB files of version 7.3, which are HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from identifiability.measurement.readers.variables import Variables, is_matrix


def variables_of_73(path: Path) -> tuple[Variables, bool]:
    """Numeric matrices of the file, and structs of them, by name; and whether there are objects."""
    variables: Variables = {}
    has_objects = False
    with h5py.File(path) as file:
        for name, value in file.items():
            if name.startswith("#"):
                continue
            if "MATLAB_object_decode" in value.attrs:
                has_objects = True
            elif isinstance(value, h5py.Group):
                fields = {field: _matrix(v) for field, v in value.items()}
                variables[name] = {field: v for field, v in fields.items() if v is not None}
            elif (matrix := _matrix(value)) is not None:
                variables[name] = matrix
    return variables, has_objects


def _matrix(value: object) -> NDArray[Any] | None:
    if not isinstance(value, h5py.Dataset) or value.attrs.get("MATLAB_class") == b"char":
        return None
    matrix = np.asarray(value[()]).T  # MATLAB stores by columns
    return matrix if is_matrix(matrix) else None
