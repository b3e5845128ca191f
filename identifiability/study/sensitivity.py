"""What tracking hangs on: sampling rate, noise, bounds, prior knowledge, coordinates, one draw.

The cells span the paper's grid; each is computed as in the atlas, and again with one thing changed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

from identifiability.inference.problem import Prior, Problem
from identifiability.inference.widths import WIDTH_TOLERANCE, Widths
from identifiability.measurement.noise import READINGS
from identifiability.measurement.perturbations import WINDOWS
from identifiability.provenance import stamp
from identifiability.study.atlas import TIME_LIMIT, Cell
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

K_CE, B_CE, RATIO = (10.0, 60.0, 200.0), (2.0, 8.0, 30.0), (2.0, 5.0, 10.0)
PERTURBATION = "impulse"
_DRAWS = 5  # of the noise
_NAMES = ("K", "B", "I")


@dataclass(frozen=True)
class Variant:
    """One thing that differs from the atlas.

    Attributes
    ----------
    rate : float
        Samples per second.
    correlation_time : float
        Of the noise [s].
    bounded : bool
        Whether K and B are known not to be negative.
    inertia_known : bool
        Whether the inertia is given, as from anthropometry, and not fitted.
    logarithms : bool
        Whether ellipse and posterior are compared in ln K, ln B and ln I. The posterior is that of
        the atlas: a prior that is uniform in K, B and I.
    draw : int or None
        Number of the noise's draw that is in the response; none: the expected measurement.
    """

    rate: float = 1000.0
    correlation_time: float = 0.0
    bounded: bool = True
    inertia_known: bool = False
    logarithms: bool = False
    draw: int | None = None


ATLAS = "as in the atlas"
VARIANTS: dict[str, tuple[Variant, ...]] = {
    ATLAS: (Variant(),),
    "500 samples a second": (Variant(rate=500.0),),
    "2,000 samples a second": (Variant(rate=2000.0),),
    "noise correlated over 2 ms": (Variant(correlation_time=0.002),),
    "noise correlated over 10 ms": (Variant(correlation_time=0.01),),
    "no bounds: K and B may be negative": (Variant(bounded=False),),
    "inertia known": (Variant(inertia_known=True),),
    "ellipse in the logarithms of K, B and I": (Variant(logarithms=True),),
    "one draw of the noise (five draws)": tuple(Variant(draw=i) for i in range(_DRAWS)),
}


@dataclass(frozen=True)
class Asked:
    """A cell of the atlas, and what differs from it."""

    cell: Cell
    variant: Variant

    @property
    def problem(self) -> Problem:
        """The fit that it is about."""
        cell, variant = self.cell, self.variant
        draw = variant.draw
        changed = replace(cell, rate=variant.rate, correlation_time=variant.correlation_time)
        found = changed.problem(draw=None if draw is None else cell.own_seed + draw)
        if not variant.bounded:
            found = found.with_prior(Prior.unbounded(found.model))
        return replace(found, fixed={"I": cell.I}) if variant.inertia_known else found


def tasks(seed: int = 1) -> dict[str, Asked]:
    """Every cell in every variant, by name."""
    found = {}
    for name, variants in VARIANTS.items():
        for T, reading, ratio, stiffness, damping in itertools.product(
            WINDOWS, READINGS, RATIO, K_CE, B_CE
        ):
            cell = Cell(stiffness, damping, ratio, T, PERTURBATION, reading, seed=seed)
            for i, variant in enumerate(variants):
                found[f"{name}, {i}: {cell.name}"] = Asked(cell, variant)
    return found


def evaluate(asked: Asked) -> Arrays:
    """Predicted and posterior standard deviations of K, B and I, and whether the ellipse holds."""
    problem = asked.problem
    found = asked.cell.widths(problem)
    predicted, spread = _spreads(found, logarithms=asked.variant.logarithms)
    whole = np.full((2, len(_NAMES)), np.nan)
    whole[:, list(problem.free)] = predicted, spread
    return {
        "predicted": whole[0],
        "spread": whole[1],
        "optimum": found.fit.values,
        "verdict": np.array(found.verdict),
    }


def _spreads(found: Widths, *, logarithms: bool) -> tuple[np.ndarray, np.ndarray]:
    predicted = np.array([row.quadratic for row in found.rows])
    if not logarithms:
        return predicted, np.array([row.posterior_sd for row in found.rows])
    # At an optimum the Hessian in logarithms is that in the parameters, scaled by their values.
    with np.errstate(divide="ignore", invalid="ignore"):
        return predicted / found.fit.values, np.log(found.posterior.flat).std(axis=0)


def run_sensitivity(
    folder: Path,
    *,
    seed: int = 1,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
) -> dict[str, Outcome]:
    """Compute every cell in every variant that is not in the folder yet.

    Parameters
    ----------
    folder : Path
        For finished cells.
    seed : int
    workers, executor, progress
        See `sweep`.
    """
    return sweep(
        evaluate,
        tasks(seed),
        folder=folder,
        label="sensitivity",
        workers=workers,
        executor=executor,
        timeout_s=None if executor else TIME_LIMIT,
        progress=progress,
    )


def record(outcomes: Mapping[str, Outcome], *, seed: int) -> dict[str, Any]:
    """Plain record, for JSON: by variant, reading and duration, how closely spread tracks."""
    asked = tasks(seed)
    rows = []
    for name, reading, T in itertools.product(VARIANTS, READINGS, WINDOWS):
        done = [
            outcome.arrays
            for task, outcome in outcomes.items()
            if outcome.arrays is not None
            and task.startswith(f"{name}, ")
            and (asked[task].cell.reading, asked[task].cell.T) == (reading, T)
        ]
        if done:
            rows.append({"variant": name, "reading": reading, "T": T} | _row(done))
    return {
        "schema": 1,
        **stamp(__name__),
        "seed": seed,
        "perturbation": PERTURBATION,
        "grid": {"K_CE": K_CE, "B_CE": B_CE, "ratio": RATIO, "T": WINDOWS},
        "tolerance": WIDTH_TOLERANCE,
        "variants": {name: [asdict(v) for v in found] for name, found in VARIANTS.items()},
        "cells": {
            "total": len(outcomes),
            "done": sum(o.arrays is not None for o in outcomes.values()),
        },
        "rows": rows,
    }


def _row(done: Sequence[Arrays]) -> dict[str, Any]:
    """Widths within the tolerance, with Wilson's 95 % interval, and ratios, of some cells.

    K, B and I of one fit are alike: the interval counts each fit once.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.array([a["spread"] / a["predicted"] for a in done])
    # What was not fitted has no width; a width that cannot be predicted is not near any.
    fitted = np.array([~np.isnan(a["spread"]) for a in done])
    near = fitted & (np.abs(ratio - 1) <= WIDTH_TOLERANCE)
    within, of = int(near.sum()), int(fitted.sum())
    alike = scipy.stats.binomtest(round(within / of * len(done)), len(done))
    interval = alike.proportion_ci(method="wilson")
    usable = ratio[fitted & np.isfinite(ratio)]
    return {
        "cells": len(done),
        "within": within,
        "of": of,
        "interval": [float(interval.low), float(interval.high)],
        "ratio": float(np.median(usable)),
        "holds": sum(str(a["verdict"]) == "agrees" for a in done),
    }
