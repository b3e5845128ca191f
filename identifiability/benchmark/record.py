"""A benchmark as a plain record: rates with intervals, seed by seed and together, every case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from identifiability.benchmark.score import OUTCOMES, Score, wilson
from identifiability.provenance import read_record, stamp

SCHEMA = 2


def benchmark_record(scores: Mapping[int, Sequence[Score]], *, tried: int) -> dict[str, Any]:
    """Plain record of a benchmark.

    Parameters
    ----------
    scores : mapping of int to sequence of Score
        By seed; see `run_benchmark`.
    tried : int
        Number of cases that the tiers hold, for all seeds together.

    Returns
    -------
    dict
        ``runs``, one a seed, with ``tiers`` (rates, with Wilson's 95 % intervals) and ``cases``;
        ``together``, the tiers over all seeds.
    """
    everything = [s for of_seed in scores.values() for s in of_seed]
    return {
        "schema": SCHEMA,
        **stamp(__name__, "identifiability.benchmark.run"),
        "cases_run": len(everything),
        "cases_in_tiers": tried,
        "runs": [
            {"seed": seed, "tiers": _tiers(of_seed), "cases": [s.to_dict() for s in of_seed]}
            for seed, of_seed in scores.items()
        ],
        "together": _tiers(everything),
    }


def recorded_scores(path: Path) -> dict[int, list[Score]]:
    """Scores of a record that this code made, by seed; none where there is no such record.

    Parameters
    ----------
    path : Path
        Of the record, a JSON file.
    """
    if not path.is_file():
        return {}
    stored = read_record(path)
    if stored.remark or stored.record.get("schema") != SCHEMA:
        return {}
    return {
        run["seed"]: [Score.from_dict(case) for case in run["cases"]]
        for run in stored.record["runs"]
    }


def _tiers(scores: Sequence[Score]) -> dict[str, Any]:
    tiers = {}
    for tier in dict.fromkeys(s.tier for s in scores):
        for weak in (False, True):
            mine = [s for s in scores if s.tier == tier and s.weak is weak]
            if mine:
                tiers[f"{tier}{', weak' if weak else ''}"] = _rates(mine)
    return tiers


def _rates(scores: Sequence[Score]) -> dict[str, Any]:
    n = len(scores)
    counts = Counter(s.outcome for s in scores)
    found = sum(counts[o] for o in ("right", "right among others"))
    false = counts["wrong"]
    picks = [s.first_pick for s in scores if s.first_pick is not None]
    removed = sorted(s.removed for s in scores if s.removed is not None)
    seconds = sorted(s.seconds for s in scores if s.seconds is not None)
    named = [s for s in scores if s.outcome in ("right", "right among others", "partly", "wrong")]
    return {
        "n": n,
        "outcomes": {o: counts[o] for o in OUTCOMES},
        "right": found,
        "right_interval": wilson(found, n),
        "wrong": false,
        "wrong_interval": wilson(false, n),
        "first_pick": sum(picks),
        "first_pick_of": len(picks),
        "first_pick_interval": wilson(sum(picks), len(picks)),
        "named": len(named),
        "median_removed": removed[len(removed) // 2] if removed else None,
        "median_seconds": seconds[len(seconds) // 2] if seconds else None,
    }
