"""At which frequencies a model fails, and whether the misfit is coherent with the perturbation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from scipy import signal, stats

from identifiability.investigation.where.drawing import legend_above, points, ratios, unity
from identifiability.investigation.where.scene import Scene
from identifiability.investigation.where.view import Panel, View
from identifiability.investigation.where.whitening import Portion, excess
from identifiability.numerals import number
from identifiability.palette import BLUE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LONGEST_SEGMENT, _FEWEST_SEGMENTS = 1.0, 3  # of the spectra [s]; for a coherence
_FEWEST_SAMPLES = 16  # of a segment
_TAPERED = 0.25  # share of a segment that is tapered, lest its ends leak into high frequencies


@dataclass(frozen=True, eq=False)
class FrequencyView(View):
    """Residual against frequency.

    Attributes
    ----------
    edges : array, shape (n + 1,)
        Of the bands [Hz].
    ratio : array, shape (n,)
        Power of the residual over that of the noise.
    p_values, flags : array, shape (n,)
        Of each band's power, and whether it is significant; nothing is where the noise is unknown.
    coherence : array, shape (n,)
        Squared coherence of the residual with the imposed signal; nan where it is not known.
    coherent : array, shape (n,)
        Whether it is significant.
    driven : {"torque", "angle"}
        What was imposed.
    """

    name: ClassVar[str] = "frequency"

    edges: np.ndarray
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray
    coherence: np.ndarray
    coherent: np.ndarray
    driven: str

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Test the residual's power, and its coherence with what was imposed, in octaves."""
        driven = scene.parts[0].trial.driven
        residuals, inputs, owners, duration = _segments(scene)
        if not owners:
            none = np.zeros(0)
            flags = np.zeros(0, bool)
            return cls(False, scene.noise.known, none, none, none, flags, none, flags, driven)
        highest = min(len(r) for r in residuals)
        edges = _octaves(highest - 1)
        power = np.array([np.abs(r[:highest]) ** 2 for r in residuals])
        cross = np.array(
            [r[:highest] * np.conj(u[:highest]) for r, u in zip(residuals, inputs, strict=True)]
        )
        drive = np.array([np.abs(u[:highest]) ** 2 for u in inputs])
        known = len(owners) >= _FEWEST_SEGMENTS
        norm = power.sum(axis=0) * drive.sum(axis=0)
        squared = np.abs(cross.sum(axis=0)) ** 2 / np.where(norm > 0, norm, 1.0)
        squared = np.clip(squared, 0.0, 1 - 1e-12)
        n = edges.size - 1
        # The taper joins neighbouring frequencies: so many count as one.
        taper = signal.windows.tukey(1000, _TAPERED)
        shared = float(np.mean(taper**4) / np.mean(taper**2) ** 2)
        ratio, p_values = np.ones(n), np.ones(n)
        coherence, p_coherent = np.full(n, np.nan), np.ones(n)
        for k, (low, high) in enumerate(itertools.pairwise(edges)):
            band = slice(low, high)
            portions = [
                Portion(2 * (high - low) * owners.count(i) / shared, 0.0, float(scene.noise.dof[i]))
                for i in dict.fromkeys(owners)
            ]
            hertz_of_band = np.arange(low, high) / duration
            places = [hertz_of_band * ready.drive.interval for ready in scene.parts]
            slack = max(scene.noise.slack(place) for place in places)
            lift = max(scene.noise.lift(place) for place in places) if scene.noise.known else 0.0
            total = 2 * float(power[:, band].sum()) / shared / (1 + lift)
            ratio[k], p_values[k] = excess(total, portions, slack)
            p_values[k] = max(
                p_values[k], _against_lead(scene, hertz_of_band, power[:, band], owners)
            )
            if known:
                coherence[k] = squared[band].mean()
                # Of noise, -(L - 1) ln(1 - coherence) of L segments is exponentially distributed.
                score = -(len(owners) - 1) * np.log1p(-squared[band]).sum()
                p_coherent[k] = stats.gamma.sf(score / shared, (high - low) / shared)
        flags = scene.significant(p_values) if scene.noise.known else np.zeros(n, bool)
        coherent = scene.significant(p_coherent) if known else np.zeros(n, bool)
        significant = bool(flags.any() if scene.noise.known else coherent.any())
        return cls(
            significant,
            scene.noise.known,
            edges / duration,
            ratio,
            p_values,
            flags,
            coherence,
            coherent,
            driven,
        )

    @property
    def coherence_known(self) -> bool:
        """Whether there are segments enough for a coherence."""
        return bool(np.isfinite(self.coherence).any())

    def words(self) -> str:
        """At which frequencies, and whether what was imposed drives it."""
        if not self.edges.size:
            return "The trials are too short for a spectrum."
        imposed = f"the imposed {self.driven}"
        if not self.noise_known:
            if not self.coherence_known:
                return "The noise is unknown and there are too few trials for a coherence."
            if not self.coherent.any():
                return f"At no frequency is the residual coherent with {imposed}."
            return (
                f"The residual is coherent with {imposed} at {_bands(self.edges, self.coherent)}: "
                "what is missing is driven by it (the noise is unknown)."
            )
        if not self.significant:
            return (
                "At no frequency does the residual's power exceed the noise's "
                f"({self.flags.size} bands)."
            )
        worst = int(np.argmax(np.where(self.flags, self.ratio, 0.0)))
        low, high = self.edges[worst : worst + 2]
        sentence = (
            f"The residual's power exceeds the noise's at {_bands(self.edges, self.flags)}, most "
            f"({number(self.ratio[worst], 2)} times) at {number(low, 2)} to {number(high, 2)} Hz"
        )
        if not self.coherence_known:
            return sentence + "."
        does = "is" if (self.coherent & self.flags).any() else "is not"
        return f"{sentence}; it {does} coherent with {imposed}."

    def panels(self) -> tuple[Panel, ...]:
        """The residual's power by frequency, or its coherence where the noise is unknown."""
        if self.noise_known:
            return (Panel("by frequency", self.draw_power),) if self.edges.size else ()
        return (Panel("by frequency", self.draw_coherence),) if self.coherence_known else ()

    def draw_power(self, panel: Axes) -> None:
        """Draw the residual's power over the noise's, and mark what is coherent."""
        centres = self._axis(panel)
        panel.stairs(self.ratio, self.edges, color=BLUE, baseline=None)
        points(panel, centres, self.ratio, self.flags)
        both = self.flags & self.coherent
        panel.plot(
            centres[both],
            self.ratio[both],
            "o",
            mfc="none",
            mec=VERMILLION,
            ms=7,
            mew=1.2,
            label=f"coherent with the {self.driven}",
        )
        unity(panel)
        ratios(panel, float(self.ratio.max()))
        panel.set_ylabel("residual / noise, power")
        if both.any():
            legend_above(panel)

    def draw_coherence(self, panel: Axes) -> None:
        """Draw the residual's coherence with what was imposed."""
        centres, coherence = self._axis(panel), np.nan_to_num(self.coherence)
        panel.stairs(coherence, self.edges, color=BLUE, baseline=None)
        points(panel, centres, coherence, self.coherent)
        panel.set_ylim(0, 1)
        panel.set_ylabel(f"coherence with the {self.driven}")

    def _axis(self, panel: Axes) -> np.ndarray:
        """Make the horizontal axis; gives the middles of the bands [Hz]."""
        panel.set_xscale("log")
        panel.set_xlabel("frequency [Hz]")
        return np.asarray(np.sqrt(self.edges[:-1] * self.edges[1:]))


