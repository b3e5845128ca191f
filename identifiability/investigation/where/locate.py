"""Where a model fails: when, at which frequencies, in which states, directions, sizes and trials.

Every view tests the residual, in units of the noise before the perturbation, with its false
discovery rate controlled (Benjamini & Hochberg 1995, J R Stat Soc B 57: 289-300). Where the noise
is unknown the residual is judged by its own level, and only its structure can be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import Refits
from identifiability.investigation.where.imposed import imposed
from identifiability.investigation.where.scene import Scene
from identifiability.investigation.where.view import View
from identifiability.investigation.where.views import VIEWS
from identifiability.investigation.where.whitening import whitening


@dataclass(frozen=True, eq=False)
class Location:
    """Where a model fails.

    Attributes
    ----------
    views : mapping of str to View
        What each view found, by its name: "time", "frequency", "state", "direction", "amplitude",
        "trials" and "conditions", in this order.
    noise_known : bool
        Whether the noise was read from quiet samples before the perturbations.
    driven : {"torque", "angle"}
        What was imposed.
    level : float
        False discovery rate within each view.
    """

    views: Mapping[str, View]
    noise_known: bool
    driven: str
    level: float

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence a view."""
        return tuple(view.words() for view in self.views.values())


def locate(bench: Workbench, candidate: Candidate, views: Sequence[type[View]] = VIEWS) -> Location:
    """Find where a fitted model fails.

    Parameters
    ----------
    bench : Workbench
        Its rules say at what false discovery rate.
    candidate : Candidate
        One of its fits.
    views : sequence of type of View
        Those that are looked at; all by default.

    Returns
    -------
    Location
    """
    parts, level = bench.split.fitted, bench.rules.false_discoveries
    noise = whitening(parts, candidate.fitted)
    blocks = tuple(
        noise.blocks(i, ready, left)
        for i, (ready, left) in enumerate(zip(parts, candidate.fitted.by_trial, strict=True))
    )
    scene = Scene(parts, imposed(parts), candidate, Refits(bench, candidate), noise, blocks, level)
    found = {view.name: view.of(scene) for view in views}
    return Location(found, noise.known, bench.split.driven, level)
