"""Many independent tasks over worker processes: resumable, and no task can take another with it.

Every finished task is one small file, named after the hash of what it depends on; a task whose
file is there is not computed again. A worker that dies or hangs breaks the whole pool, and it is
unknown whose fault that was: the tasks that were under way are run again, each alone in a process
of its own, and only the culprit is recorded as failed.
"""

from __future__ import annotations

import faulthandler
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, TextIO, TypeVar

import numpy as np
from tqdm import tqdm

from identifiability.errors import InputError
from identifiability.files import output_folder, read_arrays, write_arrays
from identifiability.provenance import fingerprint, package_version

T = TypeVar("T")
Arrays = dict[str, np.ndarray]
Status = Literal["done", "failed", "crashed", "timed out"]

_CONTEXT = multiprocessing.get_context("spawn")
_SECONDS_BETWEEN_LINES = 10.0

# One thread a worker. Libraries read these when they are loaded, so they must be in place before
# the worker starts: an initialiser is too late if the main module imports numpy.
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NPROC": "1",  # size of XLA's own pool
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one task.

    Attributes
    ----------
    name : str
    status : {"done", "failed", "crashed", "timed out"}
        It returned, raised, its process died, or it took longer than it may.
    arrays : dict of str to array, or None
        What the task returned; None unless it is done.
    cause : str
        Why it is not done, in one line.
    resumed : bool
        Whether the result was found on disk.
    seconds : float
        Time it took; NaN for a resumed task.
    """

    name: str
    status: Status
    arrays: Arrays | None = None
    cause: str = ""
    resumed: bool = False
    seconds: float = float("nan")


def sweep(
    function: Callable[[T], Arrays],
    tasks: Mapping[str, T],
    *,
    folder: Path | None,
    label: str,
    schema: int = 1,
    workers: int | None = None,
    timeout_s: float | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
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
        that happened. A task is found again by function, configuration, package version and
        `schema`. None keeps nothing.
    label : str
        Shown with the progress.
    schema : int
        To be raised when `function` comes to return something else for the same task.
    workers : int, optional
        Number of processes, one per processor by default. With an `executor` of your own: how many
        tasks it works on at once.
    timeout_s : float, optional
        Time limit for one task [s]; its process is ended.
    executor : callable, optional
        Makes another executor than the default pool of spawned processes, for example
        ``Client(address).get_executor`` of dask.distributed.
    progress : bool
        Whether to report progress on standard error.

    Returns
    -------
    dict of str to Outcome
        In the order of `tasks`. Failed tasks are tried again by the next call.

    Raises
    ------
    InputError
        With a time limit for an executor whose processes are not this function's to end.
    RuntimeError
        Where worker processes cannot be started at all.
    KeyboardInterrupt
        After Ctrl-C, with everything finished on disk.
    """
    if executor is not None and timeout_s is not None:
        raise InputError("found a time limit and an executor; only the default one can keep limits")
    workers = workers or _processors()
    with ExitStack() as stack:
        keep = stack.enter_context(_Keep(folder, function, schema))
        found: dict[str, Outcome] = {}
        for name, task in tasks.items():
            arrays = keep.find(task)
            if arrays is not None:
                found[name] = Outcome(name, "done", arrays, resumed=True)
        report = stack.enter_context(_Progress(label, len(tasks), len(found), progress))

        def finish(outcome: Outcome, trace: str = "") -> None:
            found[outcome.name] = outcome
            keep.record(label, outcome, tasks[outcome.name], trace)
            report.advance(outcome.status != "done")

        missing = deque(name for name in tasks if name not in found)
        if missing:
            traces = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sweep-")))
            lifeline = stack.enter_context(_lifeline())
            stack.enter_context(_environment(_ONE_THREAD if executor is None else {}))
            runner = _Runner(function, tasks, workers, timeout_s, traces, lifeline, finish)
            make = executor or runner.pool
            while missing:
                for suspect in runner.together(make, missing, alien=executor is not None):
                    runner.alone(suspect)
    return {name: found[name] for name in tasks}


class _Keep:
    """Results and log on disk; nothing at all without a folder."""

    def __init__(self, folder: Path | None, function: Callable[..., Any], schema: int) -> None:
        self.folder = None if folder is None else output_folder(Path(folder))
        self.identity = (
            f"{function.__module__}.{function.__qualname__}",
            package_version(),
            schema,
        )

    def __enter__(self) -> _Keep:
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
        self.log.write((json.dumps(entry) + "\n").encode())
        self.log.flush()


