"""In which trials a model fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from scipy import stats

from identifiability.investigation.where.drawing import (
    MOST_LABELS,
    is_logarithmic,
    label_below,
    logarithmic,
    unity,
)
from identifiability.investigation.where.scene import Scene
from identifiability.investigation.where.view import Panel, View
from identifiability.investigation.where.whitening import excess
from identifiability.measurement.noise import correlation_time
from identifiability.numerals import number
from identifiability.palette import BLUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class TrialView(View):
    """Error of each trial against the noise; or against the others, if that is unknown.

    Attributes
    ----------
    names : tuple of str
    errors : array, shape (n,)
        E (Eq. 3).
    pooled : float
        E over all.
    ratio : array, shape (n,)
        Mean square of the residual over that of the noise; where that is unknown, error or mean
        square over the others', whichever is less.
    p_values, flags : array, shape (n,)
    """

    name: ClassVar[str] = "trials"
    singular: ClassVar[str] = "trial"
    plural: ClassVar[str] = "trials"
    width: ClassVar[int] = 3

    names: tuple[str, ...]
    errors: np.ndarray
    pooled: float
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Test the residual of every trial."""
        return cls.of_groups(scene, [(ready.name, [i]) for i, ready in enumerate(scene.parts)])

    @classmethod
    def of_groups(cls, scene: Scene, groups: Sequence[tuple[str, list[int]]]) -> Self:
        """Test the residual of every group of trials, given by its name and their numbers."""
        fitted = scene.candidate.fitted
        names = tuple(name for name, _ in groups)
        errors = np.array([float(np.mean(fitted.errors[members])) for _, members in groups])
        n = len(groups)
        ratio, p_values = np.ones(n), np.ones(n)
        if scene.noise.known:
            for k, (_, members) in enumerate(groups):
                portions = [scene.noise.portion(i, scene.blocks[i], slice(None)) for i in members]
                total = sum(float(np.sum(scene.blocks[i].values ** 2)) for i in members)
                ratio[k], p_values[k] = excess(total, portions, scene.slack)
        elif n > 1:
            # The noise may be alike in all trials, or in proportion to the response: exceed both.
            squares = [float(np.mean(r**2)) for r in fitted.by_trial]
            samples = [r.size / correlation_time(r) for r in fitted.by_trial]
            counts = np.array([sum(samples[i] for i in members) for _, members in groups])
            levels = np.array([np.mean([squares[i] for i in members]) for _, members in groups])
            for k in range(n):
                others = np.arange(n) != k
                ratio[k] = min(
                    x[k] / max(float(np.average(x[others], weights=counts[others])), 1e-300)
                    for x in (errors, levels)
                )
                p_values[k] = stats.f.sf(ratio[k], counts[k], counts[others].sum())
        flags = scene.significant(p_values)
        return cls(
            bool(flags.any()),
            scene.noise.known,
            names,
            errors,
            fitted.error,
            ratio,
            p_values,
            flags,
        )

    def words(self) -> str:
        """How many are worse than the noise, or than the others, and which is worst."""
        n, pooled = len(self.names), number(self.pooled, 2)
        if n == 1 and not self.noise_known:
            return f"There is one {self.singular} (E = {pooled}), and the noise is unknown."
        against = (
            "the noise explains" if self.noise_known else "the others have (the noise is unknown)"
        )
        if not self.significant:
            return f"No {self.singular} has a larger error than {against} (E = {pooled})."
        if n == 1:
            return f"The one {self.singular} has a larger error than {against} (E = {pooled})."
        worst = int(np.argmax(np.where(self.flags, self.ratio, 0.0)))
        error = number(self.errors[worst], 2)
        return (
            f"{self.flags.sum()} of {n} {self.plural} have a larger error than {against}; it is "
            f"largest against that in {self.names[worst]} (E = {error}, over all {pooled})."
        )

    def panels(self) -> tuple[Panel, ...]:
        """The residual's size in each."""
        if len(self.names) < 2:
            return ()
        return (Panel(f"by {self.singular}", self.draw, self.width),)

    def draw(self, panel: Axes) -> None:
        """Draw the residual's size in each, with its error."""
        place, ratio = np.arange(len(self.names)), np.sqrt(self.ratio)
        panel.set_xlim(-0.7, max(place.size, 4) - 0.3)
        colours = [BLUE if flag else "none" for flag in self.flags]
        panel.bar(place, ratio, color=colours, edgecolor=BLUE, width=0.65)
        if place.size <= MOST_LABELS:
            for x, y, error in zip(place, ratio, self.errors, strict=True):
                panel.annotate(
                    f"E {number(error, 1)}",
                    (x, y),
                    xytext=(0, 3),
                    textcoords="offset points",
                    ha="center",
                )
        unity(panel)
        if is_logarithmic(ratio.max()):
            logarithmic(panel)
            panel.set_ylim(bottom=min(0.5, 0.8 * ratio.min()), top=3 * ratio.max())
        else:
            panel.set_ylim(0, 1.25 * max(ratio.max(), 1.0))
        others = "noise" if self.noise_known else "others'"
        panel.set_ylabel(f"residual / {others}, r.m.s.")
        label_below(panel, self.names)
