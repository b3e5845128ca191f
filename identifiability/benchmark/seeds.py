"""Calibration by several seeds: each as it came out, and all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.benchmark.calibration import BlindScore, record


def together(by_seed: Mapping[int, Sequence[BlindScore]], *, n: int) -> dict[str, Any]:
    """Plain record, for JSON, of runs that differ in their seed alone.

    Parameters
    ----------
    by_seed : mapping of int to sequence of BlindScore
    n : int
        Cases that were asked for, of each seed.

    Returns
    -------
    dict
        That of `calibration.record` over all cases, without the cases; by seed in ``runs``, with
        them.
    """
    every = [score for scores in by_seed.values() for score in scores]
    whole = record(every, n=n, seed=next(iter(by_seed)))
    runs = [record(scores, n=n, seed=seed) for seed, scores in by_seed.items()]
    kept = {key: value for key, value in whole.items() if key not in ("seed", "scores")}
    return {**kept, "schema": 2, "seeds": list(by_seed), "runs": runs}
