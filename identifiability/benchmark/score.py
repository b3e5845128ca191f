"""How names compare with the truth, and what so many cases allow to say of a rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from identifiability.inference.curvature import NORMAL_95


def matched(truth: Sequence[str], named: Sequence[Sequence[str]]) -> int:
    """Most hidden effects that can each be found in a set of its own."""
    if not truth or not named:
        return 0
    hit = np.array([[t in s for s in named] for t in truth], float)
    rows, columns = linear_sum_assignment(-hit)
    return int(hit[rows, columns].sum())


def wilson(successes: int, n: int, z: float = NORMAL_95) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927, J Am Stat Assoc 22: 209-212)."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, z * z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = z * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))
