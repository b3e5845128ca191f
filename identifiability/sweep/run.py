"""A function over many tasks, in processes or on any executor, with everything finished kept.

Every finished task is one small file, named after the hash of what it depends on; a task whose
file is there is not computed again.
"""

from __future__ import annotations

import os
import tempfile
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

from identifiability.errors import InputError
from identifiability.files import compile_cache
from identifiability.sweep.bar import Bar
from identifiability.sweep.keep import Keep
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.runner import ONE_THREAD, Runner, environment, lifeline

T = TypeVar("T")


def sweep(
    function: Callable[[T], Arrays],
    tasks: Mapping[str, T],
    *,
    folder: Path | None,
    label: str,
    workers: int | None = None,
    timeout_s: float | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
    retry_failed: bool = True,
) -> dict[str, Outcome]:
    """Run a function on every task, in processes, and keep what is finished.

    Parameters
    ----------
    function : callable
        Defined at the top of a module, so that another process can import it; from a task to
        arrays (numbers and texts too, as arrays).
    tasks : mapping of str to task
        Dataclasses, mappings, sequences, numbers, texts or arrays.
    folder : Path or None
        Where finished tasks are kept, one ``.npz`` file each, with a ``log.jsonl`` of everything
        that happened. A task is found again by its own values and by the function's code, with all
        that it imports of this package (`code_fingerprint`). None keeps nothing.
    label : str
        Shown with the progress.
    workers : int, optional
        Number of processes, one per processor by default. With an `executor` of your own: how many
        tasks it works on at once.
    timeout_s : float, optional
        Time limit for one task [s]; its process is ended.
    executor : callable, optional
        Makes another executor than the default pool of spawned processes, for example
        ``Client(address).get_executor`` of dask.distributed. Its processes have as many threads
        as it gives them.
    progress : bool
        Whether to report progress on standard error.
    retry_failed : bool
        Whether tasks in which the function raised before are tried again. What took too long, or
        whose process died, always is: that hangs on the machine.

    Returns
    -------
    dict of str to Outcome
        In the order of `tasks`.

    Raises
    ------
    InputError
        With a time limit for an executor whose processes are not this function's to end, or with
        a folder for a function that comes from no file.
    RuntimeError
        Where worker processes cannot be started at all.
    KeyboardInterrupt
        After Ctrl-C, with everything finished on disk.
    """
    if executor is not None and timeout_s is not None:
        raise InputError("found a time limit and an executor; only the default one can keep limits")
    workers = workers or processors()
    with ExitStack() as stack:
        keep = stack.enter_context(Keep(folder, function))
        found: dict[str, Outcome] = {}
        for name, task in tasks.items():
            arrays = keep.find(task)
            if arrays is not None:
                found[name] = Outcome(name, "done", arrays, resumed=True)
            elif not retry_failed and (cause := keep.failure(task)) is not None:
                found[name] = Outcome(name, "failed", cause=cause, resumed=True)
        report = stack.enter_context(Bar(label, len(tasks), len(found), progress))

        def finish(outcome: Outcome, trace: str = "") -> None:
            found[outcome.name] = outcome
            keep.record(label, outcome, tasks[outcome.name], trace)
            report.advance(outcome.status != "done")

        missing = deque(name for name in tasks if name not in found)
        if missing:
            traces = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sweep-")))
            alive = stack.enter_context(lifeline())
            # Compiled programs are shared by the workers, and kept for the next sweep.
            ours = {} if executor else ONE_THREAD | compile_cache()
            stack.enter_context(environment(ours))
            runner = Runner(function, tasks, workers, timeout_s, traces, alive, finish)
            make = executor or runner.pool
            while missing:
                for suspect in runner.together(make, missing, alien=executor is not None):
                    runner.alone(suspect)
    return {name: found[name] for name in tasks}


def processors() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
