"""Parsers in C, run in a process of their own: a damaged file may end that, and not this one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import TimeoutError
from pathlib import Path
from typing import TypeVar

from loky import get_reusable_executor
from loky.process_executor import BrokenProcessPool

from identifiability.errors import InputError

SECONDS = 30.0
"""That a file is given, and one for every megabyte."""
_SECONDS_PER_BYTE = 1e-6
_BYTES, _TIMES = 2 << 30, 20  # of memory: at least, and for each of the file
_KEPT = 60  # seconds that the process waits for the next file

Found = TypeVar("Found")


def apart(parser: Callable[[Path], Found], path: Path, what: str) -> Found:
    """What a parser finds in a file, within limits of time and of memory.

    Parameters
    ----------
    parser : callable
        At the top of a module.
    path : Path
    what : str
        The format, in words.

    Raises
    ------
    InputError
        Where the file cannot be read, or ends the parser.
    """
    size = path.stat().st_size
    seconds = SECONDS + _SECONDS_PER_BYTE * size
    process = get_reusable_executor(max_workers=1, timeout=_KEPT)
    try:
        asked = process.submit(_within, parser, path.resolve(), _BYTES + _TIMES * size)
        return asked.result(timeout=seconds)
    except TimeoutError:
        process.shutdown(kill_workers=True)
        why = f"it was not done within {seconds:.0f} s"
    except BrokenProcessPool:
        why = "its parser breaks down"
    except Exception as error:  # parsers raise nearly anything on a damaged file
        why = type(error).__name__
    raise InputError(f"the file cannot be read as {what} ({why}): save it again, and copy it anew")


def _within(parser: Callable[[Path], Found], path: Path, memory: int) -> Found:
    """What a parser finds with no more than so many bytes."""
    try:
        import resource
    except ImportError:  # not on Windows: no limit there
        return parser(path)
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (memory, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    return parser(path)
