"""Tables from MATLAB files of any version."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import io

from identifiability.errors import InputError
from identifiability.measurement.columns import Columns
from identifiability.measurement.tables import EXAMPLE, Table

Variables = dict[str, "NDArray[Any] | dict[str, NDArray[Any]]"]


def mat_variables(path: Path) -> Variables:
    """Numeric matrices of a MATLAB file, and structs of them, by name."""
    try:
        if h5py.is_hdf5(path):
            return _hdf5_variables(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about class objects, left out below
            contents = io.loadmat(path)
    except Exception as error:  # the parsers raise nearly anything on a damaged file
        raise InputError(
            f"the file cannot be read as a MATLAB file ({type(error).__name__}): "
            "save it again with MATLAB's save"
        ) from None
    variables: Variables = {}
    for name, value in contents.items():
        if name.startswith("__") or isinstance(value, io.matlab.MatlabOpaque):
            continue
        if _is_matrix(value):
            variables[name] = value
        elif isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            fields = {field: value[field].item() for field in value.dtype.names}
            variables[name] = {field: v for field, v in fields.items() if _is_matrix(v)}
    return {name: value for name, value in variables.items() if len(value)}


def _hdf5_variables(path: Path) -> Variables:
    variables: Variables = {}
    with h5py.File(path) as file:
        for name, value in file.items():
            if isinstance(value, h5py.Group) and not name.startswith("#"):
                fields = {field: _hdf5_matrix(v) for field, v in value.items()}
                variables[name] = {field: v for field, v in fields.items() if v is not None}
            elif (matrix := _hdf5_matrix(value)) is not None:
                variables[name] = matrix
    return {name: value for name, value in variables.items() if len(value)}


def _hdf5_matrix(value: object) -> NDArray[Any] | None:
    if not isinstance(value, h5py.Dataset) or value.attrs.get("MATLAB_class") == b"char":
        return None
    matrix = np.asarray(value[()]).T  # MATLAB stores by columns
    return matrix if _is_matrix(matrix) else None


def _is_matrix(value: object) -> bool:
    return (
        isinstance(value, np.ndarray)
        and value.dtype.kind in "biuf"
        and value.ndim == 2
        and value.size > 1
    )


def _is_vector(value: NDArray[Any]) -> bool:
    return min(value.shape) == 1


def mat_table(variables: Variables, variable: str | None, columns: Columns | None) -> Table:
    """Table of one variable, a matrix or a struct of vectors."""
    chosen = _chosen(variables, variable, columns)
    if isinstance(chosen, dict):
        vectors = {name: value.ravel() for name, value in chosen.items() if _is_vector(value)}
        longest = max((vector.size for vector in vectors.values()), default=0)
        return Table(tuple(vectors.values()), tuple(vectors), range(1, longest + 1))
    if _is_vector(chosen):
        raise InputError(
            f"the variable is one vector of {chosen.size} values, where torque and angle are "
            f"needed: name a matrix or a struct; {_listed(variables)}"
        )
    if columns is None:
        raise InputError(
            "a matrix has no header: name its columns by index, which counts from 0, such as "
            f"{EXAMPLE}; {_listed(variables)}"
        )
    notes: tuple[str, ...] = ()
    if chosen.shape[0] < chosen.shape[1]:
        chosen, notes = chosen.T, ("matrix transposed (channels were in rows)",)
    return Table(tuple(chosen.T), None, range(1, len(chosen) + 1), notes=notes)


def _chosen(
    variables: Variables, variable: str | None, columns: Columns | None
) -> NDArray[Any] | dict[str, NDArray[Any]]:
    if variable is not None:
        if variable not in variables:
            raise InputError(
                f"there is no numeric variable {variable!r} in the file: {_listed(variables)}"
            )
        return variables[variable]
    arrays = {name: v for name, v in variables.items() if not isinstance(v, dict)}
    structs = [v for v in variables.values() if isinstance(v, dict)]
    vectors = {name: v for name, v in arrays.items() if _is_vector(v)}
    matrices = [v for v in arrays.values() if not _is_vector(v)]
    named = [] if columns is None else [column for column, _ in columns.values()]
    if named and all(name in vectors for name in named):
        return vectors
    if len(matrices) == 1:
        return matrices[0]
    if not matrices and len(structs) == 1:
        return structs[0]
    if not matrices and not structs and len(vectors) > 1:
        return vectors
    raise InputError(
        f"the file does not hold one matrix or one struct: name a variable; {_listed(variables)}"
    )


def _listed(variables: Variables) -> str:
    if not variables:
        return "the file holds no numeric matrix or struct"
    found = [
        f"{name} (struct of {', '.join(value)})"
        if isinstance(value, dict)
        else f"{name} ({value.shape[0]} x {value.shape[1]})"
        for name, value in variables.items()
    ]
    return f"the file holds {', '.join(found)}"
