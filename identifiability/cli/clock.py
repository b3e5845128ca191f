"""How far a command is: one line on a terminal, one line a step elsewhere."""

from __future__ import annotations

import sys
import threading
import time

from identifiability.progress import Progress

_TOLD_APART = 0.1  # seconds between two lines of one step


def clock(name: str = "") -> Progress:
    """Say on standard error what is done, since when, and how long the step will take.

    Parameters
    ----------
    name : str
        Of what is worked on, where that is one of several.
    """
    began, lock = time.monotonic(), threading.Lock()
    step, since, last = "", began, 0.0

    def announce(what: str, done: int, total: int) -> None:
        nonlocal step, since, last
        with lock:  # several threads report
            now = time.monotonic()
            if what != step:
                step, since, last = what, now, 0.0
            elif now - last < _TOLD_APART and done < total:
                return
            last = now
            line = f"[{now - began:5.0f} s] {name}{': ' if name else ''}{what}"
            if total > 1:
                line += f" {done}/{total}"
                left = (now - since) * (total - done) / max(done - 1, 1)
                line += f", {left:.0f} s left of this" if done > 1 and left >= 1 else ""
            if sys.stderr.isatty():
                # The last one stays, and the cursor with it: the next begins it anew.
                sys.stderr.write(f"\r\x1b[K{line}" + ("\n" if done >= total > 1 else ""))
            else:
                sys.stderr.write(f"{line}\n")
            sys.stderr.flush()

    return announce
