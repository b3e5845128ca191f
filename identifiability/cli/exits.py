"""How a command ends: exit codes, and what is said of work that failed."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from identifiability.sweep.outcome import Outcome

USAGE, PARTIAL, INTERRUPTED = 2, 3, 130


def complain(outcomes: Iterable[Outcome], folder: Path, *, again: str = "the same command") -> bool:
    """Say in a sentence which tasks of a sweep have failed, if any have, and return whether."""
    outcomes = list(outcomes)
    failed = [outcome for outcome in outcomes if outcome.status != "done"]
    if failed:
        first = failed[0]
        print(
            f"identifiability: {len(failed)} of {len(outcomes)} tasks have no result (the first, "
            f"{first.name}: {first.cause}); {folder / 'log.jsonl'} says more, and {again} "
            "tries them again",
            file=sys.stderr,
        )
    return bool(failed)
