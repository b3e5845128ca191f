"""Where a model fails: when, at which frequencies, in which states, directions, sizes and trials.

Every view tests the residual, in units of the noise before the perturbation, with its false
discovery rate controlled (Benjamini & Hochberg 1995, J R Stat Soc B 57: 289-300), and says in one
sentence what it found. Where the noise is unknown the residual is judged by its own level, and only
its structure can be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import Refits
from identifiability.investigation.where.by_size import (
    AmplitudeView,
    DirectionView,
    by_amplitude,
    by_direction,
)
from identifiability.investigation.where.by_trial import TrialView, by_trial
from identifiability.investigation.where.imposed import imposed
from identifiability.investigation.where.in_frequency import FrequencyView, in_frequency
from identifiability.investigation.where.in_state import StateView, in_state
from identifiability.investigation.where.in_time import TimeView, in_time
from identifiability.investigation.where.scene import Scene, View
from identifiability.investigation.where.whitening import whitening


@dataclass(frozen=True, eq=False)
class Location:
    """Where a model fails.

    Attributes
    ----------
    time, frequency, state, direction, amplitude, trials, conditions : View
    noise_known : bool
        Whether the noise was read from quiet samples before the perturbations.
    driven : {"torque", "angle"}
        What was imposed.
    level : float
        False discovery rate within each view.
    """

    time: TimeView
    frequency: FrequencyView
    state: StateView
    direction: DirectionView
    amplitude: AmplitudeView
    trials: TrialView
    conditions: TrialView
    noise_known: bool
    driven: str
    level: float

    @property
    def views(self) -> dict[str, View]:
        """All views by name."""
        names = ("time", "frequency", "state", "direction", "amplitude", "trials", "conditions")
        return {name: getattr(self, name) for name in names}

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence a view."""
        return tuple(view.sentence for view in self.views.values())


def locate(bench: Workbench, candidate: Candidate, level: float = 0.05) -> Location:
    """Find where a fitted model fails.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        One of its fits.
    level : float
        False discovery rate within each view.

    Returns
    -------
    Location
    """
    parts = bench.split.fitted
    noise = whitening(parts, candidate.fitted)
    blocks = tuple(
        noise.blocks(i, ready, left)
        for i, (ready, left) in enumerate(zip(parts, candidate.fitted.by_trial, strict=True))
    )
    scene = Scene(parts, imposed(parts), candidate, Refits(bench, candidate), noise, blocks, level)
    trials = [(ready.name, [i]) for i, ready in enumerate(parts)]
    names = dict.fromkeys(load.condition for load in scene.loads)
    conditions = [
        (name, [i for i, load in enumerate(scene.loads) if load.condition == name])
        for name in names
    ]
    return Location(
        in_time(scene),
        in_frequency(scene),
        in_state(scene),
        by_direction(scene),
        by_amplitude(scene),
        by_trial(scene, trials, "trial", "trials"),
        by_trial(scene, conditions, "kind of perturbation", "kinds of perturbation"),
        noise.known,
        bench.split.driven,
        level,
    )
