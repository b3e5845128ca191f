"""Libraries that only some formats need, and that are not always installed."""

from __future__ import annotations

import importlib.util

from identifiability.errors import InputError

INSTALL = "pip install 'identifiability[readers]'"


def is_installed(library: str) -> bool:
    """Whether a library can be imported."""
    return importlib.util.find_spec(library) is not None


def require(library: str, suffix: str) -> None:
    """Refuse a format whose library is missing.

    Raises
    ------
    InputError
        With how to install it.
    """
    if not is_installed(library):
        raise InputError(f"reading {suffix} files takes {library}, which is not there: {INSTALL}")
