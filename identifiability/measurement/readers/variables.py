"""Variables of a file that holds several: matrices, and structs of vectors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import EXAMPLE, Columns, Options, Table

Variables = dict[str, "NDArray[Any] | dict[str, NDArray[Any]]"]


def is_matrix(value: object) -> bool:
    """Whether a value is a matrix of real numbers, more than one."""
    return (
        isinstance(value, np.ndarray)
        and value.dtype.kind in "biuf"
        and value.ndim == 2
        and value.size > 1
    )


def _is_vector(value: NDArray[Any]) -> bool:
    return min(value.shape) == 1


def named(name: str, unit: str) -> str:
    """Header of a channel with its unit, where it has one."""
    return f"{name} ({unit.strip()})" if unit.strip() else name


def table_of(variables: Variables, options: Options) -> Table:
    """Table of one variable, a matrix or a struct of vectors; empty ones are none."""
    variables = {name: value for name, value in variables.items() if len(value)}
    chosen = _chosen(variables, options.variable, options.columns)
    if isinstance(chosen, dict):
        vectors = {name: value.ravel() for name, value in chosen.items() if _is_vector(value)}
        longest = max((vector.size for vector in vectors.values()), default=0)
        return Table(tuple(vectors.values()), tuple(vectors), range(1, longest + 1))
    if _is_vector(chosen):
        raise InputError(
            f"the variable is one vector of {chosen.size} values, where torque and angle are "
            f"needed: name a matrix or a struct; {_listed(variables)}"
        )
    if options.columns is None:
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
