"""Whether an effect is believed: evidence, held-out trials, share of the misfit, values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import difference, effective_samples
from identifiability.investigation.rules import Rules
from identifiability.investigation.search.criterion import (
    evidence_for,
    held_out_gain,
    least,
    pooled_error,
    total_evidence,
    unpenalised,
)
from identifiability.joint.effects import Effect

Refusal = Literal["", "no fit", "no evidence", "disagrees", "too little", "only mends", "objection"]
"""Why a candidate is not admitted: it could not be fitted; its evidence is not decisive; the
held-out trials do not agree; it removes too little of what is left; it may only mend the equations
of the effects before it; its values cannot be those of a joint. Empty where it is admitted."""


@dataclass(frozen=True, eq=False)
class Ranked:
    """One candidate in a ranking.

    Attributes
    ----------
    key : str
        Effect that it adds, or puts in another's place.
    candidate : Candidate
    evidence : float
        Decrease of the information criterion against the model before, plus twice the gain in log
        likelihood of the held-out trials, which were predicted and pay no penalty.
    held_out_gain : float
        Logarithm of the ratio of the weighted held-out residuals before and after.
    refusal : Refusal
        Why it is not admitted.
    objection : str
        Why its values cannot be those of a joint, whatever the evidence.
    doubt : str
        Why they are more likely those of another effect: taken where no other is admitted.
    refitted : float or None
        Evidence with the held-out trials fitted too, where only these speak against a rival: they
        may then move its parameters as far as the fitted trials leave them open.
    """

    key: str
    candidate: Candidate
    evidence: float
    held_out_gain: float
    refusal: Refusal = ""
    objection: str = ""
    doubt: str = ""
    refitted: float | None = None

    @property
    def passes(self) -> bool:
        """Whether it is admitted."""
        return not self.refusal

    @property
    def effect(self) -> Effect:
        """The effect that it adds, or puts in another's place."""
        return self.candidate.model.effect(self.key)

    @property
    def caveat(self) -> str:
        """What its values say against it, whatever the evidence: an objection or a doubt."""
        return self.objection or self.doubt

    @property
    def own_values(self) -> dict[str, float]:
        """Fitted values of the effect's own free parameters, by their full names."""
        return {
            name: value
            for name, value in self.candidate.values.items()
            if name.startswith(f"{self.key}.") and name in self.candidate.free
        }


