"""Runs tasks in other processes, many together or a suspect alone.

A worker that dies or hangs breaks the whole pool, and it is unknown whose fault that was: the tasks
that were under way are run again, each alone in a process of its own, and only the culprit is
recorded as failed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
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
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from identifiability.errors import InputError
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.worker import attempt, prepare, sentence, solitary

_CONTEXT = multiprocessing.get_context("spawn")

# One thread a worker. Libraries read these when they are loaded, so they must be in place before
# the worker starts: an initialiser is too late if the main module imports numpy.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NPROC": "1",  # size of XLA's own pool
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


class Runner:
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
            self.workers, _CONTEXT, initializer=prepare, initargs=(self.lifeline,)
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

        Raises
        ------
        InputError
            Where what the executor reaches is gone.
        """
        executor = make()
        running: dict[Future[tuple[Arrays, float]], str] = {}
        try:
            while missing or running:
                while missing and len(running) < 2 * self.workers:
                    name = missing[0]
                    trace = None if alien else self._trace(name)
                    future = executor.submit(
                        attempt, self.function, self.tasks[name], self.timeout_s, trace
                    )
                    running[future] = missing.popleft()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    if future.cancelled():
                        raise self._lost(len(missing) + len(running))
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
            target=solitary,
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
            self.finish(Outcome(name, "failed", cause=sentence(error)), trace)

    def _lost(self, missing: int) -> InputError:
        return InputError(
            f"lost the scheduler, or the connection to it, with {missing} of {len(self.tasks)} "
            "tasks missing; what is finished is kept: start it again, or leave it out, and type "
            "the same command"
        )

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


def _death(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        name = signal.Signals(-exitcode).name
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return f"its process was killed by {name}{hint}"
    return f"its process ended with exit code {exitcode}"


@contextmanager
def lifeline() -> Iterator[Connection]:
    """Give the reading end of a pipe that closes when the sweep ends, however it ends."""
    reader, writer = _CONTEXT.Pipe(duplex=False)
    try:
        yield reader
    finally:
        writer.close()
        reader.close()


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
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
