"""Finished tasks on disk, each found again by what it depends on, its code included."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.files import output_folder, read_arrays, with_room, write_arrays
from identifiability.provenance import code_fingerprint, fingerprint
from identifiability.sweep.outcome import Arrays, Outcome


class Keep:
    """Results and log on disk; nothing at all without a folder."""

    def __init__(self, folder: Path | None, function: Callable[..., Any]) -> None:
        self.folder = None if folder is None else output_folder(Path(folder))
        # A result belongs to the code that made it, whatever the version is called.
        self.identity = (
            f"{function.__module__}.{function.__qualname__}",
            "" if folder is None else code_fingerprint(function.__module__),
        )

    def __enter__(self) -> Keep:
        self.log = None if self.folder is None else (self.folder / "log.jsonl").open("a+b")
        if self.log is not None and self.log.tell():
            # A killed run may have left half a line behind.
            self.log.seek(-1, os.SEEK_END)
            if self.log.read(1) != b"\n":
                self.log.write(b"\n")
        return self

    def __exit__(self, *_: object) -> None:
        if self.log is not None:
            self.log.close()

    def path(self, task: Any) -> Path | None:
        """File of a task's result."""
        if self.folder is None:
            return None
        return self.folder / f"{fingerprint(*self.identity, task)}.npz"

    def find(self, task: Any) -> Arrays | None:
        """Read the result of a task, if there is one that can be read."""
        path = self.path(task)
        return None if path is None else read_arrays(path)

    def failure(self, task: Any) -> str | None:
        """Why a task failed when it was last tried, if it did."""
        path = self.path(task)
        return None if path is None else self._failures.get(path.name)

    @cached_property
    def _failures(self) -> dict[str, str]:
        """Causes of the failures that the log tells of, by the file that a result would have."""
        found: dict[str, str] = {}
        if self.folder is None:
            return found
        for line in (self.folder / "log.jsonl").read_bytes().splitlines():
            try:
                entry = json.loads(line)
            except ValueError:  # half a line, or a damaged one
                continue
            found.pop(entry["file"], None)
            if entry["status"] == "failed":
                found[entry["file"]] = entry["cause"]
        return found

    def record(self, label: str, outcome: Outcome, task: Any, trace: str) -> None:
        """Write a result, then a line of the log."""
        path = self.path(task)
        if path is None or self.log is None:
            return
        if outcome.arrays is not None:
            write_arrays(path, outcome.arrays)
        entry = {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "sweep": label,
            "task": outcome.name,
            "file": path.name,
            "status": outcome.status,
            "seconds": None if np.isnan(outcome.seconds) else round(outcome.seconds, 3),
        }
        if outcome.status != "done":
            entry |= {"cause": outcome.cause, "trace": trace}
        with with_room(path):
            self.log.write((json.dumps(entry) + "\n").encode())
            self.log.flush()
