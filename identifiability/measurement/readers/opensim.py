"""Tables from OpenSim's storage and motion files (.sto, .mot): text below a header of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.text import lines_of, table_of_lines
from identifiability.measurement.units import parse_unit


def read_opensim(path: Path, options: Options) -> Table:
    """Table of an OpenSim file; its header tells whether angles are in degrees."""
    options.refuse_variable(path.suffix)
    lines = lines_of(path)
    ends = (i for i, (_, line) in enumerate(lines) if line.strip().lower() == "endheader")
    end = next(ends, None)
    if end is None:
        raise InputError(
            "there is no line 'endheader', which OpenSim's files have: if this is plain text, give "
            "it the suffix .txt"
        )
    table = table_of_lines(lines[end + 1 :])
    told = {}
    for _, line in lines[:end]:
        key, equals, value = line.partition("=")
        if equals:
            told[key.strip().lower()] = value.strip().lower()
    in_degrees = told.get("indegrees")
    if in_degrees not in ("yes", "no"):
        return table
    written = "deg" if in_degrees == "yes" else "rad"
    angle = None if options.columns is None else options.columns.get("angle")
    if angle is not None and parse_unit(angle[1], "angle") != parse_unit(written, "angle"):
        raise InputError(
            f"the file's header says inDegrees={in_degrees}, and the angle is said to be in "
            f"{angle[1]}: write {written}, or mend the header"
        )
    return replace(table, notes=(*table.notes, f"angles in {written} by the file's header"))
