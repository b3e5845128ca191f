"""Files that appear in one piece or not at all."""

from __future__ import annotations

import errno
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.errors import InputError


@contextmanager
def with_room(path: Path) -> Iterator[None]:
    """Say in one sentence that the disk is full, where writing finds that.

    Raises
    ------
    InputError
        Where there is no room left for what is written to `path`.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise InputError(
            f"found no room on the disk for '{path}' ({os.strerror(error.errno)}); what was "
            "written before is kept: make room, and type the same command"
        ) from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; on success the file takes its place.

    Parameters
    ----------
    path : Path
        File to be written; its folder is made.

    Raises
    ------
    InputError
        Where the folder cannot be made, or the disk is full.
    """
    path = Path(path)
    output_folder(path.parent)
    with with_room(path):
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            # mkstemp keeps the file to its owner; a result should have the usual rights.
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text, UTF-8, with Unix line ends."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, record: Any) -> None:
    """Write a record as indented JSON; a number that is not finite is refused."""
    write_text(path, json.dumps(record, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, as NumPy's archive."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def read_arrays(path: Path) -> dict[str, np.ndarray] | None:
    """Arrays by name; ``None`` where there is no archive or one that cannot be read."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile):
        return None


def plain(value: Any) -> Any:
    """Record as JSON knows it: a number that is not finite as ``None``, tuples and arrays as lists.

    A dataclass is the dictionary of its fields.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value


def output_folder(path: Path) -> Path:
    """Make a folder for results.

    Raises
    ------
    InputError
        Where something else stands in its place or it may not be written.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make the output folder '{path}' ({error.strerror}); choose another --out"
        ) from None
    return path


def compile_cache() -> dict[str, str]:
    """Variables by which JAX keeps compiled programs, and processes share them.

    Those that are set already keep their value. They must be in place before JAX is imported.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "identifiability"
    variables = {
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
    }
    return {name: os.environ.get(name, value) for name, value in variables.items()}
