"""The options that say who works: processes of this machine, or a cluster's."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

from identifiability.errors import InputError

_PATIENCE_S = 10


class Workers(NamedTuple):
    """Who computes tasks, as `sweep` takes it.

    Attributes
    ----------
    workers : int or None
        How many; one per processor of this machine by default.
    executor : callable or None
        Makes the executor that reaches them, if they are not this machine's.
    """

    workers: int | None
    executor: Callable[[], Executor] | None


def add_workers_option(parser: argparse.ArgumentParser) -> None:
    """Add the number of processes, and a scheduler that has some."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="processes, of one thread each (default: one per processor)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a running dask scheduler, tcp://HOST:PORT, whose workers compute in their place",
    )


def workers_of(options: argparse.Namespace) -> Workers:
    """Who works, by the options.

    Raises
    ------
    InputError
        With less than one process, both options, no scheduler at the address, or a scheduler that
        has no workers.
    """
    if options.scheduler is None:
        if options.workers is not None and options.workers < 1:
            raise InputError(f"found --workers {options.workers}, expected 1 or more")
        return Workers(options.workers, None)
    if options.workers is not None:
        raise InputError("found --workers and --scheduler, expected one: a scheduler has its own")
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler needs dask's scheduler: pip install 'identifiability[cluster]'"
        ) from None
    try:
        client = Client(options.scheduler, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"found no scheduler at '{options.scheduler}' ({error}); start one with `dask "
            "scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
        ) from None
    threads = sum(client.nthreads().values())
    if not threads:
        raise InputError(
            f"the scheduler at '{options.scheduler}' has no workers; start some with `dask worker "
            f"{options.scheduler} --nthreads 1`"
        )
    return Workers(threads, client.get_executor)
