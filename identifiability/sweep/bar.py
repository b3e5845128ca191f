"""How far a sweep is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from tqdm import tqdm

_SECONDS_BETWEEN_LINES = 10.0


class Bar:
    """A bar on a terminal, a line now and then elsewhere."""

    def __init__(self, label: str, total: int, resumed: int, shown: bool) -> None:
        self.label, self.total, self.resumed, self.shown = label, total, resumed, shown
        self.done = self.failed = 0
        self.start = self.last = time.monotonic()

    def __enter__(self) -> Bar:
        self.stream: TextIO = sys.stderr
        self.bar = None
        if self.shown and self.stream.isatty():
            self.bar = tqdm(
                total=self.total, initial=self.resumed, desc=self.label, file=self.stream
            )
        return self

    def advance(self, failed: bool) -> None:
        """Count one more task."""
        self.done += 1
        self.failed += failed
        if self.bar is not None:
            if self.failed:
                self.bar.set_postfix(failed=self.failed, refresh=False)
            self.bar.update()
        elif self.shown and time.monotonic() - self.last > _SECONDS_BETWEEN_LINES:
            self.last = time.monotonic()
            self._line()

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
        elif self.shown:
            self._line()

    def _line(self) -> None:
        finished = self.resumed + self.done
        text = f"{self.label}: {finished} of {self.total}"
        if self.resumed:
            text += f", {self.resumed} of them from an earlier run"
        if self.failed:
            text += f", {self.failed} failed"
        if self.done:
            rate = self.done / max(time.monotonic() - self.start, 1e-9)
            text += f", {rate:.2g}/s"
            left = self.total - finished
            if left:
                text += f", {tqdm.format_interval(left / rate)} left"
        self.stream.write(text + "\n")
        self.stream.flush()
