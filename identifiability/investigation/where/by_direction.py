"""Whether the misfit turns its sign with the perturbation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from identifiability.investigation.where.drawing import curve, legend_above, ratios_by_time
from identifiability.investigation.where.pairs import alike, combine, names, profile, trials_of
from identifiability.investigation.where.scene import Scene, time_edges
from identifiability.investigation.where.view import Panel, View
from identifiability.numerals import number
from identifiability.palette import BLUE, ORANGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OPPOSITE = 0.05  # how close to -1 the ratio of sizes is


@dataclass(frozen=True, eq=False)
class DirectionView(View):
    """Parts of the residual that keep and that turn their sign with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        Trials of one perturbation and its opposite; none where there are no such.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    even, odd : array, shape (n,)
        Mean square over that of the noise.
    overall_even, overall_odd : float
        The same over all times.
    p_even, p_odd : float
    even_significant, odd_significant : bool
    """

    name: ClassVar[str] = "direction"

    pairs: tuple[tuple[str, str], ...]
    edges: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    overall_even: float
    overall_odd: float
    p_even: float
    p_odd: float
    even_significant: bool
    odd_significant: bool

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Split the misfit of opposite trials into parts that keep and that turn their sign."""
        known, pairs = scene.noise.known, [p for p in alike(scene) if abs(p[2] + 1) < _OPPOSITE]
        if not pairs:
            none = np.zeros(0)
            return cls(False, known, (), none, none, none, 1.0, 1.0, 1.0, 1.0, False, False)
        edges = time_edges(scene, trials_of(pairs))
        even, overall_even, p_even = profile(
            scene, [combine(scene, i, j, 1.0) for i, j, _ in pairs], edges
        )
        odd, overall_odd, p_odd = profile(
            scene, [combine(scene, i, j, -1.0) for i, j, _ in pairs], edges
        )
        is_even, is_odd = (bool(f) for f in scene.significant(np.array([p_even, p_odd])))
        return cls(
            is_even or is_odd,
            known,
            names(scene, pairs),
            edges,
            even,
            odd,
            overall_even,
            overall_odd,
            p_even,
            p_odd,
            is_even,
            is_odd,
        )

    def words(self) -> str:
        """Whether the misfit keeps or turns its sign, and how large both parts are."""
        if not self.pairs:
            return (
                "No two trials are the same perturbation in opposite directions, so the misfit "
                "cannot be split into parts that keep and that turn their sign."
            )
        found = {
            (False, False): "Neither direction shows a misfit",
            (False, True): "The misfit turns its sign with the perturbation",
            (True, False): "The misfit keeps its sign when the perturbation turns",
            (True, True): ("The misfit differs between the directions, and partly turns with them"),
        }[self.even_significant, self.odd_significant]
        even, odd = (number(np.sqrt(x), 2) for x in (self.overall_even, self.overall_odd))
        return f"{found} (even part {even}, odd part {odd} times {self.reference})."

    def panels(self) -> tuple[Panel, ...]:
        """Both parts by time."""
        return (Panel("by direction", self.draw),) if self.pairs else ()

    def draw(self, panel: Axes) -> None:
        """Draw both parts by time."""
        marks = {True: " (significant)", False: ""}
        curve(panel, self.edges, self.odd, BLUE, f"turns its sign{marks[self.odd_significant]}")
        curve(panel, self.edges, self.even, ORANGE, f"keeps its sign{marks[self.even_significant]}")
        largest = float(np.sqrt(max(self.even.max(), self.odd.max())))
        ratios_by_time(panel, largest, self.noise_known)
        legend_above(panel)