@dataclass(frozen=True, eq=False)
class Gate:
    """Judges whether an effect is to be believed.

    Attributes
    ----------
    bench : Workbench
    first : Candidate
        The model that the search started from.
    """

    bench: Workbench
    first: Candidate

    @property
    def rules(self) -> Rules:
        """Conventions that it goes by."""
        return self.bench.rules

    def judge(self, key: str, candidate: Candidate, current: Candidate, best: Candidate) -> Ranked:
        """Hold a candidate to every rule.

        Parameters
        ----------
        key : str
            Effect that it adds, or puts in another's place.
        candidate : Candidate
        current : Candidate
            The model before.
        best : Candidate
            Whose residual is taken for the noise.
        """
        if candidate.failure:
            return Ranked(key, candidate, -np.inf, -np.inf, "no fit")
        gain = total_evidence(candidate, current, best)
        held = held_out_gain(candidate, current)
        objection = self.bench.objection(candidate)
        refusal: Refusal = "objection" if objection else ""
        if gain < self.rules.decisive:
            refusal = "no evidence"
        elif not self._held_out_agrees(candidate, current, held):
            refusal = "disagrees"
        elif not self._matters(candidate, current):
            refusal = "too little"
        elif self.only_mends(candidate, current):
            refusal = "only mends"
        doubt = self.bench.doubt(candidate, key)
        return Ranked(key, candidate, gain, held, refusal, objection, doubt)

    def _held_out_agrees(self, candidate: Candidate, current: Candidate, held: float) -> bool:
        if not self.bench.split.held_out:
            return True
        fit_gain = np.log(current.fitted.weighted / candidate.fitted.weighted)
        # A share of the gain, less what chance may take away from it.
        moved = difference(current.held_out, candidate.held_out)
        samples = effective_samples(candidate.held_out, moved)
        chance = 2 * np.sqrt(max(fit_gain, 0.0) / samples)
        return bool(held > self.rules.agreeing_share * fit_gain - chance and held > 0)

    def only_mends(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether a further effect removes no more than inexact equations may leave.

        It is believed all the same where nothing but noise is left with it, and clearly more
        without it: an effect that stands for an error of form seldom fits that well.
        """
        if not set(self.first.keys) < set(current.keys) < set(candidate.keys):
            return False
        before, now, after = (pooled_error(c) for c in (self.first, current, candidate))
        if now - after >= self.rules.form * (before - now):
            return False
        return self._near_noise(current, 2) or not self.leaves_noise(candidate)

    def leaves_noise(self, candidate: Candidate) -> bool:
        """Whether a model leaves no more than noise, of the fitted and of all trials."""
        return self.at_floor(candidate) and self._near_noise(candidate)

    def _near_noise(self, candidate: Candidate, margins: float = 1) -> bool:
        """Whether the pooled error is within so many margins of the noise floor's uncertainty."""
        split = self.bench.split
        floor = split.noise_floor((*split.fitted, *split.held_out))
        if floor is None:
            return self.at_floor(candidate)
        margin = min(3 * split.floor_uncertainty(), self.rules.most_slack)
        return pooled_error(candidate) <= floor * (1 + margins * margin)

    def _matters(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether an effect removes a fair share of the misfit that the model before left.

        No equation is exact, and with enough data the evidence for mending one with another is
        always decisive. What is left near the noise floor is not judged by its share.
        """
        split, rules = self.bench.split, self.rules
        floor = split.noise_floor((*split.fitted, *split.held_out))
        before, after = (pooled_error(c) for c in (current, candidate))
        if floor is None:
            return after < (1 - rules.removed_share_unknown_noise) * before
        if before < rules.near_floor * floor:
            return True
        return after - floor < (1 - rules.removed_share) * (before - floor)

    def at_floor(self, candidate: Candidate) -> bool:
        """Whether a model leaves no more than the noise does, or an error of measurement may."""
        floor = self.bench.split.noise_floor()
        if floor is None:
            return candidate.fitted.error <= self.rules.discrepancy
        slack = min(2 * self.bench.split.floor_uncertainty(), self.rules.most_slack)
        return candidate.fitted.error <= floor * (1 + slack)

    def only_held_out_objects(self, rival: Ranked, final: Candidate) -> bool:
        """Whether a possible rival fits as well as the final model, but predicts less well."""
        if rival.candidate.failure or rival.caveat or not final.held_out.by_trial:
            return False
        fitted = evidence_for(rival.candidate, final, least([rival.candidate, final]))
        fits = fitted + unpenalised(rival.candidate, final) > -self.rules.decisive
        return fits and not self.does_as_well(rival, final)

    def does_as_well(self, rival: Ranked, final: Candidate) -> bool:
        """Whether nothing speaks decisively against a rival, parsimony not counted.

        Where it was fitted to the held-out trials too, that fit counts in the place of its
        prediction.
        """
        if rival.candidate.failure:
            return False
        evidence = rival.evidence if rival.refitted is None else rival.refitted
        if evidence + unpenalised(rival.candidate, final) <= -self.rules.decisive:
            return False
        return rival.refitted is not None or not self._predicts_worse(rival, final)

    def _predicts_worse(self, rival: Ranked, final: Candidate) -> bool:
        """Whether a rival predicts the held-out trials decisively worse than the final model."""
        if not final.held_out.by_trial:
            return False
        moved = difference(final.held_out, rival.candidate.held_out)
        samples = effective_samples(final.held_out, moved)
        return samples * rival.held_out_gain <= -self.rules.decisive
