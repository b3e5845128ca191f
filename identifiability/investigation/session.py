"""The steps of an investigation by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.errors import InputError
from identifiability.inference.between import MATTERS, Between
from identifiability.inference.widths import Widths
from identifiability.investigation.fits.baseline import (
    fit_baseline,
    leads_are_motion,
    without_leads,
)
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.kept import InMemory, Kept, OnDisk
from identifiability.investigation.fits.widths import parameter_widths
from identifiability.investigation.ladder.climb import found_of
from identifiability.investigation.ladder.found import Found
from identifiability.investigation.next_experiment import (
    Limits,
    NextExperiment,
    next_experiment,
    open_pair,
)
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.posterior.claim import Claim, claim_of
from identifiability.investigation.posterior.combining import log_prior
from identifiability.investigation.posterior.evidence import Evaluator
from identifiability.investigation.posterior.kept import Evaluations
from identifiability.investigation.posterior.nested import weigh_nested
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.investigation.posterior.search import weigh
from identifiability.investigation.rules import Rules
from identifiability.investigation.smallest_seen.detectable import Detectable, detectable
from identifiability.investigation.split import Split, gather
from identifiability.investigation.unexplained.account import Unexplained, unexplained
from identifiability.investigation.verdict.judge import Verdict, judge
from identifiability.investigation.where.compare import Comparison, compare
from identifiability.investigation.where.locate import Location, locate
from identifiability.joint.effects import EFFECTS, Effect
from identifiability.joint.model import KBI, Model
from identifiability.measurement.filtering import Lowpass
from identifiability.measurement.trials import Trial
from identifiability.progress import Progress, silent
from identifiability.provenance import fingerprint

_MOVING = (
    "the joint already moves before the first onset, as K, B and I say it should: the noise is not"
    " known from there"
)

_LESS = 0.01  # of what a model leaves, by which another optimum of it has to be better
_DECISIVE = 5.0  # nats by which what was found has to be likelier otherwise, to begin anew
_OTHERWISE = (
    "the torque is taken to be {} between its samples: with what was found missing that is likelier"
)

# Linear algebra of many small matrices: more threads wait for each other, and sum in another order.
_one_thread = threadpool_limits.wrap(limits=1)


class Investigation:
    """Trials of a perturbed joint, and what can be asked of them.

    Every answer depends on its arguments and the trials alone, not on what was asked before.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    held_out : sequence of Trial
        Trials, best of other conditions, that no model is fitted to; chosen by itself if empty.
    model : Model, optional
        The model to start from; ``KBI()`` by default.
    library : mapping of str to type of Effect, optional
        Effects that may be missing; the registry's by default. Add your own:
        ``EFFECTS | {MyEffect.key: MyEffect}``.
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    lowpass_hz : float, "auto" or None
        Zero-phase low-pass [Hz] of both channels where the angle is imposed; "auto" is the usual
        one, or that above which the angle is but noise (`noise_cutoff`).
    torque_between : {"auto", "straight", "smooth"}
        How an imposed torque runs between its samples; "auto": as K, B and I say. Ask
        `otherwise` once it is known what they miss.
    rules : Rules, optional
        Conventions that decisions go by.
    kept : Kept, optional
        Where every fit is kept as soon as it is done; with ``OnDisk(folder)`` the same
        investigation, run again, reads them.
    progress : callable
        Told ``(what, done, total)``.

    Attributes
    ----------
    bench : Workbench
    remarks : tuple of str
        What the trials did not allow.

    Examples
    --------
    >>> from identifiability import EFFECTS, KBI, Investigation, describe, example_trials
    >>> few = {key: EFFECTS[key] for key in ("series_tendon", "cubic_stiffness")}
    >>> study = Investigation(example_trials(), library=few)
    >>> describe(study.locate(study.fit(KBI())))[0]
    'The residual exceeds the noise in 40 of 40 bins of time, most from 30 to 40 ms after the ...
    >>> study.claim(study.weigh()).sets
    (('series_tendon',),)
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        held_out: Sequence[Trial] = (),
        *,
        model: Model | None = None,
        library: Mapping[str, type[Effect]] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        lowpass_hz: Lowpass = "auto",
        torque_between: Between = "auto",
        rules: Rules | None = None,
        kept: Kept | None = None,
        progress: Progress = silent,
    ) -> None:
        self.model = KBI() if model is None else model
        self.library = dict(EFFECTS if library is None else library)
        self.progress = progress
        split = gather(
            trials, held_out, lowpass_hz=lowpass_hz, torque_between=torque_between, rules=rules
        )
        self.bench = Workbench(split, dict(bounds or {}), InMemory() if kept is None else kept)
        self._recorded = tuple(trials), tuple(held_out), lowpass_hz
        self._evaluators: dict[int, Evaluator] = {}
        self._weighed: dict[tuple[int, int], Probabilities] = {}
        self.remarks: tuple[str, ...] = ()
        if leads_are_motion(self.bench):
            self.bench, self.remarks = without_leads(self.bench), (_MOVING,)

    @property
    def split(self) -> Split:
        """Trials that models are fitted to, and those they are judged on."""
        return self.bench.split

    @property
    def torque_between(self) -> Literal["straight", "smooth"]:
        """How an imposed torque is taken to run between its samples."""
        return self.split.fitted[0].treatment.torque_between

    @cached_property
    def baseline(self) -> Candidate:
        """The model to start from, fitted."""
        return self.fit(self.model)

    def fit(self, model: Model, *, refined: bool = False) -> Candidate:
        """Fit a model to the trials that are not held out.

        Parameters
        ----------
        model : Model
        refined : bool
            Whether parameters that refine an effect are free too.
        """
        return fit_baseline(self.bench, model, refined=refined)

    def compare(self, candidate: Candidate) -> Comparison:
        """How well a model fits, and whether its K, B and I are constants."""
        return compare(self.bench, candidate)

    def locate(self, candidate: Candidate) -> Location:
        """Where a model fails: in time, frequency, state, amplitude, direction, trial."""
        return locate(self.bench, candidate)

    def unexplained(self, candidate: Candidate, *, seed: int = 1) -> Unexplained:
        """What a model leaves, as a torque of which nothing is assumed but its family."""
        return unexplained(self.bench, candidate, seed=seed)

    @_one_thread
    def weigh(self, *, most: int | None = None, seed: int = 1) -> Probabilities:
        """Probabilities of the sets of effects that may be missing, "none of these" among them.

        Parameters
        ----------
        most : int, optional
            Most effects to add; the rules' number by default.
        seed : int
            Of the probes by which noise of an imposed angle is taken off.

        Raises
        ------
        InputError
            Where the trials' rates are no multiples of the lowest.
        """
        number = self.bench.rules.most_effects if most is None else most
        if (number, seed) not in self._weighed:
            kept = evaluations_of(self, seed)
            self._weighed[number, seed] = weigh(
                kept.evaluator,
                self.baseline,
                self.library,
                number,
                self.progress,
                kept,
                self.bench.rules,
            )
        return self._weighed[number, seed]

    @_one_thread
    def weigh_nested(self, posterior: Probabilities, *, seed: int = 1) -> Probabilities:
        """Weigh the sets that came near again, without the held-out trials.

        Parameters
        ----------
        posterior : Probabilities
            By all trials.
        seed : int
            See `weigh`.
        """
        split = self.split
        band = self._evaluator(seed).band.without(split.held_out_rule, split.held_out_numbers)
        evaluator = evaluator_of(band, self.baseline.values, seed=seed)
        kept = self._evaluations(evaluator, seed, "without what is held out")
        return weigh_nested(
            kept, self.baseline, self.library, posterior, self.bench.rules, self.progress
        )

    @_one_thread
    def otherwise(self, posterior: Probabilities, *, seed: int = 1) -> Investigation | None:
        """The same trials with their torque otherwise between its samples, if that is likelier.

        By the most probable model: K, B and I alone cannot tell where they miss something.

        Parameters
        ----------
        posterior : Probabilities
            Of these trials as they are.
        seed : int
            See `weigh`.

        Returns
        -------
        Investigation or None
            None where it is not, or where the angle was imposed.
        """
        trials, held_out, lowpass_hz = self._recorded
        if trials[0].driven == "angle":
            return None
        other = Investigation(
            trials,
            held_out,
            model=self.model,
            library=self.library,
            bounds=self.bench.bounds,
            lowpass_hz=lowpass_hz,
            torque_between="straight" if self.torque_between == "smooth" else "smooth",
            rules=self.bench.rules,
            kept=self.bench.kept,
            progress=self.progress,
        )
        self.progress("weighing the torque between its samples", 0, 1)
        best = posterior.best
        one = posterior.sets[best].candidate
        own, others = (
            np.concatenate(
                study.bench.residual(
                    one.model, one.values, study.split.fitted, one.refined, one.scheme
                ).by_trial
            )
            for study in (self, other)
        )
        if (others - own) @ (others - own) < MATTERS**2 * (own @ own):
            return None
        # An effect may have done what the torque's form would: such as a low-pass filter.
        without = (tuple(k for k in best if k != key) for key in best)
        sets = {keys: posterior.sets[keys] for keys in (best, *without) if keys in posterior.sets}
        every = len(self.library) + 1
        gained = [-np.inf]
        for keys, known in sets.items():
            one = known.candidate
            with suppress(InputError, ArithmeticError, np.linalg.LinAlgError):
                found = other._evaluator(seed).evaluate(
                    one.model, [one.values], refined=one.refined, scheme=one.scheme
                )
                gained.append(found.log_evidence + log_prior(len(keys), every))
        least = posterior.sets[best].log_evidence + log_prior(len(best), every)
        if not max(gained) > least + _DECISIVE:
            return None
        other.remarks = (*other.remarks, _OTHERWISE.format(other.torque_between))
        return other

    def likeliest(self, *, most: int | None = None, seed: int = 1) -> Investigation:
        """The trials with their torque between its samples as it is likelier by what they miss.

        Parameters
        ----------
        most, seed
            See `weigh`, which then knows its answer, unless the other form is to be weighed.
        """
        return self.otherwise(self.weigh(most=most, seed=seed), seed=seed) or self

    def _evaluations(self, evaluator: Evaluator, seed: int, part: str) -> Evaluations:
        """What evaluates models, and keeps them where every fit is kept."""
        folder = self.bench.kept.folder if isinstance(self.bench.kept, OnDisk) else None
        how = self._recorded[2], self.torque_between
        known = self.bench.identity, self.baseline.values, *how, seed, part
        return Evaluations(evaluator, folder, fingerprint(*known))

    def _evaluator(self, seed: int) -> Evaluator:
        """What weighs models of these trials, made once."""
        if seed not in self._evaluators:
            trials, held_out, lowpass_hz = self._recorded
            band = band_of(
                trials,
                held_out,
                lowpass_hz=lowpass_hz,
                torque_between=self.torque_between,
                bounds=self.bench.bounds,
            )
            self._evaluators[seed] = evaluator_of(band, self.baseline.values, seed=seed)
        return self._evaluators[seed]

    def widths(self, candidate: Candidate, *, seed: int = 1) -> Widths:
        """Every width of a fitted model's parameters, as of K, B and I."""
        return parameter_widths(self.bench, candidate, seed=seed)

    @_one_thread
    def smallest_seen(self, candidate: Candidate, *, seed: int = 1) -> tuple[Detectable, ...]:
        """Smallest effects that would have been seen beside a fitted model.

        Parameters
        ----------
        candidate : Candidate
        seed : int
            Of draws of the noise, and of the probes by which that of an imposed angle is taken off.
        """
        evaluator = self._evaluator(seed)
        without = evaluator.evaluate(
            candidate.model, [candidate.values], refined=candidate.refined, scheme=candidate.scheme
        )
        return detectable(
            evaluator,
            without,
            self.library,
            self.bench.rules,
            seed=seed,
            progress=self.progress,
        )

    def claim(self, posterior: Probabilities) -> Claim:
        """What the probabilities allow to name."""
        rules = self.bench.rules
        return claim_of(posterior, self.library, rules.claimed, rules.most_noise)

    def climb(self, posterior: Probabilities, *, also: Mapping[str, float] | None = None) -> Found:
        """Fit the model that is claimed, or comes nearest, effect by effect: the error ladder.

        Parameters
        ----------
        posterior : Probabilities
        also : mapping of str to float, optional
            Values that the fit of the final model starts from as well: see `lower`.
        """
        claim = self.claim(posterior)
        return found_of(
            self.bench,
            self.baseline,
            posterior,
            claim,
            self.library,
            also=also,
            progress=self.progress,
        )

    def lower(self, candidate: Candidate, widths: Widths) -> dict[str, float] | None:
        """Values of a fitted model by which it leaves less, if its widths met any.

        Parameters
        ----------
        candidate : Candidate
        widths : Widths
            Of its parameters: their profiles may lead to another optimum than the fit did.
        """
        values = {**candidate.values, **{row.name: row.optimum for row in widths.rows}}
        fitted = self.split.fitted
        left = self.bench.residual(
            candidate.model, values, fitted, candidate.refined, candidate.scheme
        )
        less = left.weighted < (1 - _LESS) * candidate.fitted.weighted
        return values if less else None

    def judge(
        self,
        posterior: Probabilities,
        found: Found,
        rest: Unexplained,
        smallest_seen: Sequence[Detectable] = (),
        nested: Probabilities | None = None,
    ) -> Verdict:
        """What the probabilities, the error ladder and an account of what is left allow to say.

        And, where something is claimed, what the trials that are not held out say alone: `nested`.
        """
        claim = self.claim(posterior)
        return judge(self.split, posterior, claim, found, rest, smallest_seen, self.library, nested)

    def next_experiment(
        self,
        found: Found,
        verdict: Verdict,
        *,
        limits: Limits | None = None,
        seed: int = 1,
    ) -> NextExperiment | None:
        """Perturbation that would tell apart what these data cannot; ``None`` if none is open."""
        pair = open_pair(found, verdict)
        if pair is None:
            return None
        return next_experiment(self.bench, found.final, *pair, limits=limits, seed=seed)


def evaluations_of(study: Investigation, seed: int) -> Evaluations:
    """What weighs models of all trials of a study, each once where fits are kept."""
    return study._evaluations(study._evaluator(seed), seed, "all")
