"""Two models of a session side by side: which is more probable, and where they differ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identifiability.investigation.next_experiment import (
    Limits,
    NextExperiment,
    next_experiment,
)
from identifiability.investigation.rivals import Rivals
from identifiability.investigation.session import Investigation
from identifiability.workbench.attempt import Attempt


@dataclass(frozen=True, eq=False)
class Difference:
    """Two models side by side.

    Attributes
    ----------
    first, second : Attempt
    nats : float
        By which the first is more probable than the second, the prior for their numbers of effects
        included.
    study : Investigation
        Of the trials.
    """

    first: Attempt
    second: Attempt
    nats: float
    study: Investigation

    @property
    def probability(self) -> float:
        """Of the first, if one of the two is right."""
        return float(1 / (1 + np.exp(-np.clip(self.nats, -700, 700))))

    @cached_property
    def rivals(self) -> Rivals:
        """Where the two differ in what they predict."""
        return Rivals(self.study.split, self.first.candidate, self.second.candidate)

    def experiment(self, *, limits: Limits | None = None, seed: int = 1) -> NextExperiment:
        """The perturbation that would best tell the two apart.

        Parameters
        ----------
        limits : Limits, optional
            Those that the recorded trials kept by default.
        seed : int
            Of random waveforms.

        Raises
        ------
        InputError
            Where no perturbation within the limits has a finite response.
        """
        one, other = set(self.first.added), set(self.second.added)
        pair = tuple("+".join(sorted(keys)) or "K, B, I" for keys in (one - other, other - one))
        return next_experiment(
            self.study.bench,
            self.first.candidate,
            self.second.candidate,
            (pair[0], pair[1]),
            limits=limits,
            seed=seed,
        )

    def __repr__(self) -> str:
        from identifiability.workbench.show import difference_sentence

        return difference_sentence(self)

    def _repr_html_(self) -> str:
        from identifiability.workbench.show import page

        return page(self)