def _segments(
    scene: Scene,
) -> tuple[list[np.ndarray], list[np.ndarray], list[int], float]:
    """Spectra of whitened residuals and imposed signals over segments of one duration."""
    firsts = [int(b.index[0, 0]) if b.index.size else 0 for b in scene.blocks]
    spans = [
        (r.last - r.first - first) * r.drive.interval
        for r, first in zip(scene.parts, firsts, strict=True)
    ]
    duration = min(min(spans), _LONGEST_SEGMENT)
    residuals, inputs, owners = [], [], []
    for i, (ready, first) in enumerate(zip(scene.parts, firsts, strict=True)):
        length = int(duration / ready.drive.interval * (1 + 1e-9))
        if length < _FEWEST_SAMPLES:
            return [], [], [], duration
        taper = signal.windows.tukey(length, _TAPERED)
        white = scene.noise.white(i, scene.candidate.fitted.by_trial[i])
        acting = ready.drive.signals[ready.first : ready.last, 0]
        acting = acting - acting[first]
        for start in range(first, white.size - length + 1, length):
            part = slice(start, start + length)
            residuals.append(np.fft.rfft(taper * white[part]) / np.sqrt(np.sum(taper**2)))
            inputs.append(np.fft.rfft(taper * acting[part]))
            owners.append(i)
    return residuals, inputs, owners, duration


def _against_lead(
    scene: Scene, hertz: np.ndarray, power: np.ndarray, owners: Sequence[int]
) -> float:
    """Probability that a band's power exceeds the highest peak of the leads in it, by chance.

    The noise's spectrum is a smooth fit to the leads; a hum stands out from it in both. Bands below
    what the leads resolve are left to the fit.
    """
    trials = list(dict.fromkeys(owners))
    quiet = np.zeros(hertz.size)
    for i in trials:
        ready = scene.parts[i]
        n, interval = ready.lead.n_samples, ready.drive.interval
        if not scene.noise.known or hertz[-1] * n * interval < 1:
            return 0.0
        white = scene.noise.white(i, np.asarray(ready.response[:n])[:, None])[:, 0]
        turn = np.exp(-2j * np.pi * np.outer(hertz, np.arange(n) * interval))
        quiet += np.abs(turn @ white) ** 2 / n / len(trials)
    return float(stats.f.sf(power.mean() / quiet.max(), 2 * power.size, 2 * len(trials)))


def _octaves(highest: int) -> np.ndarray:
    """Edges of bands an octave wide, as numbers of periods in a segment, without its mean."""
    edges = [1]
    while edges[-1] < highest:
        edges.append(min(max(2 * edges[-1], edges[-1] + 1), highest))
    return np.array(edges)


def _bands(hertz: np.ndarray, flags: np.ndarray) -> str:
    """Flagged bands in words, neighbours joined."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    pairs = edge.reshape(-1, 2)
    return " and ".join(
        f"{number(hertz[low], 2)} to {number(hertz[high], 2)} Hz" for low, high in pairs
    )
