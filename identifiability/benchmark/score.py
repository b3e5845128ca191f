"""How a verdict compares with the truth, and how a tier of cases went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

NAMING = ("explained", "one_of", "measurement")
OUTCOMES = ("right", "right among others", "partly", "abstained", "wrong", "failed")
"""Of a case: every effect named and nothing else; the truth in a set of several; some effects named
and nothing false; nothing named where something is hidden; something false named; no verdict."""


@dataclass(frozen=True)
class Score:
    """What an investigation said of one case, and how it compares with the truth.

    Attributes
    ----------
    name, tier, kind : str
    truth : tuple of str
    weak : bool
    noise_ratio : float
    verdict : str
    named : tuple of tuple of str
        Equivalence sets.
    outcome : str
        One of `OUTCOMES`.
    first_pick : bool or None
        Whether the effect on the first rung is one of the truth's; ``None`` where nothing was named
        or nothing is hidden.
    removed : float or None
        Share of the held-out misfit beyond the noise that the final model removed.
    seconds : float or None
        ``None`` where there is no verdict.
    rungs : tuple of (str, float, float)
        Errors of the fitted and the held-out trials: of the baseline ("") and with every effect.
    failure : str
    warnings : tuple of str
        Parts of the investigation that could not be done, and what the trials did not allow.
    """

    name: str
    tier: str
    kind: str
    truth: tuple[str, ...]
    weak: bool
    noise_ratio: float
    verdict: str
    named: tuple[tuple[str, ...], ...]
    outcome: str
    first_pick: bool | None
    removed: float | None
    seconds: float | None
    rungs: tuple[tuple[str, float, float], ...] = ()
    failure: str = ""
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain record, for JSON; warnings where there are any."""
        plain = asdict(self)
        return plain if self.warnings else {k: v for k, v in plain.items() if k != "warnings"}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Score:
        """Score from its plain record."""
        named, rungs = (tuple(tuple(s) for s in plain[key]) for key in ("named", "rungs"))
        truth, warnings = (tuple(plain.get(key, ())) for key in ("truth", "warnings"))
        parts = {"truth": truth, "named": named, "rungs": rungs, "warnings": warnings}
        return cls(**{**plain, **parts})


def outcome_of(
    kind: str, truth: Sequence[str], verdict: str, named: Sequence[Sequence[str]]
) -> str:
    """Compare a verdict with the truth.

    Parameters
    ----------
    kind : {"known", "none", "unknown", "unrepeatable"}
        What is hidden.
    truth : sequence of str
        Keys of the hidden effects.
    verdict : str
        Kind of the verdict.
    named : sequence of sequences of str
        Equivalence sets of the verdict.
    """
    names = verdict in NAMING and len(named) > 0
    if kind == "none":
        return "wrong" if names or verdict.startswith("unknown") else "right"
    if kind == "unrepeatable":
        return "wrong" if names else "right"
    if kind == "unknown":
        return "wrong" if names else "right" if verdict != "nothing_missing" else "abstained"
    if not names:
        return "abstained"
    hits = matched(truth, named)
    if hits < len(named):
        return "wrong"
    if hits < len(truth):
        return "partly"
    return "right" if all(len(s) == 1 for s in named) else "right among others"


def matched(truth: Sequence[str], named: Sequence[Sequence[str]]) -> int:
    """Most hidden effects that can each be found in a set of its own."""
    if not truth or not named:
        return 0
    hit = np.array([[t in s for s in named] for t in truth], float)
    rows, columns = linear_sum_assignment(-hit)
    return int(hit[rows, columns].sum())


def wilson(successes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927, J Am Stat Assoc 22: 209-212)."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, z * z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = z * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))
