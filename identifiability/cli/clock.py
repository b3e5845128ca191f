"""How far a command is: one line on a terminal, one line a step elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

_TOLD_APART = 0.1  # seconds between two lines of one step
_TICK, _SILENCE = 1.0, 10.0  # seconds between two lines of work that says nothing: terminal, file


class Clock:
    """Says on standard error what is done, since when, and how long the step will take.

    While it is entered (``with Clock() as progress``) it goes on to say so where the work itself is
    silent, so that a long part of a step is told from one that hangs.

    Parameters
    ----------
    name : str
        Of what is worked on, where that is one of several.
    """

    def __init__(self, name: str = "") -> None:
        self._name = f"{name}: " if name else ""
        self._began, self._lock = time.monotonic(), threading.Lock()
        self._step, self._since, self._told = "", self._began, 0.0
        self._parts = ""
        self._over = threading.Event()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Say what is done, how many parts are done, and of how many; from any thread."""
        with self._lock:
            now = time.monotonic()
            if what != self._step:
                self._step, self._since, self._told = what, now, 0.0
            elif now - self._told < _TOLD_APART and done < total:
                return
            left = (now - self._since) * (total - done) / max(done - 1, 1)
            self._parts = f" {done}/{total}" if total > 1 else ""
            said = f", {left:.0f} s left of this" if total > 1 < done and left >= 1 else ""
            self._say(now, said, ends=done >= total > 1)

    def __enter__(self) -> Clock:
        """Go on saying what is done."""
        threading.Thread(target=self._tick, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Say no more."""
        with self._lock:
            self._over.set()

    def _say(self, now: float, added: str, *, ends: bool) -> None:
        self._told = now
        line = f"[{now - self._began:5.0f} s] {self._name}{self._step}{self._parts}{added}"
        if sys.stderr.isatty():
            # The last one stays, and the cursor with it: the next begins it anew.
            sys.stderr.write(f"\r\x1b[K{line}" + ("\n" if ends else ""))
        else:
            sys.stderr.write(f"{line}\n")
        sys.stderr.flush()

    def _tick(self) -> None:
        silence = _TICK if sys.stderr.isatty() else _SILENCE
        while not self._over.wait(silence / 4):
            with self._lock:
                now = time.monotonic()
                if self._step and not self._over.is_set() and now - self._told >= silence:
                    self._say(now, ", at work", ends=False)
