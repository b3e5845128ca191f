"""Tables from text files, whatever their separator, decimal mark and encoding."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from identifiability.errors import InputError
from identifiability.measurement.readers.tables import Options, Table, number

# In the order of trial: a decimal comma only where a decimal point does not explain the lines.
_FORMATS: Final = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (None, "."),
    (None, ","),
)


def read_text(path: Path, options: Options) -> Table:
    """Table of a text file, with its header's names where it has one."""
    options.refuse_variable(path.suffix)
    return table_of_lines(lines_of(path))


def lines_of(path: Path) -> list[tuple[int, str]]:
    """Lines of a text file with their numbers, from 1."""
    lines = re.split(r"\r\n|\r|\n", _decoded(path.read_bytes()))
    return list(enumerate(lines, start=1))


def table_of_lines(lines: Sequence[tuple[int, str]]) -> Table:
    """Table of numbered lines; the first that is neither blank nor a comment may be a header."""
    kept = [
        (row, line) for row, line in lines if line.strip() and not line.lstrip().startswith("#")
    ]
    if not kept:
        raise InputError("the file holds no data, only blank lines or comments")
    separator, decimal = _sniffed([line for _, line in kept[:50]])
    cells = [_cells(line, separator) for _, line in kept]
    rows = [row for row, _ in kept]

    names = None
    if all(number(cell, decimal) is None for cell in cells[0]):
        names = tuple(cells.pop(0))
        rows.pop(0)
        if not cells:
            raise InputError(f"the file holds a header ({', '.join(names)}) and no samples")
    width = len(cells[0]) if names is None else len(names)
    for row, found in zip(rows, cells, strict=True):
        if len(found) != width:
            first = "the first row" if names is None else "the header"
            raise InputError(
                f"row {row} has {len(found)} values, where {first} has {width}: rows must be "
                "equally long"
            )
    return Table(tuple(zip(*cells, strict=True)), names, rows, decimal)


def _decoded(content: bytes) -> str:
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            return content.decode("utf-16")
        if b"\0" not in content:
            return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" not in content:
            return content.decode("latin-1")
    raise InputError("this is not a text file: it holds bytes that no text has")


def _sniffed(lines: Sequence[str]) -> tuple[str | None, str]:
    """Separator and decimal mark that explain the most lines as rows of numbers."""

    def explained(form: tuple[str | None, str]) -> tuple[float, int]:
        share = 0.0
        for line in lines:
            cells = _cells(line, form[0])
            numeric = sum(number(cell, form[1]) is not None for cell in cells)
            share += numeric / len(cells) if numeric >= 2 else 0.0
        return share, len(_cells(lines[0], form[0])) if share == 0.0 else 0

    return max(_FORMATS, key=explained)


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [cell.strip().strip("\"'").strip() for cell in line.split(separator)]
    # Some programs end every line with a separator.
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells
