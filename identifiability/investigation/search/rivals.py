"""What could stand in the place of an effect: other effects, or a description of no mechanism."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.search.criterion import evidence_for, least, pooled_error
from identifiability.investigation.search.gate import Ranked
from identifiability.investigation.search.ranking import Ranker
from identifiability.joint.effects import (
    Effect,
    LooseCoupling,
    RelaxationSpectrum,
    StiffeningHysteresis,
)

_MOST_SWAPS = 4
_CONTENDS = 0.1  # share of what an effect removes, that a rival worth refining may leave


@dataclass(frozen=True, eq=False)
class Rivals:
    """Fits others in the place of effects.

    Attributes
    ----------
    ranker : Ranker
    baseline : Candidate
        The model that the search started from.
    """

    ranker: Ranker
    baseline: Candidate

    def added(self, current: Candidate) -> list[str]:
        """Effects of a model that the baseline does not have."""
        return [key for key in current.keys if key not in self.baseline.keys]

    def without(self, key: str, current: Candidate) -> Candidate:
        """A model fitted without one of its effects."""
        rest = current.model.without(key)
        if rest.effect_keys == self.baseline.keys:
            return self.baseline
        return self.ranker.fitter.fit(rest, self.baseline, refined=current.refined)

    def in_place_of(self, key: str, current: Candidate) -> list[Ranked]:
        """Other effects in the place of one, ranked against the model with it."""
        ranker = self.ranker
        # Others start from the best fit without the effect, not from what is left of this one.
        rest = self.without(key, current)
        jobs = [
            (rest.model + ranker.library[other](), other) for other in self._likely(key, current)
        ]
        fitted = ranker.fit_all(
            f"in the place of {key}", jobs, self.baseline if rest.failure else rest
        )
        # A rival to a refined effect is refined too, or the comparison is not fair; so is one that
        # comes near in its plain form.
        near_to = pooled_error(current)
        near_to += _CONTENDS * (pooled_error(rest) - near_to)
        fitted = [
            (other, ranker.fitter.richer(plain, other))
            if key in current.refined or pooled_error(plain) < near_to
            else (other, plain)
            for other, plain in fitted
        ]
        return ranker.judge_all(fitted, current)

    def _likely(self, key: str, current: Candidate) -> list[str]:
        """Effects that may stand in the place of another: alike by nature, or alike alone."""
        library, fitter = self.ranker.library, self.ranker.fitter
        alone = {k: c.fitted.weighted for k in library if (c := fitter.alone(k)) is not None}
        by_merit = sorted(alone, key=alone.__getitem__)
        order = [*library[key].confused_with, *by_merit] if key in library else by_merit
        unique = dict.fromkeys(k for k in order if k not in current.keys and k in library)
        return list(unique)[:_MOST_SWAPS]

    def with_all_trials(self, rival: Ranked, final: Candidate) -> Ranked:
        """A rival with what it does once the held-out trials that speak against it are fitted."""
        ranker = self.ranker
        if not ranker.gate.only_held_out_objects(rival, final):
            return rival
        ranker.progress(f"{rival.key} fitted to all trials", 1, 1)
        mine, other = (ranker.fitter.fit_to_all(c) for c in (final, rival.candidate))
        if mine.failure or other.failure:
            return rival
        return replace(rival, refitted=evidence_for(other, mine, least([other, mine])))

    def descriptions(self, final: Candidate, exact: bool) -> tuple[Ranked, ...]:
        """What names no one mechanism, in the place of those that it may unmask.

        Two mechanisms with memory may together be no more than relaxation at several paces, and
        that need only do as well. The others are richer than the one that they unmask, and must do
        better by all that an effect has to.
        """
        memory = [key for key in self.added(final) if final.model.effect(key).has_memory]
        out = []
        if len(memory) > 1:
            found = self._described(RelaxationSpectrum(), memory, final)
            as_well = found.evidence > -self.ranker.bench.rules.decisive
            out.append(replace(found, refusal="" if as_well else found.refusal or "no evidence"))
        if not exact:
            out += [
                self._described(kind(), [key], final)
                for kind in (StiffeningHysteresis, LooseCoupling)
                for key in kind.refines
                if key in memory
            ]
        return tuple(out)

    def _described(
        self, description: Effect, instead_of: Sequence[str], final: Candidate
    ) -> Ranked:
        fitter, model, near = self.ranker.fitter, final.model, self.baseline
        for key in instead_of:
            model = model.without(key)
        if model.effect_keys != self.baseline.keys:
            near = fitter.fit(model, self.baseline, refined=final.refined)
        self.ranker.progress(f"describing {' and '.join(instead_of)}", 1, 1)
        plain = fitter.fit(model + description, near, refined=final.refined)
        found = fitter.richer(plain, description.key)
        return self.ranker.gate.judge(description.key, found, final, least([final, found]))
