"""Runs the investigation over hidden cases, each kept as soon as it is done."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from identifiability.benchmark.cases import CaseSpec, hidden_cases
from identifiability.benchmark.score import Score, matched, outcome_of
from identifiability.errors import InputError
from identifiability.files import write_json
from identifiability.investigation.investigate import investigate
from identifiability.provenance import package_version

WHOLE = ("singles", "pairs", "unknown", "controls", "nulls")

Progress = Callable[[str, int, int, float], None]


def run_benchmark(
    tiers: Sequence[str],
    folder: Path,
    *,
    seed: int = 1,
    every: int = 1,
    progress: Progress = lambda what, done, total, left: None,
) -> list[Score]:
    """Investigate every case of some tiers; what was done before is not done again.

    Parameters
    ----------
    tiers : sequence of str
    folder : Path
        Where each case's score is kept, one file a case.
    seed : int
    every : int
        Take every so-many-th case.
    progress : callable
        Told ``(what, done, total, seconds left)``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    specs = [(tier, spec) for tier in tiers for spec in hidden_cases(tier, seed)[::every]]
    scores, spent, fresh = [], 0.0, 0
    for done, (tier, spec) in enumerate(specs):
        path = folder / f"{spec.name}-{seed}.json"
        kept = _kept(path)
        if kept is None:
            left = spent / fresh * (len(specs) - done) if fresh else float("nan")
            progress(spec.name, done, len(specs), left)
            began = time.perf_counter()
            kept = score(tier, spec)
            spent, fresh = spent + time.perf_counter() - began, fresh + 1
            write_json(path, {"package": package_version(), **kept.to_dict()})
        scores.append(kept)
    return scores


def score(tier: str, spec: CaseSpec) -> Score:
    """Build one case, investigate it and compare the verdict with the truth."""
    began = time.perf_counter()
    try:
        case = spec.build()
        findings = investigate(case.fit, case.held_out, with_widths=False, seed=spec.seed)
    except (InputError, ArithmeticError, ValueError) as error:
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
            time.perf_counter() - began,
            failure=str(error),
        )
    verdict, found = findings.verdict, findings.found
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
    )


def _kept(path: Path) -> Score | None:
    try:
        plain = json.loads(path.read_text(encoding="utf-8"))
        if plain.pop("package") != package_version():
            return None
        return Score.from_dict(plain)
    except (OSError, ValueError, KeyError, TypeError):
        return None
