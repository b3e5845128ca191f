"""K, B and I of blind joints that miss nothing: whether an investigation's intervals hold them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.benchmark.blind import BlindSpec, blind_cases
from identifiability.benchmark.score import wilson
from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.session import Investigation, evaluations_of
from identifiability.provenance import stamp
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

FAR = 3.5
"""Stated standard deviations that an error of one interval in 2,000 has, were it normal."""

Way = Literal["auto", "straight"]
WAYS: tuple[Way, ...] = ("auto", "straight")
"""How a torque is taken to run between its samples: as the response tells, or, as a control,
straight in all cases."""


@dataclass(frozen=True)
class Row:
    """Coverage of 95 % intervals in one kind of noise, K, B and I together.

    Attributes
    ----------
    imposed, noise : str
    way : str
        One of `WAYS`.
    n, covered, far : int
        Intervals; those that hold the truth; errors of more than `FAR` standard deviations.
    interval : (float, float)
        Wilson's 95 % interval of the coverage.
    largest : float
        Largest error, in stated standard deviations.
    error : float
        Median error, as a share of the true value.
    """

    imposed: str
    noise: str
    way: str
    n: int
    covered: int
    far: int
    interval: tuple[float, float]
    largest: float
    error: float


def errors(spec: BlindSpec) -> Arrays:
    """Errors of K, B and I, stated standard deviations and truth, by way, shape (n_ways, 3)."""
    case = spec.build()
    true = np.array(list(case.joint.values()))
    found = np.full((2, len(WAYS), 3), np.nan)
    for i, way in enumerate(WAYS):
        if way != "auto" and spec.imposed == "angle":
            found[:, i] = found[:, 0]
            continue
        study = Investigation(case.fit, case.held_out, torque_between=way)
        with threadpool_limits(1):
            weighed = evaluations_of(study, spec.seed)
            best = weighed.evaluate(study.model, [study.baseline.values])
        found[0, i] = [best.values[name] for name in case.joint] - true
        found[1, i] = [best.sds[name] for name in case.joint]
    return {"error": found[0], "sd": found[1], "truth": true}


def measure(
    n: int,
    *,
    seed: int,
    folder: Path | None = None,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
) -> tuple[list[Row], list[Outcome]]:
    """Fit K, B and I to so many blind joints that miss nothing, half with the angle imposed.

    Parameters
    ----------
    n : int
    seed : int
        Every seed makes other cases.
    folder, workers, executor, progress
        See `sweep`.
    """
    tasks = {spec.name: spec for spec in blind_cases("nulls", seed, n)}
    outcomes = sweep(
        errors,
        tasks,
        folder=folder,
        label="nulls",
        workers=workers,
        executor=executor,
        progress=progress,
    )
    done = [(spec, arrays) for name, spec in tasks.items() if (arrays := outcomes[name].arrays)]
    rows = []
    for imposed in ("torque", "angle"):
        mine = [(spec, arrays) for spec, arrays in done if spec.imposed == imposed]
        noises = sorted({spec.noise for spec, _ in mine})
        for i, way in enumerate(WAYS[: 1 + (imposed == "torque")]):
            rows += [
                _row(imposed, noise, way, [a for s, a in mine if s.noise == noise], i)
                for noise in noises
            ]
    return rows, list(outcomes.values())


def _row(imposed: str, noise: str, way: str, found: Sequence[Arrays], i: int) -> Row:
    error = np.concatenate([arrays["error"][i] for arrays in found])
    sd = np.concatenate([arrays["sd"][i] for arrays in found])
    truth = np.concatenate([arrays["truth"] for arrays in found])
    off = np.abs(error) / np.maximum(sd, 1e-300)
    covered = int(np.sum(off < NORMAL_95))
    return Row(
        imposed,
        noise,
        way,
        off.size,
        covered,
        int(np.sum(off > FAR)),
        wilson(covered, off.size),
        float(off.max()),
        float(np.median(np.abs(error) / truth)),
    )


def record(rows: Sequence[Row], *, n: int, seed: int) -> dict[str, Any]:
    """Plain record of rows, for JSON."""
    return {
        "schema": 1,
        **stamp(__name__),
        "cases": n,
        "seed": seed,
        "far": FAR,
        "rows": [asdict(row) for row in rows],
    }
