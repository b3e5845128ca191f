"""The formats that are read, by how files' names end: a reader is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from identifiability.errors import InputError
from identifiability.measurement.readers.bids import MOTION, SIDECARS, read_bids
from identifiability.measurement.readers.c3d import read_c3d
from identifiability.measurement.readers.hdf5 import read_hdf5
from identifiability.measurement.readers.matlab import read_matlab
from identifiability.measurement.readers.opensim import read_opensim
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.tdms import read_tdms
from identifiability.measurement.readers.text import read_text

Reader = Callable[[Path, Options], Table]
"""Reads a file, which exists and is not empty, as a table of named or numbered columns.

It raises `InputError` with one sentence that says what was found, what is expected and how to mend
it; the file's name is put before it. Units, sign, sampling and the choice of columns are none of
its business: they are treated alike for every format.
"""

READERS: dict[str, Reader] = {
    ".csv": read_text,
    ".tsv": read_text,
    ".txt": read_text,
    ".dat": read_text,
    ".mat": read_matlab,
    ".sto": read_opensim,
    ".mot": read_opensim,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".c3d": read_c3d,
    ".tdms": read_tdms,
    MOTION: read_bids,
}
"""End of the name in lower case -> reader; the longest that fits.

``docs/extend.md`` has an example of one's own.
"""


def reader_of(path: Path) -> Reader | None:
    """What reads a file, by its name."""
    ends = [end for end in READERS if path.name.lower().endswith(end)]
    return READERS[max(ends, key=len)] if ends else None


def _is_trial(path: Path) -> bool:
    return reader_of(path) is not None and not path.name.lower().endswith(SIDECARS)


def readable_files(paths: Sequence[Path]) -> list[Path]:
    """Files as named, folders replaced by the files in them that can be read, sorted by name.

    Raises
    ------
    InputError
        If nothing in a folder can be read.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(f for f in path.iterdir() if _is_trial(f) and f.is_file())
        if not inside:
            raise InputError(
                f"found none of {', '.join(READERS)} in the folder {path}; name files, one a trial"
            )
        found += inside
    return found
