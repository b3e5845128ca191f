"""What all views look at, and the bins of time that several of them share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import Refits
from identifiability.investigation.where.imposed import Imposed
from identifiability.investigation.where.whitening import Blocks, Portion, Whitening, excess
from identifiability.measurement.prepared import Prepared

_WIDTHS, _MOST_BINS = (0.01, 0.02), 60  # of the bins in time [s], and their number


@dataclass(frozen=True, eq=False)
class Scene:
    """What all views look at.

    Attributes
    ----------
    parts : tuple of Prepared
        The fitted trials.
    loads : tuple of Imposed
        What was imposed in each.
    candidate : Candidate
        The model that is looked at.
    refits : Refits
        Its fits to parts of the samples.
    noise : Whitening
    blocks : tuple of Blocks
        Whitened residuals after the onsets, averaged in short blocks.
    level : float
        False discovery rate within a view.
    """

    parts: tuple[Prepared, ...]
    loads: tuple[Imposed, ...]
    candidate: Candidate
    refits: Refits
    noise: Whitening
    blocks: tuple[Blocks, ...]
    level: float

    @property
    def slack(self) -> float:
        """Relative variance of the noise's power in blocks, from the errors of its spectrum."""
        return max(self.noise.block_slack(b.index.shape[1]) for b in self.blocks)

    @property
    def slow_slack(self) -> float:
        """The same at the lowest frequencies."""
        return self.noise.slack(np.zeros(1))

    def significant(self, p_values: np.ndarray) -> np.ndarray:
        """Which of several tests are, at the false discovery rate."""
        if not p_values.size:
            return np.zeros(0, bool)
        return np.asarray(stats.false_discovery_control(p_values) <= self.level)

    @property
    def observed(self) -> list[tuple[Prepared, Blocks]]:
        """Trials with their blocks."""
        return list(zip(self.parts, self.blocks, strict=True))


def time_edges(scene: Scene, trials: Iterable[int]) -> np.ndarray:
    """Edges of bins in time since the perturbation [s]."""
    observed = [scene.observed[i] for i in trials]
    finest = max(ready.drive.interval * blocks.index.shape[1] for ready, blocks in observed)
    longest = max(float(blocks.time.max(initial=0.0)) for _, blocks in observed) + finest
    fitting = [w for w in _WIDTHS if w >= finest * (1 - 1e-9) and longest / w <= _MOST_BINS]
    width = fitting[0] if fitting else max(longest / _MOST_BINS, finest)
    return np.arange(np.ceil(longest / width - 1e-6) + 1) * width


def bin_of(time: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of the bin of each time."""
    inside = np.searchsorted(edges, time + 1e-9 * edges[-1], side="right") - 1
    return np.minimum(inside, edges.size - 2)


def share(scene: Scene, bins: Sequence[np.ndarray], k: int) -> tuple[list[Portion], float]:
    """Portions of all trials in a bin, and their sum of squares."""
    portions, total = [], 0.0
    for i, (blocks, inside) in enumerate(zip(scene.blocks, bins, strict=True)):
        chosen = inside == k
        if chosen.any():
            portions.append(scene.noise.portion(i, blocks, chosen))
            total += float(np.sum(blocks.values[chosen] ** 2))
    return portions, total


def misfit(scene: Scene, trials: Iterable[int]) -> bool:
    """Whether some trials' residuals exceed the noise at all."""
    chosen = [(i, scene.blocks[i]) for i in trials]
    everything = slice(None)
    portions = [scene.noise.portion(i, blocks, everything) for i, blocks in chosen]
    total = sum(float(blocks.values @ blocks.values) for _, blocks in chosen)
    return excess(total, portions, scene.slack)[1] <= scene.level
