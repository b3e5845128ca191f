"""When a model fails, and for how long after the perturbation it does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from identifiability.investigation.fits.refits import UNKNOWN_LEVEL, without_levels
from identifiability.investigation.where.drawing import curve, points, ratios_by_time, room_above
from identifiability.investigation.where.numerals import probability
from identifiability.investigation.where.scene import Scene, bin_of, share, time_edges
from identifiability.investigation.where.view import Panel, View
from identifiability.investigation.where.whitening import excess
from identifiability.numerals import number
from identifiability.palette import BLUE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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

    name: ClassVar[str] = "time"

    edges: np.ndarray
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray
    latency: float | None

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Test the residual in bins of time since the perturbation, and look for its onset."""
        edges = time_edges(scene, range(len(scene.parts)))
        bins = [bin_of(b.time, edges) for b in scene.blocks]
        n = edges.size - 1
        ratio, p_values = np.ones(n), np.ones(n)
        for k in range(n):
            portions, total = share(scene, bins, k)
            ratio[k], p_values[k] = excess(total, portions, scene.slack)
        flags = scene.significant(p_values)
        found = bool(flags.any())
        latency = _latency(scene) if found else None
        return cls(found, scene.noise.known, edges, ratio, p_values, flags, latency)

    def words(self) -> str:
        """When, and for how long K, B and I suffice."""
        n = self.flags.size
        if not self.significant:
            return (
                f"At no time after the perturbation does the residual exceed {self.reference} "
                f"({n} bins, least {probability(float(self.p_values.min()))})."
            )
        worst = int(np.argmax(np.where(self.flags, self.ratio, 0.0)))
        first, last = 1000 * self.edges[worst : worst + 2]
        sentence = (
            f"The residual exceeds {self.reference} in {self.flags.sum()} of {n} bins of time, "
            f"most from {first:.0f} to {last:.0f} ms after the perturbation "
            f"({number(np.sqrt(self.ratio[worst]), 2)} times in size)"
        )
        if self.latency is None:
            return sentence + "."
        if not self.latency:
            return sentence + "; K, B and I cannot account even for its beginning."
        return (
            f"{sentence}; fitted to the beginning alone, K, B and I account for the first "
            f"{1000 * self.latency:.0f} ms, no longer."
        )

    def panels(self) -> tuple[Panel, ...]:
        """The residual's size by time."""
        return (Panel("by time", self.draw, width=3),)

    def draw(self, panel: Axes) -> None:
        """Draw the residual's size by time, and up to when K, B and I suffice."""
        sizes = np.sqrt(self.ratio)
        curve(panel, self.edges, self.ratio, BLUE)
        points(panel, 500 * (self.edges[:-1] + self.edges[1:]), sizes, self.flags)
        ratios_by_time(panel, float(sizes.max()), self.noise_known)
        if self.latency:
            room_above(panel, 0.1)
            panel.axvline(1000 * self.latency, color=VERMILLION)
            late = self.latency > np.mean(self.edges[[0, -1]])
            panel.annotate(
                f"fitted until here alone, K, B and I suffice ({1000 * self.latency:.0f} ms)",
                (1000 * self.latency, 0.98),
                xycoords=("data", "axes fraction"),
                xytext=(-5 if late else 5, 0),
                textcoords="offset points",
                color=VERMILLION,
                ha="right" if late else "left",
                va="top",
            )


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
