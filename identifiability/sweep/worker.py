"""What runs in a worker process: one task, within its time, for as long as the parent lives."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from identifiability.sweep.outcome import Arrays

T = TypeVar("T")


def prepare(lifeline: Connection) -> None:
    """Make a worker leave Ctrl-C to its parent, and end when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    # Nothing is ever sent: the end of the stream is the message.
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(1)


def attempt(
    function: Callable[[T], Arrays], task: T, timeout_s: float | None, trace: Path | None
) -> tuple[Arrays, float]:
    """Run one task in a worker; past its limit the worker writes where it was, and ends."""
    with ExitStack() as stack:
        if timeout_s is not None and trace is not None:
            file = stack.enter_context(trace.open("w"))
            # A watchdog outside of Python's control: it bites also where compiled code hangs.
            faulthandler.dump_traceback_later(timeout_s, exit=True, file=file)
            stack.callback(faulthandler.cancel_dump_traceback_later)
        start = time.perf_counter()
        arrays = {name: np.asarray(value) for name, value in function(task).items()}
        for name, array in arrays.items():
            if array.dtype.hasobject:
                raise TypeError(f"'{name}' is no array of numbers or texts")
        return arrays, time.perf_counter() - start


def solitary(lifeline: Connection, writer: Connection, *arguments: Any) -> None:
    """Make one attempt in a process of its own, and send result, cause and trace."""
    prepare(lifeline)
    try:
        writer.send((attempt(*arguments), "", ""))
    except Exception as error:
        writer.send((None, sentence(error), traceback.format_exc()))


def sentence(error: BaseException) -> str:
    """Kind of an error and its first line."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
