"""What a search found: its rankings, its final model, and one record for each missing effect."""

from __future__ import annotations

from dataclasses import dataclass

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.search.gate import Ranked
from identifiability.joint.effects import Effect


@dataclass(frozen=True, eq=False)
class Ranking:
    """Every effect tried beside one model.

    Attributes
    ----------
    before : Candidate
    ranked : tuple of Ranked
        All candidates, best first.
    chosen : str
        Effect that was added, empty where none was admitted.
    decisive : float
        Evidence that was asked for.
    screened_out : tuple of str
        Effects that were not fitted, because their signature is not in the residual.
    """

    before: Candidate
    ranked: tuple[Ranked, ...]
    chosen: str
    decisive: float
    screened_out: tuple[str, ...] = ()


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
    rivals : tuple of Ranked
        What could stand in its place, best first; evidence is against the final model.
    could_be : tuple of str
        Keys of the effects that the data do not tell from it, it included, best name first.
    near : tuple of str
        Those of them that the data speak against, but no more than inexact equations may hide.
    share : float or None
        Share of the baseline's misfit that it removes in its turn, on held-out trials where there
        are any.
    """

    effect: Effect
    rung: Candidate
    without: Candidate
    rivals: tuple[Ranked, ...]
    could_be: tuple[str, ...]
    near: tuple[str, ...]
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
    def equals(self) -> tuple[Ranked, ...]:
        """Rivals that the data do not tell from it."""
        return tuple(r for r in self.rivals if r.key in self.could_be)


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    baseline : Candidate
    rankings : tuple of Ranking
        One a step. The last one admitted nothing, unless the search ended for another reason.
    final : Candidate
    missing : tuple of Missing
        The final model's effects, in the order of the error ladder: at every rung the one that
        lowers the error most.
    share : float or None
        Share of the baseline's misfit that all of them remove.
    descriptions : tuple of Ranked
        Descriptions that name no one mechanism, in the place of effects of the final model that may
        be no more than that; one that passes stands for them. Evidence is against the final model.
    exact : bool
        Whether the final model leaves no more than noise.
    n_fits : int
        Number of models that were fitted.
    ended : {"nothing admitted", "at the floor", "most effects", "by probability"}
        Why the search ended; "by probability" where its end was given.
    """

    baseline: Candidate
    rankings: tuple[Ranking, ...]
    final: Candidate
    missing: tuple[Missing, ...]
    share: float | None
    descriptions: tuple[Ranked, ...]
    exact: bool
    n_fits: int
    ended: str

    @property
    def ladder(self) -> tuple[Candidate, ...]:
        """The baseline, then the model with each effect added."""
        return (self.baseline, *(m.rung for m in self.missing))

    @property
    def description(self) -> Ranked | None:
        """The description that stands for effects of the final model best, if one does."""
        passing = [r for r in self.descriptions if r.passes]
        return max(passing, key=lambda r: r.evidence, default=None)

    def replaced_by(self, description: Ranked) -> tuple[Missing, ...]:
        """Missing effects in whose place a description was fitted."""
        return tuple(m for m in self.missing if m.key not in description.candidate.keys)
