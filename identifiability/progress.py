"""How long work says how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Told what is done, how many parts are done, and of how many; from any thread."""


def silent(what: str, done: int, total: int) -> None:
    """Say nothing."""
