"""When a model fails, and for how long after the perturbation it does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identifiability.investigation.fits.refits import UNKNOWN_LEVEL, without_levels
from identifiability.investigation.where.compare import plain, probability
from identifiability.investigation.where.scene import Scene, View, bin_of, share, time_edges
from identifiability.investigation.where.whitening import excess

_LATENCY_BIN, _LONGEST_LATENCY = 0.01, 0.4  # seconds in which an onset of the misfit is looked for


@dataclass(frozen=True, eq=False)
class TimeView(View):
    """Residual against the time since the perturbation.

    Attributes
    ----------
    edges : array, shape (n + 1,)
        Of the bins [s].
    ratio : array, shape (n,)
        Mean square of the residual over that of the noise, both averaged over 5 ms.
    p_values, flags : array, shape (n,)
        Of each bin, and whether it is significant.
    latency : float or None
        Time [s] up to which K, B and I can be fitted to the response such that no misfit is left:
        two bins in a row after it cannot be joined.
    """

    edges: np.ndarray
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray
    latency: float | None


def in_time(scene: Scene) -> TimeView:
    """Test the residual in bins of time since the perturbation, and look for its onset."""
    edges = time_edges(scene, range(len(scene.parts)))
    bins = [bin_of(b.time, edges) for b in scene.blocks]
    n = edges.size - 1
    ratio, p_values = np.ones(n), np.ones(n)
    for k in range(n):
        portions, total = share(scene, bins, k)
        ratio[k], p_values[k] = excess(total, portions, scene.slack)
    flags = scene.significant(p_values)
    latency = _latency(scene) if flags.any() else None
    if not flags.any():
        sentence = (
            f"At no time after the perturbation does the residual exceed {scene.reference} "
            f"({n} bins, least {probability(float(p_values.min()))})."
        )
        return TimeView(False, sentence, edges, ratio, p_values, flags, None)
    worst = int(np.argmax(np.where(flags, ratio, 0.0)))
    sentence = (
        f"The residual exceeds {scene.reference} in {flags.sum()} of {n} bins of time, most from "
        f"{1000 * edges[worst]:.0f} to {1000 * edges[worst + 1]:.0f} ms after the perturbation "
        f"({plain(np.sqrt(ratio[worst]))} times in size)"
    )
    if latency is not None:
        first = f"for the first {1000 * latency:.0f} ms, no longer"
        sentence += f"; K, B and I can account {first if latency else 'not even for its beginning'}"
    return TimeView(True, sentence + ".", edges, ratio, p_values, flags, latency)


def _latency(scene: Scene) -> float | None:
    """Time from which the response cannot be joined to what came before.

    K, B and I are fitted to a window that grows bin by bin. What each bin adds to the least sum of
    squares is independent of the others and chi-square distributed, as the recursive residuals of
    Brown, Durbin & Evans (1975, J R Stat Soc B 37: 149-192) are. Two such bins in a row at a
    probability of sqrt(level / n) each keep the probability of any false onset below the level.
    """
    finest = max(r.drive.interval * b.index.shape[1] for r, b in scene.observed)
    edges = np.arange(0.0, _LONGEST_LATENCY, max(_LATENCY_BIN, finest))
    edges = edges[edges < max(b.time.max(initial=0.0) for b in scene.blocks)]
    n = edges.size
    bins = [np.searchsorted(edges, b.time + 1e-9, side="right") - 1 for b in scene.blocks]
    threshold = np.sqrt(scene.level / max(n, 1))
    cost, values, failed = 0.0, scene.refits.values, False
    for k in range(n):
        portions, _ = share(scene, bins, k)
        if not portions:
            return None

        def take(trial: int, columns: np.ndarray, last: int = k) -> np.ndarray:
            blocks, chosen = scene.blocks[trial], bins[trial] <= last
            rows = scene.noise.averaged(trial, columns, blocks.index[chosen])
            if not scene.parts[trial].has_offset:
                return rows
            level = np.full((len(columns), 1), UNKNOWN_LEVEL * scene.noise.sds[trial])
            ones = scene.noise.averaged(trial, level, blocks.index[chosen])
            return without_levels(rows, ones[:, 0], blocks.event[chosen])

        found = scene.refits.fit(take, values)
        _, p_value = excess(max(found.cost - cost, 0.0), portions, scene.slow_slack)
        if p_value < threshold and failed:
            return float(edges[k - 1])
        failed = p_value < threshold
        cost, values = found.cost, found.values
    return None
