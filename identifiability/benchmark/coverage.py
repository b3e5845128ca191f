"""Coverage: whether intervals of K, B and I hold the truth as often as they say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from identifiability.benchmark.noisy_recordings import KINDS, recording
from identifiability.benchmark.score import wilson
from identifiability.inference.curvature import NORMAL_95, curvature
from identifiability.inference.recordings import fit_with_noise
from identifiability.provenance import stamp
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

NAMES = ("K", "B", "I")
MARK = (0.92, 0.97)
"""Coverage of 95 % intervals that is asked for."""

_PER_TASK = 25


@dataclass(frozen=True)
class Task:
    """Some recordings of one kind.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    imposed : {"torque", "angle"}
    seed : int
    first, last : int
        Numbers of the recordings, the last excluded.
    """

    kind: str
    imposed: Literal["torque", "angle"]
    seed: int
    first: int
    last: int


@dataclass(frozen=True)
class Row:
    """Coverage of one parameter under one noise.

    Attributes
    ----------
    kind, imposed, name : str
    n : int
        Recordings that were fitted.
    failed : int
        Those that were not.
    covered : int
        Those whose 95 % interval holds the truth.
    interval : (float, float)
        Wilson's 95 % interval of the coverage.
    bias : float
        Mean error, in stated standard deviations.
    scatter : float
        Standard deviation of the error, in stated ones: 1 where they are right.
    width : float
        Median stated standard deviation, as a share of the true value.
    """

    kind: str
    imposed: str
    name: str
    n: int
    failed: int
    covered: int
    interval: tuple[float, float]
    bias: float
    scatter: float
    width: float


def errors(task: Task) -> Arrays:
    """Errors of K, B and I and their stated standard deviations, for each recording of a task.

    Returns
    -------
    dict of str to array
        ``error``, ``sd`` and ``truth``, each of shape (n, 3); NaN where the fit failed.
    """
    n = task.last - task.first
    error, sd, truth = np.full((3, n, len(NAMES)), np.nan)
    for i in range(n):
        seed = np.random.SeedSequence(
            [task.seed, KINDS.index(task.kind), task.imposed == "angle", task.first + i]
        )
        trials, truth[i] = recording(task.kind, task.imposed, seed)
        try:
            noisy = fit_with_noise(trials)
        except ValueError:
            continue
        covariance = curvature(noisy.problem, noisy.fit.values).covariance
        with np.errstate(invalid="ignore"):
            sd[i] = np.sqrt(np.diag(covariance))
        error[i] = noisy.fit.values - truth[i]
    return {"error": error, "sd": sd, "truth": truth}


def measure(
    n: int,
    *,
    seed: int = 1,
    kinds: Sequence[str] = KINDS,
    folder: Path | None = None,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
) -> tuple[list[Row], list[Outcome]]:
    """Fit so many recordings of every kind, in both causalities, and count.

    Parameters
    ----------
    n : int
        Recordings of each kind.
    seed : int
    kinds : sequence of str
    folder, workers, executor, progress
        See `sweep`.
    """
    tasks = {
        f"{kind}, {imposed} imposed, {first} on": Task(
            kind, imposed, seed, first, min(n, first + _PER_TASK)
        )
        for kind in kinds
        for imposed in ("torque", "angle")
        for first in range(0, n, _PER_TASK)
    }
    outcomes = sweep(
        errors,
        tasks,
        folder=folder,
        label="coverage",
        workers=workers,
        executor=executor,
        progress=progress,
    )
    rows = []
    for kind in kinds:
        for imposed in ("torque", "angle"):
            found = [
                outcomes[name].arrays
                for name, task in tasks.items()
                if (task.kind, task.imposed) == (kind, imposed)
            ]
            rows += _rows(kind, imposed, [arrays for arrays in found if arrays is not None])
    return rows, list(outcomes.values())


def _rows(kind: str, imposed: str, found: Sequence[Arrays]) -> list[Row]:
    if not found:
        return []
    error, sd, truth = (np.concatenate([f[key] for f in found]) for key in ("error", "sd", "truth"))
    fitted = np.all(np.isfinite(sd), axis=1)
    rows = []
    for i, name in enumerate(NAMES):
        scaled = error[fitted, i] / sd[fitted, i]
        covered, n = int(np.sum(np.abs(scaled) < NORMAL_95)), int(fitted.sum())
        rows.append(
            Row(
                kind,
                imposed,
                name,
                n,
                int(np.sum(~fitted)),
                covered,
                wilson(covered, n),
                float(scaled.mean()),
                float(scaled.std()),
                float(np.median(sd[fitted, i] / truth[fitted, i])),
            )
        )
    return rows


def record(rows: Sequence[Row], *, n: int, seed: int) -> dict[str, Any]:
    """Plain record of rows, for JSON."""
    return {
        "schema": 1,
        **stamp(__name__),
        "recordings": n,
        "seed": seed,
        "mark": list(MARK),
        "rows": [asdict(row) for row in rows],
    }
