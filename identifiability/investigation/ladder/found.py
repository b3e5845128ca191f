"""What was found missing: the final model, and one record for each of its effects."""

from __future__ import annotations

from dataclasses import dataclass

from identifiability.investigation.fits.candidate import Candidate
from identifiability.joint.effects import Effect


@dataclass(frozen=True, eq=False)
class Tried:
    """One effect that was tried beside others, or in another's place.

    Attributes
    ----------
    key : str
        The effect.
    candidate : Candidate
        The model with it, as it was weighed.
    evidence : float
        Log evidence [nats] above that of the model which it is held against.
    error : float
        Share of the response's energy that the model leaves, of all trials in the compared band.
    probability : float
        That the model's effects are what is missing.
    failure : str
        Why it could not be weighed; then nothing else is known of it.
    """

    key: str
    candidate: Candidate
    evidence: float
    error: float
    probability: float
    failure: str = ""

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.candidate.model.effect(self.key)

    @property
    def own_values(self) -> dict[str, float]:
        """Values of the effect's own parameters, by their full names."""
        own = f"{self.key}."
        return {n: v for n, v in self.candidate.values.items() if n.startswith(own)}


@dataclass(frozen=True, eq=False)
class Missing:
    """One effect that the baseline lacks, and all that is known of it.

    Attributes
    ----------
    effect : Effect
        As it stands in the final model.
    rung : Candidate
        The model with this effect and those before it on the error ladder.
    without : Candidate
        The final model without it.
    rivals : tuple of Tried
        What was weighed in its place, best first; evidence is against the final model.
    could_be : tuple of str
        Keys of the effects that the data do not tell from it, it included, best name first.
    instead : tuple of Candidate
        The final model with each of those in its place, fitted to the same trials.
    share : float or None
        Share of the baseline's misfit that it removes in its turn, on held-out trials where there
        are any.
    """

    effect: Effect
    rung: Candidate
    without: Candidate
    rivals: tuple[Tried, ...]
    could_be: tuple[str, ...]
    instead: tuple[Candidate, ...]
    share: float | None

    @property
    def key(self) -> str:
        """Key under which it was fitted."""
        return self.effect.key

    @property
    def name(self) -> str:
        """Key of its best name."""
        return self.could_be[0]

    @property
    def equals(self) -> tuple[Tried, ...]:
        """Rivals that the data do not tell from it."""
        return tuple(r for r in self.rivals if r.key in self.could_be)


@dataclass(frozen=True, eq=False)
class Found:
    """What was found missing.

    Attributes
    ----------
    baseline : Candidate
    alone : tuple of Tried
        Every effect beside the baseline, best first, those that failed last; evidence is against
        the baseline.
    final : Candidate
    missing : tuple of Missing
        The final model's effects, in the order of the error ladder: at every rung the one with
        which the model is most probable.
    share : float or None
        Share of the baseline's misfit that all of them remove.
    n_weighed : int
        Number of sets of effects that were weighed.
    failure : str
        Why the model that is claimed could not be fitted; then the final one is the baseline.
    nearest : Candidate or None
        The most probable model with known effects, where something unknown is missing and the final
        model is the baseline: for that it is not probable enough.
    """

    baseline: Candidate
    alone: tuple[Tried, ...]
    final: Candidate
    missing: tuple[Missing, ...]
    share: float | None
    n_weighed: int
    failure: str = ""
    nearest: Candidate | None = None

    @property
    def ladder(self) -> tuple[Candidate, ...]:
        """The baseline, then the model with each effect added."""
        return (self.baseline, *(m.rung for m in self.missing))

    @classmethod
    def nothing(cls, baseline: Candidate) -> Found:
        """What is found where nothing could be weighed."""
        return cls(baseline, (), baseline, (), None, 0)
