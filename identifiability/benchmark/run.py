"""Runs the investigation over hidden cases, on all cores, each kept as soon as it is done."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from identifiability.benchmark.cases import CaseSpec, hidden_cases
from identifiability.benchmark.score import Score, matched, outcome_of
from identifiability.investigation.session import Investigation
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

WHOLE = ("singles", "pairs", "unknown", "controls", "nulls")
TIME_LIMIT = 1800.0  # for one case [s]; the slowest take some minutes


def run_benchmark(
    tiers: Sequence[str],
    folder: Path | None,
    *,
    seeds: Sequence[int] = (1,),
    every: int = 1,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
    known: Mapping[int, Sequence[Score]] | None = None,
) -> tuple[dict[int, list[Score]], list[Outcome]]:
    """Investigate every case of some tiers; what was done before is not done again.

    Parameters
    ----------
    tiers : sequence of str
    folder : Path or None
        Where each case's score is kept.
    seeds : sequence of int
        Every seed makes other cases.
    every : int
        Take every so-many-th case.
    workers, executor, progress
        See `sweep`.
    known : mapping of int to sequence of Score, optional
        By seed, of cases that this code has judged before, such as those of a record: they are not
        judged again, unless they failed.

    Returns
    -------
    scores : dict of int to list of Score
        By seed, in the order of the tiers; a case without a result is there as "failed".
    outcomes : list of Outcome
        What became of each case that was not known.
    """
    asked = {
        (tier, spec.name, seed): spec
        for seed in seeds
        for tier in tiers
        for spec in hidden_cases(tier, seed)[::every]
    }
    there = {
        (s.tier, s.name, seed): s
        for seed, of_seed in (known or {}).items()
        for s in of_seed
        if not s.failure
    }
    tasks = {
        f"{name}, seed {seed}": (tier, spec)
        for (tier, name, seed), spec in asked.items()
        if (tier, name, seed) not in there
    }
    outcomes = sweep(
        scored,
        tasks,
        folder=folder,
        label="benchmark",
        workers=workers,
        timeout_s=None if executor else TIME_LIMIT,
        executor=executor,
        progress=progress,
    )
    scores: dict[int, list[Score]] = {seed: [] for seed in seeds}
    for (tier, name, seed), spec in asked.items():
        if (tier, name, seed) in there:
            scores[seed].append(there[tier, name, seed])
            continue
        found = outcomes[f"{name}, seed {seed}"]
        scores[seed].append(
            failed(tier, spec, found.cause)
            if found.arrays is None
            else Score.from_dict(json.loads(str(found.arrays["score"])))
        )
    return scores, list(outcomes.values())


def scored(task: tuple[str, CaseSpec]) -> Arrays:
    """Score of a tier's case, as a sweep keeps it: JSON in an array of one text."""
    return {"score": np.array(json.dumps(score(*task).to_dict()))}


def score(tier: str, spec: CaseSpec) -> Score:
    """Build one case, investigate it up to the verdict and compare that with the truth."""
    began = time.perf_counter()
    case = spec.build()
    study = Investigation(case.fit, case.held_out)
    found = study.search()
    verdict = study.judge(found, study.unexplained(found.final, seed=spec.seed))
    first = None
    if found.missing and spec.kind == "known":
        first = matched(case.truth, [found.missing[0].could_be]) == 1
    return Score(
        spec.name,
        tier,
        case.kind,
        case.truth,
        case.weak,
        case.noise_ratio,
        verdict.kind,
        verdict.sets,
        outcome_of(case.kind, case.truth, verdict.kind, verdict.sets),
        first,
        verdict.share,
        time.perf_counter() - began,
        tuple(
            (key, rung.fitted.error, rung.held_out.error)
            for key, rung in zip(("", *(m.key for m in found.missing)), found.ladder, strict=True)
        ),
        warnings=study.remarks,
    )


def failed(tier: str, spec: CaseSpec, cause: str) -> Score:
    """Score of a case that has no verdict."""
    return Score(
        spec.name,
        tier,
        spec.kind,
        spec.keys,
        False,
        spec.recorder.ratio,
        "",
        (),
        "failed",
        None,
        None,
        None,
        failure=cause,
    )
