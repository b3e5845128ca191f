"""Whether the probabilities of an investigation are what they say: blind cases, counted."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.benchmark.blind import TIERS, BlindSpec, blind_cases
from identifiability.benchmark.cases import HiddenCase
from identifiability.benchmark.score import matched, wilson
from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.provenance import stamp
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

PROPORTIONS = {"singles": 3, "pairs": 3, "nulls": 5, "unknown": 2}
"""Cases of each tier, of so many in all."""

BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0 + 1e-9)
"""Edges of the bins of a reliability diagram."""

_TIME_LIMIT = 1800.0  # for one case [s]
_LEAST = 1e-12  # probability that a truth is given at least, in the log score


@dataclass(frozen=True)
class BlindScore:
    """What an investigation said of one case, and whether it is right.

    Attributes
    ----------
    name, tier, imposed, noise : str
    ratio : float
        Energy of the noise over that of the response.
    weak : bool
        Whether an effect hides below three times the noise.
    truth : tuple of str or None
        None for something unknown.
    claim : str
        Kind of the claim.
    sets : tuple of tuple of str
        Effects that were named, each with what it could also be.
    probability : float
        Of the claim.
    rows : tuple of (tuple of str or None, float)
        Sets of effects and their probabilities, the most probable first.
    outcome : str
        "right": all effects named, alone or in a set; no name where there is nothing or something
        unknown. "partly": some named, nothing false. "abstained": nothing named, where something
        is hidden that is known, or nothing found, where something unknown is. "wrong": something
        false is named, or something unknown is claimed where there is nothing. "failed".
    seconds : float
    failure : str
    joint : tuple of (str, float, float, float)
        Name, true value, estimate and standard deviation of K, B and I in the true set of effects,
        where that was weighed; of I alone where there are effects.
    """

    name: str
    tier: str
    imposed: str
    noise: str
    ratio: float
    weak: bool
    truth: tuple[str, ...] | None
    claim: str
    sets: tuple[tuple[str, ...], ...]
    probability: float
    rows: tuple[tuple[tuple[str, ...] | None, float], ...]
    outcome: str
    seconds: float
    failure: str = ""
    joint: tuple[tuple[str, float, float, float], ...] = ()

    @property
    def of_truth(self) -> float:
        """Probability of the truth, effects of one form not told apart."""
        return sum(p for effects, p in self.rows if same(effects, self.truth))

    @property
    def brier(self) -> float:
        """Sum over sets of the squared error of their probabilities (Brier 1950)."""
        wrong = sum(p**2 for effects, p in self.rows if not same(effects, self.truth))
        return wrong + (1 - self.of_truth) ** 2

    @property
    def log_score(self) -> float:
        """Minus the logarithm of the probability of the truth [nats]."""
        return -float(np.log(max(self.of_truth, _LEAST)))


def same(effects: Sequence[str] | None, truth: Sequence[str] | None) -> bool:
    """Whether a set is the true one, effects of one form not told apart."""
    if effects is None or truth is None:
        return effects is None and truth is None
    return sorted(map(_form, effects)) == sorted(map(_form, truth))


def _form(key: str) -> str:
    return min((key, *EFFECTS[key].equivalent)) if key in EFFECTS else key


def outcome_of(truth: Sequence[str] | None, claim: str, sets: Sequence[Sequence[str]]) -> str:
    """Compare a claim with the truth: see `BlindScore`."""
    if sets:
        if truth is None or matched(truth, sets) < len(sets):
            return "wrong"
        return "right" if len(sets) == len(truth) else "partly"
    if truth is None:
        return "right" if claim == "unknown" else "abstained"
    if not truth:
        return "right" if claim == "nothing" else "wrong"
    return "abstained"


def judged(spec: BlindSpec) -> Arrays:
    """Score of one case, as a sweep keeps it: JSON in an array of one text."""
    return {"score": np.array(json.dumps(asdict(score(spec))))}


def score(spec: BlindSpec) -> BlindScore:
    """Build one case, weigh what may be missing and compare that with the truth."""
    case = spec.build()
    began = time.perf_counter()
    study = Investigation(case.fit, case.held_out).likeliest(seed=spec.seed)
    found: Probabilities = study.weigh(seed=spec.seed)
    claim = study.claim(found)
    truth = None if case.kind == "unknown" else case.truth
    return BlindScore(
        spec.name,
        spec.tier,
        spec.imposed,
        spec.noise,
        spec.ratio,
        case.weak,
        truth,
        claim.kind,
        claim.sets,
        claim.probability,
        tuple((row.effects, row.probability) for row in found.rows),
        outcome_of(truth, claim.kind, claim.sets),
        time.perf_counter() - began,
        joint=_joint(case, found),
    )


def _joint(case: HiddenCase, found: Probabilities) -> tuple[tuple[str, float, float, float], ...]:
    """K, B and I as they are and as they were found: see `BlindScore`.

    What K and B are of a joint with an effect depends on the equations.
    """
    alike = [one for keys, one in found.sets.items() if same(keys, case.truth)]
    weighed = max(alike, key=lambda one: one.log_evidence, default=None)
    if weighed is None or case.kind == "unknown":
        return ()
    values = weighed.candidate.values
    return tuple(
        (name, value, values[name], weighed.sds.get(name, 0.0))
        for name, value in case.joint.items()
        if name == "I" or not case.truth
    )


def measure(
    n: int,
    *,
    seed: int,
    folder: Path | None = None,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
) -> tuple[list[BlindScore], list[Outcome]]:
    """Investigate about so many cases, half of them with the angle imposed.

    Parameters
    ----------
    n : int
        Cases in all, shared among the tiers by `PROPORTIONS`.
    seed : int
        Every seed makes other cases.
    folder, workers, executor, progress
        See `sweep`.
    """
    tasks = {spec.name: spec for tier in TIERS for spec in blind_cases(tier, seed, share(tier, n))}
    outcomes = sweep(
        judged,
        tasks,
        folder=folder,
        label="calibration",
        workers=workers,
        timeout_s=None if executor else _TIME_LIMIT,
        executor=executor,
        progress=progress,
    )
    scores = [
        failed(tasks[name], found.cause)
        if found.arrays is None
        else score_from(json.loads(str(found.arrays["score"])))
        for name, found in outcomes.items()
    ]
    return scores, list(outcomes.values())


def share(tier: str, n: int) -> int:
    """Number of a tier's cases among so many: even, so that both causalities have as many."""
    return 2 * max(1, round(0.5 * n * PROPORTIONS[tier] / sum(PROPORTIONS.values())))


