"""Variables of MATLAB files up to version 7."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy import io

from identifiability.measurement.readers.variables import Variables, is_matrix


def variables_of_5(path: Path) -> tuple[Variables, bool]:
    """Numeric matrices of the file, and structs of them, by name; and whether there are objects."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about objects, which have no name here
        contents = io.loadmat(path)
    variables: Variables = {}
    has_objects = False
    for name, value in contents.items():
        if isinstance(value, io.matlab.MatlabOpaque):
            has_objects = True
        elif name.startswith("__"):
            continue
        elif is_matrix(value):
            variables[name] = value
        elif isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            fields = {field: value[field].item() for field in value.dtype.names}
            variables[name] = {field: v for field, v in fields.items() if is_matrix(v)}
    return variables, has_objects
