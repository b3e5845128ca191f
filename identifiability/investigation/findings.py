"""What an investigation found, from trials to verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from identifiability.inference.widths import Widths
from identifiability.investigation.ladder.found import Found
from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.split import Split
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.judge import Verdict
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location
from identifiability.joint.effects import Effect


@dataclass(frozen=True, eq=False)
class Findings:
    """What an investigation found.

    Attributes
    ----------
    split : Split
        The trials, fitted and held out.
    found : Found
        The model that is claimed, or comes nearest, effect by effect.
    comparison, location : Comparison, Location or None
        Of the baseline model.
    unexplained_before, unexplained_after : Unexplained or None
        Library-free account of what the baseline and the final model leave.
    widths : Widths or None
        Of the final model's parameters.
    verdict : Verdict
    next_experiment : NextExperiment or None
        ``None`` where no pair of effects is open.
    library : mapping of str to type of Effect
        Effects that were tried.
    failures : mapping of str to str
        Parts that could not be done, and why: these are ``None`` above.
    remarks : tuple of str
        What the trials did not allow, or said of how they were recorded.
    seed : int
    posterior : Probabilities or None
        Probabilities of the sets of effects that were weighed.
    timings : mapping of str to float
        Seconds that each part took; those that ran side by side overlap.
    """

    split: Split
    found: Found
    comparison: Comparison | None
    location: Location | None
    unexplained_before: Unexplained | None
    unexplained_after: Unexplained
    widths: Widths | None
    verdict: Verdict
    next_experiment: NextExperiment | None
    library: Mapping[str, type[Effect]]
    failures: Mapping[str, str]
    remarks: tuple[str, ...]
    seed: int
    posterior: Probabilities | None
    timings: Mapping[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """All that a reader must be told: the remarks, then the parts that failed."""
        return (*self.remarks, *self.failed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Parts that could not be done, and why."""
        return tuple(f"{part}: {why}" for part, why in sorted(self.failures.items()))