def score_from(plain: Mapping[str, Any]) -> BlindScore:
    """Score from its plain record."""
    parts = {
        "truth": None if plain["truth"] is None else tuple(plain["truth"]),
        "sets": tuple(tuple(names) for names in plain["sets"]),
        "rows": tuple((None if e is None else tuple(e), p) for e, p in plain["rows"]),
        "joint": tuple((name, *values) for name, *values in plain["joint"]),
    }
    return BlindScore(**{**plain, **parts})


def failed(spec: BlindSpec, cause: str) -> BlindScore:
    """Score of a case that has no verdict."""
    truth = None if spec.kind == "unknown" else spec.keys
    return BlindScore(
        spec.name,
        spec.tier,
        spec.imposed,
        spec.noise,
        spec.ratio,
        False,
        truth,
        "",
        (),
        0.0,
        (),
        "failed",
        0.0,
        cause,
    )


def record(scores: Sequence[BlindScore], *, n: int, seed: int) -> dict[str, Any]:
    """Plain record, for JSON: counts by tier and causality, reliability, and every case."""
    return {
        "schema": 1,
        **stamp(__name__),
        "cases": n,
        "seed": seed,
        "tiers": [
            _counted(tier, imposed, scores) for tier in TIERS for imposed in ("torque", "angle")
        ],
        "claims": _claims(scores),
        "reliability": _reliability(scores),
        "joint": [_joint_counted(effects, scores) for effects in (False, True)],
        "scores": [asdict(one) for one in scores],
    }


def _counted(tier: str, imposed: str, scores: Sequence[BlindScore]) -> dict[str, Any]:
    mine = [s for s in scores if (s.tier, s.imposed) == (tier, imposed)]
    strong = [s for s in mine if not s.weak]
    judged = [s for s in mine if s.outcome != "failed"]
    right = sum(s.outcome == "right" for s in strong)
    wrong = sum(s.outcome == "wrong" for s in mine)
    sizes = [len(names) for s in mine for names in s.sets]
    return {
        "tier": tier,
        "imposed": imposed,
        "n": len(mine),
        "weak": len(mine) - len(strong),
        "right": right,
        "right_interval": list(wilson(right, len(strong))),
        "partly": sum(s.outcome == "partly" for s in strong),
        "abstained": sum(s.outcome == "abstained" for s in strong),
        "wrong": wrong,
        "wrong_interval": list(wilson(wrong, len(mine))),
        "failed": len(mine) - len(judged),
        "size_of_sets": float(np.mean(sizes)) if sizes else None,
        "brier": float(np.mean([s.brier for s in judged])) if judged else None,
        "log_score": float(np.mean([s.log_score for s in judged])) if judged else None,
        "seconds": float(np.median([s.seconds for s in judged])) if judged else None,
    }


def _claims(scores: Sequence[BlindScore]) -> dict[str, Any]:
    """How many of the claims that name effects are right."""
    named = [s for s in scores if s.sets]
    right = sum(s.outcome in ("right", "partly") for s in named)
    return {"n": len(named), "right": right, "interval": list(wilson(right, len(named)))}


def _joint_counted(effects: bool, scores: Sequence[BlindScore]) -> dict[str, Any]:
    """How often intervals of K, B and I cover, where the truth was claimed."""
    mine = [s for s in scores if s.outcome == "right" and s.truth is not None]
    found = [row for s in mine if bool(s.truth) == effects for row in s.joint if row[3] > 0]
    covered = sum(abs(estimate - true) <= NORMAL_95 * sd for _, true, estimate, sd in found)
    errors = [abs(estimate / true - 1) for _, true, estimate, _ in found]
    return {
        "effects": effects,
        "n": len(found),
        "covered": covered,
        "interval": list(wilson(covered, len(found))),
        "error": float(np.median(errors)) if errors else None,
        "largest_error": float(np.max(errors)) if errors else None,
    }


def _reliability(scores: Sequence[BlindScore]) -> list[dict[str, Any]]:
    """Of all stated probabilities in a bin: how many, their mean, and how often they were true."""
    stated = [(p, same(effects, s.truth)) for s in scores for effects, p in s.rows]
    out = []
    for low, high in pairwise(BINS):
        inside = [(p, true) for p, true in stated if low <= p < high]
        true = sum(true for _, true in inside)
        out.append(
            {
                "from": low,
                "to": min(high, 1.0),
                "n": len(inside),
                "stated": float(np.mean([p for p, _ in inside])) if inside else None,
                "true": true,
                "interval": list(wilson(true, len(inside))),
            }
        )
    return out