class _Runner:
    """Ways to run tasks: many together in a pool, or a suspect alone."""

    def __init__(
        self,
        function: Callable[[Any], Arrays],
        tasks: Mapping[str, Any],
        workers: int,
        timeout_s: float | None,
        traces: Path,
        lifeline: Connection,
        finish: Callable[..., None],
    ) -> None:
        self.function, self.tasks, self.workers = function, tasks, workers
        self.timeout_s, self.traces, self.lifeline = timeout_s, traces, lifeline
        self.numbers = {name: i for i, name in enumerate(tasks)}
        self.finish = finish

    def pool(self) -> Executor:
        """Make the default executor."""
        pool = ProcessPoolExecutor(
            self.workers, _CONTEXT, initializer=_prepare, initargs=(self.lifeline,)
        )
        try:
            pool.submit(os.getpid).result()
        except BrokenExecutor:
            raise RuntimeError(
                "worker processes die as soon as they start; a script that starts a sweep must "
                'do so under `if __name__ == "__main__":`'
            ) from None
        return pool

    def together(
        self, make: Callable[[], Executor], missing: deque[str], *, alien: bool
    ) -> list[str]:
        """Run tasks until none is missing or the executor breaks.

        Returns
        -------
        list of str
            Tasks that were under way when it broke.
        """
        executor = make()
        running: dict[Future[tuple[Arrays, float]], str] = {}
        try:
            while missing or running:
                while missing and len(running) < 2 * self.workers:
                    name = missing[0]
                    trace = None if alien else self._trace(name)
                    future = executor.submit(
                        _attempt, self.function, self.tasks[name], self.timeout_s, trace
                    )
                    running[future] = missing.popleft()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    if isinstance(future.exception(), BrokenExecutor):
                        raise BrokenExecutor
                    self._settle(future, running.pop(future))
        except BrokenExecutor:
            # Some may have finished, or have been found hanging, before the end came.
            for future in [f for f in running if f.done() and f.exception() is None]:
                self._settle(future, running.pop(future))
            return [name for name in running.values() if not self._hung(name)]
        except KeyboardInterrupt:
            for future, name in running.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    self._settle(future, name)
                future.cancel()
            raise
        finally:
            executor.shutdown(wait=not running)
        return []

    def alone(self, name: str) -> None:
        """Run one task in a process of its own."""
        reader, writer = _CONTEXT.Pipe(duplex=False)
        process = _CONTEXT.Process(
            target=_solitary,
            args=(
                self.lifeline,
                writer,
                self.function,
                self.tasks[name],
                self.timeout_s,
                self._trace(name),
            ),
        )
        process.start()
        writer.close()
        try:
            result, error, trace = reader.recv()
        except EOFError:
            process.join()
            if not self._hung(name):
                self.finish(Outcome(name, "crashed", cause=_death(process.exitcode)))
            return
        process.join()
        if error:
            self.finish(Outcome(name, "failed", cause=error), trace)
        else:
            self.finish(Outcome(name, "done", result[0], seconds=result[1]))

    def _settle(self, future: Future[tuple[Arrays, float]], name: str) -> None:
        error = future.exception()
        if error is None:
            arrays, seconds = future.result()
            self.finish(Outcome(name, "done", arrays, seconds=seconds))
        else:
            trace = "".join(traceback.format_exception(error))
            self.finish(Outcome(name, "failed", cause=_sentence(error)), trace)

    def _hung(self, name: str) -> bool:
        """Whether a task ran into its limit; if so it is finished."""
        path = self._trace(name)
        if not path.exists() or not path.stat().st_size:
            return False
        cause = f"no result within {self.timeout_s:g} s"
        self.finish(Outcome(name, "timed out", cause=cause), path.read_text())
        return True

    def _trace(self, name: str) -> Path:
        return self.traces / str(self.numbers[name])


def _prepare(lifeline: Connection) -> None:
    """Make a worker leave Ctrl-C to its parent, and end when the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    # Nothing is ever sent: the end of the stream is the message.
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(1)


def _attempt(
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


def _solitary(lifeline: Connection, writer: Connection, *attempt: Any) -> None:
    _prepare(lifeline)
    try:
        writer.send((_attempt(*attempt), "", ""))
    except Exception as error:
        writer.send((None, _sentence(error), traceback.format_exc()))


def _sentence(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _death(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        name = signal.Signals(-exitcode).name
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return f"its process was killed by {name}{hint}"
    return f"its process ended with exit code {exitcode}"


@contextmanager
def _lifeline() -> Iterator[Connection]:
    """Give the reading end of a pipe that closes when the sweep ends, however it ends."""
    reader, writer = _CONTEXT.Pipe(duplex=False)
    try:
        yield reader
    finally:
        writer.close()
        reader.close()


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Environment for the processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    if before.get("XLA_FLAGS"):
        os.environ["XLA_FLAGS"] = f"{before['XLA_FLAGS']} {variables['XLA_FLAGS']}"
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _processors() -> int:
    """Count the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Progress:
    """A bar on a terminal, a line now and then elsewhere."""

    def __init__(self, label: str, total: int, resumed: int, shown: bool) -> None:
        self.label, self.total, self.resumed, self.shown = label, total, resumed, shown
        self.done = self.failed = 0
        self.start = self.last = time.monotonic()

    def __enter__(self) -> _Progress:
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
