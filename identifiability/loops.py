"""Compiled loops over samples, for recursions that no array operation does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def compiled_loop(function: F) -> F:
    """Compile a function on arrays when it is first called, and keep it on disk.

    Other threads run while it does. What is divided by 0 is infinite, or no number.
    """
    return cast(F, njit(cache=True, nogil=True, error_model="numpy")(function))
