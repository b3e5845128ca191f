"""Where two models differ in what they predict of the trials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.split import Split
from identifiability.measurement.prepared import Prepared


@dataclass(frozen=True, eq=False)
class Rivals:
    """Two models of the same trials.

    Attributes
    ----------
    split : Split
    first, second : Candidate
        Both fitted.
    """

    split: Split
    first: Candidate
    second: Candidate

    @property
    def trials(self) -> tuple[Prepared, ...]:
        """All trials, the fitted ones first."""
        return (*self.split.fitted, *self.split.held_out)

    @cached_property
    def by_trial(self) -> tuple[np.ndarray, ...]:
        """First minus second prediction [rad or Nm] of each trial."""
        pairs = zip(left_of(self.first), left_of(self.second), strict=True)
        return tuple(b - a for a, b in pairs)

    @cached_property
    def most(self) -> tuple[int, int]:
        """Number of the trial, and of the compared sample in it, in which they differ most.

        Differences of a trial count by its weight.
        """
        split = self.split
        sds = [*split.weights_sd(split.fitted), *split.weights_sd(split.held_out)]
        peaks = [float(np.abs(d).max()) / sd for d, sd in zip(self.by_trial, sds, strict=True)]
        trial = int(np.argmax(peaks))
        return trial, int(np.argmax(np.abs(self.by_trial[trial])))

    @property
    def time(self) -> float:
        """Time [s] of that sample."""
        trial, sample = self.most
        ready = self.trials[trial]
        return float(ready.trial.time[ready.first : ready.last][sample])


def left_of(candidate: Candidate) -> tuple[np.ndarray, ...]:
    """What a model leaves of each trial, the fitted ones first."""
    return (*candidate.fitted.by_trial, *candidate.held_out.by_trial)
