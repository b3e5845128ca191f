"""Compiled loops over samples, for recursions that no array operation does."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_LOOPS = ("loops.py", "inference/evaluation.py", "inference/likelihood/*.py", "joint/native/*.py")


def compiled_loop(function: F) -> F:
    """Compile a function on arrays when it is first called, and keep it on disk.

    Other threads run while it does. What is divided by 0 is infinite, or no number.
    """
    with _kept() as cache:
        return cast(F, numba.njit(cache=cache, nogil=True, error_model="numpy")(function))


class CompiledAddress:
    """A function to be called at its address, compiled when it is first asked for that.

    Parameters
    ----------
    function : callable
    n_arguments : int
        Of addresses that it takes.
    """

    def __init__(self, function: Callable[..., None], n_arguments: int) -> None:
        self._function, self._n_arguments = function, n_arguments
        self._lock = Lock()
        self._compiled: Any = None

    @property
    def address(self) -> int:
        """Where it is, for compiled loops."""
        return int(self._compile().address)

    @property
    def ctypes(self) -> Callable[..., None]:
        """As a function of Python."""
        return cast(Callable[..., None], self._compile().ctypes)

    def _compile(self) -> Any:
        with self._lock:
            if self._compiled is None:
                kinds = numba.types.void(*[numba.types.voidptr] * self._n_arguments)
                with _kept() as cache:
                    compile_ = numba.cfunc(kinds, cache=cache, error_model="numpy")
                    self._compiled = compile_(self._function)
            return self._compiled


def compiled_address(n_arguments: int) -> Callable[[Callable[..., None]], CompiledAddress]:
    """Compile a function to be called at its address when it is first called; keep it on disk.

    Parameters
    ----------
    n_arguments : int
        Of addresses that it takes.
    """
    return lambda function: CompiledAddress(function, n_arguments)


def stamp(package: Path = _PACKAGE) -> str:
    """What stands for the sources of all loops.

    Loops are compiled into those that call them, and Numba looks at the file of the caller alone.
    """
    sources = sorted(path for pattern in _LOOPS for path in package.glob(pattern))
    found = hashlib.sha256()
    for path in sources:
        found.update(path.read_bytes())
    return found.hexdigest()[:16]


def folder() -> Path:
    """Where what is compiled is kept."""
    config: Any = numba.config
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "identifiability"
    return Path(config.CACHE_DIR or home) / "loops" / _STAMP


@contextmanager
def _kept() -> Iterator[bool]:
    """Have Numba keep what it compiles where other sources find nothing of it."""
    config: Any = numba.config
    before, kept = config.CACHE_DIR, folder()
    try:
        kept.mkdir(parents=True, exist_ok=True)
    except OSError:
        yield False
        return
    config.CACHE_DIR = str(kept)
    try:
        yield True
    finally:
        config.CACHE_DIR = before


_STAMP = stamp()
