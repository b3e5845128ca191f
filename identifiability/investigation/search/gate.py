"""Which effects are believed: evidence, agreement of the held-out trials, and share of the misfit.

Split for a larger model is the logarithm of the ratio of the weighted residuals, times the
number of samples that count as independent, less a penalty for its parameters: the Bayesian
information criterion of Schwarz 1978 (Ann Stat 6: 461-464) with an unknown scale of the noise.
Trials that were held out add twice their gain in log likelihood, with no penalty: an effect may
show only in the condition that was not fitted. The residual of a model that is not exact is
correlated, so it counts for few samples; at the noise floor nearly all count.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import difference, effective_samples
from identifiability.joint.effects import Effect
from identifiability.joint.parameters import with_unit

DECISIVE = 10.0
"""Difference of the information criterion that counts as decisive (Kass & Raftery 1995: more than
10 is very strong evidence)."""
_SHARE, _SHARE_UNKNOWN_NOISE = 1 / 3, 0.1
"""Share of the remaining misfit that an effect must remove, and the same where the noise is not
known: conventions."""
_NEAR_FLOOR = 1.5
FORM = 0.01
"""Share of a misfit that equations right to a tenth of their torque may leave: its square.
A further effect that removes less than this share of what those before it removed may only mend
their equations, and a rival that removes all but this share is not excluded by it."""
ONLY_MENDS = "may only mend the equations of the effects before it"
TOO_LITTLE = "removes too little of what is left"
DISAGREE = "the held-out trials do not agree"


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
    passes : bool
        Whether it is admitted: decisive evidence, and the held-out trials agree.
    reason : str
        Why it is not.
    objection : str
        Why its values cannot be those of a joint, whatever the evidence.
    doubt : str
        Why they are more likely those of another effect: taken where no other is admitted.
    refitted : float or None
        Split with the held-out trials fitted too, where only these speak against a rival: they
        may then move its parameters as far as the fitted trials leave them open.
    """

    key: str
    candidate: Candidate
    evidence: float
    held_out_gain: float
    passes: bool
    reason: str
    objection: str = ""
    doubt: str = ""
    refitted: float | None = None

    @property
    def effect(self) -> Effect:
        """The effect that it adds, or puts in another's place."""
        return self.candidate.model.effect(self.key)

    def values_in_words(self) -> list[str]:
        """Fitted values of the effect's own parameters, with units."""
        parameters = self.candidate.model.parameters
        return [
            f"{name.split('.')[1].replace('_', ' ')} "
            + with_unit(f"{value:.3g}", parameters[name].unit)
            for name, value in self.candidate.values.items()
            if name.startswith(f"{self.key}.") and name in self.candidate.free
        ]

    @property
    def caveat(self) -> str:
        """What its values say against it, whatever the evidence: an objection or a doubt."""
        return self.objection or self.doubt


