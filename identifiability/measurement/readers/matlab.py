"""Tables from MATLAB files of any version."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from identifiability.errors import InputError
from identifiability.measurement.readers.apart import apart
from identifiability.measurement.readers.extras import INSTALL, is_installed
from identifiability.measurement.readers.matlab5 import variables_of_5
from identifiability.measurement.readers.matlab73 import variables_of_73
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.variables import Variables, is_matrix, table_of

_LIBRARY = "matio"


def read_matlab(path: Path, options: Options) -> Table:
    """Table of one variable: a matrix, a struct of vectors, a table, or an object that has these.

    Tables, timetables and objects of classes are read by a library of their own, which is optional,
    and where they are asked for, or nothing else is there.
    """
    found, objects = apart(variables, path, "a MATLAB file")
    if objects and (not found or options.variable not in (None, *found)):
        if not is_installed(_LIBRARY):
            raise InputError(
                "the file holds tables or objects of MATLAB's, which are read with mat-io: "
                f"{INSTALL}, or save matrices or structs"
            )
        found |= objects
    return table_of(found, options)


def variables(path: Path) -> tuple[Variables, Variables]:
    """Numeric variables of the file, and those that are parts of objects."""
    found, has_objects = variables_of_73(path) if h5py.is_hdf5(path) else variables_of_5(path)
    objects: Variables = {}
    if has_objects and is_installed(_LIBRARY):
        import matio

        for name, value in matio.load_from_mat(str(path)).items():
            objects |= {} if name in found else _parts(name, value)
    elif has_objects:
        objects[""] = {}
    return found, objects


def _parts(name: str, value: Any) -> Variables:
    """Vectors of a table or an object as a struct of its name, its matrices as variables."""
    if hasattr(value, "columns"):  # a table or timetable, as a data frame
        fields = {str(column): np.asarray(value[column])[:, None] for column in value.columns}
        if hasattr(value.index, "total_seconds"):
            fields = {"time (s)": np.asarray(value.index.total_seconds())[:, None]} | fields
    else:
        fields = dict(getattr(value, "properties", None) or {})
    fields = {field: v for field, v in fields.items() if is_matrix(v)}
    parts: Variables = {f"{name}.{f}": v for f, v in fields.items() if min(v.shape) > 1}
    vectors = {f: v for f, v in fields.items() if min(v.shape) == 1}
    return parts | ({name: vectors} if vectors else {})
