"""Compiled programs, and the memory maps that they hold."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import jax

_MAPS, _LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")

# Counting maps takes milliseconds; between two counts fewer are added than are left free.
_EVERY, _SHARE = 16, 0.6

_calls = count()


def make_room() -> None:
    """Drop compiled programs before they use up the process's memory maps.

    Each holds about a hundred maps. Linux allows a process 65,530 by default, and the compiler
    aborts the process that asks for more: a long session, with models and records of many sizes,
    gets there. What is dropped is compiled again, or read from the cache on disk, when needed.
    """
    if next(_calls) % _EVERY == 0 and _nearly_full():
        jax.clear_caches()


def _nearly_full() -> bool:
    try:
        limit = int(_LIMIT.read_text())
        with _MAPS.open("rb") as lines:
            return sum(1 for _ in lines) > _SHARE * limit
    except (OSError, ValueError):
        return False  # not Linux: nothing is known of such a limit