@dataclass(eq=False)
class Gate:
    """Judges whether an effect is to be believed.

    Attributes
    ----------
    bench : Workbench
    first : Candidate or None
        The model that the search started from.
    """

    bench: Workbench
    first: Candidate | None = None

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
            return Ranked(key, candidate, -np.inf, -np.inf, False, candidate.failure)
        gain = total_evidence(candidate, current, best)
        held = held_out_gain(candidate, current)
        objection = self.bench.objection(candidate)
        reason = objection
        if gain < DECISIVE:
            reason = "no decisive evidence"
        elif not self._held_out_agrees(candidate, current, held):
            reason = DISAGREE
        elif not self._matters(candidate, current):
            reason = TOO_LITTLE
        elif self.only_mends(candidate, current):
            reason = ONLY_MENDS
        doubt = self.bench.doubt(candidate, key)
        return Ranked(key, candidate, gain, held, not reason, reason, objection, doubt)

    def _held_out_agrees(self, candidate: Candidate, current: Candidate, held: float) -> bool:
        if not self.bench.split.held_out:
            return True
        fit_gain = np.log(current.fitted.weighted / candidate.fitted.weighted)
        # A quarter of the gain, less what chance may take away from it.
        moved = difference(current.held_out, candidate.held_out)
        samples = effective_samples(candidate.held_out, moved)
        chance = 2 * np.sqrt(max(fit_gain, 0.0) / samples)
        return bool(held > 0.25 * fit_gain - chance and held > 0)

    def only_mends(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether a further effect removes no more than inexact equations may leave.

        It is believed all the same where nothing but noise is left with it, and clearly more
        without it: an effect that stands for an error of form seldom fits that well.
        """
        first = self.first
        if first is None or not set(first.keys) < set(current.keys) < set(candidate.keys):
            return False
        before, now, after = (pooled_error(c) for c in (first, current, candidate))
        if now - after >= FORM * (before - now):
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
        margin = min(3 * split.floor_uncertainty(), 0.3)
        return pooled_error(candidate) <= floor * (1 + margins * margin)

    def _matters(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether an effect removes a fair share of the misfit that the model before left.

        No equation is exact, and with enough data the evidence for mending one with another is
        always decisive. What is left near the noise floor is not judged by its share.
        """
        split = self.bench.split
        everything = (*split.fitted, *split.held_out)
        floor = split.noise_floor(everything)
        before, after = (pooled_error(c) for c in (current, candidate))
        if floor is None:
            return after < (1 - _SHARE_UNKNOWN_NOISE) * before
        if before < _NEAR_FLOOR * floor:
            return True
        return after - floor < (1 - _SHARE) * (before - floor)

    def at_floor(self, candidate: Candidate) -> bool:
        """Whether a model leaves no more than the noise does, or an error of measurement may."""
        floor = self.bench.split.noise_floor()
        if floor is None:
            return candidate.fitted.error <= self.bench.rules.discrepancy
        slack = 2 * self.bench.split.floor_uncertainty()
        return candidate.fitted.error <= floor * (1 + min(slack, 0.3))


def evidence_for(larger: Candidate, smaller: Candidate, best: Candidate) -> float:
    """Decrease of the information criterion from one model to another.

    Parameters
    ----------
    larger, smaller : Candidate
    best : Candidate
        Whose residual is taken for the noise.
    """
    if not np.isfinite(larger.fitted.weighted):
        return -np.inf
    samples = effective_samples(best.fitted, difference(smaller.fitted, larger.fitted))
    extra = len(larger.free) - len(smaller.free)
    ratio = smaller.fitted.weighted / larger.fitted.weighted
    return float(samples * np.log(ratio) - extra * np.log(samples))


def predictive_evidence(larger: Candidate, smaller: Candidate) -> float:
    """Twice the gain in log likelihood of the held-out trials from one model to another.

    Parameters
    ----------
    larger, smaller : Candidate
        Neither was fitted to these trials.
    """
    if not larger.held_out.by_trial or not smaller.held_out.by_trial:
        return 0.0
    best = min(larger.held_out, smaller.held_out, key=lambda part: part.weighted)
    samples = effective_samples(best, difference(smaller.held_out, larger.held_out))
    return float(samples * np.log(smaller.held_out.weighted / larger.held_out.weighted))


def total_evidence(larger: Candidate, smaller: Candidate, best: Candidate) -> float:
    """Split of the fitted trials, and of the held-out ones."""
    return evidence_for(larger, smaller, best) + predictive_evidence(larger, smaller)


def unpenalised(rival: Candidate, final: Candidate) -> float:
    """What a rival's larger number of parameters cost it: parsimony may rank, but not exclude."""
    extra = len(rival.free) - len(final.free)
    samples = effective_samples(final.fitted, difference(final.fitted, rival.fitted))
    return float(max(0, extra) * np.log(samples))


def only_held_out_objects(rival: Ranked, final: Candidate) -> bool:
    """Whether a possible rival fits as well as the final model, but does not predict as well."""
    if rival.candidate.failure or rival.caveat or not final.held_out.by_trial:
        return False
    fitted = evidence_for(rival.candidate, final, least([rival.candidate, final]))
    fits = fitted + unpenalised(rival.candidate, final) > -DECISIVE
    return fits and not does_as_well(rival, final)


def does_as_well(rival: Ranked, final: Candidate) -> bool:
    """Whether nothing speaks decisively against a rival, parsimony not counted.

    Where it was fitted to the held-out trials too, that fit counts in the place of its prediction.
    """
    evidence = rival.evidence if rival.refitted is None else rival.refitted
    if evidence + unpenalised(rival.candidate, final) <= -DECISIVE:
        return False
    return rival.refitted is not None or not predicts_worse(rival, final)


def predicts_worse(rival: Ranked, final: Candidate) -> bool:
    """Whether a rival predicts the held-out trials decisively worse than the final model."""
    if not final.held_out.by_trial:
        return False
    moved = difference(final.held_out, rival.candidate.held_out)
    return effective_samples(final.held_out, moved) * rival.held_out_gain <= -DECISIVE


def pooled_error(candidate: Candidate) -> float:
    """E pooled over all trials, fitted and held out."""
    parts = [candidate.fitted.errors]
    if candidate.held_out.by_trial:
        parts.append(candidate.held_out.errors)
    return float(np.mean(np.concatenate(parts)))


def held_out_gain(candidate: Candidate, current: Candidate) -> float:
    """Logarithm of the ratio of the weighted held-out residuals, positive if smaller."""
    if not current.held_out.by_trial or not candidate.held_out.by_trial:
        return 0.0
    if not np.isfinite(candidate.held_out.weighted):
        return -np.inf
    return float(np.log(current.held_out.weighted / candidate.held_out.weighted))


def least(candidates: Iterable[Candidate]) -> Candidate:
    """The candidate that leaves least."""
    return min(
        (c for c in candidates if not c.failure), key=lambda candidate: candidate.fitted.weighted
    )
