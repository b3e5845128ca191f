"""Whether the misfit grows with the perturbation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from identifiability.investigation.where.drawing import curve, legend_above, ratios_by_time
from identifiability.investigation.where.imposed import OTHER_SIZE
from identifiability.investigation.where.numerals import probability
from identifiability.investigation.where.pairs import alike, combine, names, profile, trials_of
from identifiability.investigation.where.scene import Scene, misfit, time_edges
from identifiability.investigation.where.view import Panel, View
from identifiability.numerals import number
from identifiability.palette import BLUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class AmplitudeView(View):
    """The part of the residual that does not scale with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        The smaller and the larger of two perturbations of one waveform; none where there are no
        such.
    gains : tuple of float
        Ratio of their sizes; negative where the direction differs too, which is so for all or none.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    ratio : array, shape (n,)
        Mean square of larger less scaled smaller residual, over that of the noise.
    overall : float
        The same over all times.
    p_value : float
    misfit : bool
        Whether the residuals of these trials are more than noise at all.
    """

    name: ClassVar[str] = "amplitude"

    pairs: tuple[tuple[str, str], ...]
    gains: tuple[float, ...]
    edges: np.ndarray
    ratio: np.ndarray
    overall: float
    p_value: float
    misfit: bool

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Compare trials of one waveform at two sizes: of a linear joint all scales."""
        known, different = scene.noise.known, [p for p in alike(scene) if abs(p[2]) > OTHER_SIZE]
        # Trials of one direction tell size from direction; others serve where there are none.
        pairs = [p for p in different if p[2] > 0] or different
        if not pairs:
            none = np.zeros(0)
            return cls(False, known, (), (), none, none, 1.0, 1.0, False)
        edges = time_edges(scene, trials_of(pairs))
        combined = [combine(scene, i, j, -ratio) for i, j, ratio in pairs]
        ratio, overall, p_value = profile(scene, combined, edges)
        return cls(
            p_value <= scene.level,
            known,
            names(scene, pairs),
            tuple(float(p[2]) for p in pairs),
            edges,
            ratio,
            overall,
            p_value,
            misfit(scene, trials_of(pairs)),
        )

    def words(self) -> str:
        """Whether what is missing looks linear."""
        if not self.pairs:
            return (
                "No two trials are the same perturbation at two sizes, so whether the misfit "
                "scales with it is not known."
            )
        size, chance = (
            f"{number(np.sqrt(self.overall), 2)} times {self.reference}",
            probability(self.p_value),
        )
        if self.significant:
            then = (
                ": what is missing is not linear"
                if self.gains[0] > 0
                else ", but size and direction differ together"
            )
            return (
                "The residual does not scale with the perturbation (the difference is "
                f"{size}){then}."
            )
        if self.misfit:
            return (
                f"The misfit scales with the perturbation (the difference is {size}, {chance}): "
                "what is missing looks linear."
            )
        return f"Neither size shows a misfit (the scaled difference is {size}, {chance})."

    def panels(self) -> tuple[Panel, ...]:
        """What does not scale, by time."""
        return (Panel("by size", self.draw),) if self.pairs else ()

    def draw(self, panel: Axes) -> None:
        """Draw what does not scale, by time."""
        mark = " (significant)" if self.significant else ""
        curve(panel, self.edges, self.ratio, BLUE, f"does not scale{mark}")
        ratios_by_time(panel, float(np.sqrt(self.ratio.max())), self.noise_known)
        legend_above(panel)
