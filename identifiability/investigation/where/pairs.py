"""Trials of one waveform, two at a time: their residuals added and taken from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.investigation.where.scene import Scene, bin_of
from identifiability.investigation.where.whitening import Portion, excess

Pair = tuple[int, int, float]
"""Numbers of two trials, and how many times as large the second perturbation is as the first."""


@dataclass(frozen=True, eq=False)
class Combined:
    """Weighted sum of two trials' residuals, in units of its noise.

    Attributes
    ----------
    values, time : array, shape (n,)
        By blocks, and the time [s] since the perturbation at the beginning of each.
    portion : Portion
        What they contribute to a sum of squares.
    """

    values: np.ndarray
    time: np.ndarray
    portion: Portion


def combine(scene: Scene, i: int, j: int, weight: float) -> Combined:
    """Residual of trial j plus `weight` times that of trial i."""
    one, other = scene.blocks[i], scene.blocks[j]
    n = min(one.values.size, other.values.size)
    variances = np.array([(weight * scene.noise.sds[i]) ** 2, scene.noise.sds[j] ** 2])
    total = variances.sum()
    values = (
        weight * scene.noise.sds[i] * one.values[:n] + scene.noise.sds[j] * other.values[:n]
    ) / np.sqrt(total)
    shares = variances / total
    levels = np.array([one.level[:n] @ one.level[:n], other.level[:n] @ other.level[:n]])
    dof = 1 / np.sum(shares**2 / scene.noise.dof[[i, j]])
    return Combined(values, other.time[:n], Portion(n, float(shares @ levels), float(dof)))


def profile(
    scene: Scene, combined: Sequence[Combined], edges: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Mean squares over the noise's by time; the ratio over all times, and its probability."""
    bins = [bin_of(c.time, edges) for c in combined]
    squares = np.zeros(edges.size - 1)
    numbers = np.zeros(edges.size - 1)
    for c, inside in zip(combined, bins, strict=True):
        squares += np.bincount(inside, c.values**2, edges.size - 1)
        numbers += np.bincount(inside, minlength=edges.size - 1)
    total = sum(float(c.values @ c.values) for c in combined)
    ratio, p_value = excess(total, [c.portion for c in combined], scene.slack)
    return squares / np.maximum(numbers, 1), ratio, p_value


def alike(scene: Scene) -> list[Pair]:
    """Pairs of trials of one waveform and length, the smaller first, and the ratio of sizes."""
    found = []
    for i, one in enumerate(scene.loads):
        for j, other in enumerate(scene.loads):
            ratio = other.gain / one.gain if one.gain else 0.0
            same = i != j and one.kind == other.kind and scene.blocks[i].time.size > 0
            if same and (abs(ratio) > 1 or (abs(ratio) == 1 and i < j)):
                found.append((i, j, ratio))
    return found


def names(scene: Scene, pairs: Sequence[Pair]) -> tuple[tuple[str, str], ...]:
    """Names of the trials of some pairs."""
    return tuple((scene.parts[i].name, scene.parts[j].name) for i, j, _ in pairs)


def trials_of(pairs: Sequence[Pair]) -> set[int]:
    """Numbers of all trials of some pairs."""
    return {k for i, j, _ in pairs for k in (i, j)}
