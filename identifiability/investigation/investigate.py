"""The whole way from trials to a verdict, and each step of it for use by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.errors import InputError
from identifiability.inference.problem import Prior, Problem
from identifiability.inference.recordings import first_guess, integrated_autocorrelation
from identifiability.inference.widths import Widths, widths
from identifiability.investigation.fits.bench import Workbench, owners
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.kept import KeepingWorkbench
from identifiability.investigation.next_experiment import Limits, NextExperiment, next_experiment
from identifiability.investigation.search.fitter import baseline
from identifiability.investigation.search.search import MOST_EFFECTS, Ranking, Search, Searcher
from identifiability.investigation.search.smallest_seen import Detectable, detectable
from identifiability.investigation.split import Split, gather
from identifiability.investigation.unexplained.account import Unexplained, unexplained
from identifiability.investigation.verdict.judge import Verdict, judge
from identifiability.investigation.where.compare import Comparison, compare
from identifiability.investigation.where.locate import Location, locate
from identifiability.joint.effects import EFFECTS, Effect
from identifiability.joint.model import KBI, Model
from identifiability.joint.scheme import Scheme
from identifiability.measurement.filtering import Lowpass
from identifiability.measurement.trials import Trial

_MOVING = (
    "the joint already moves before the first onset, as K, B and I say it should: the noise is not"
    " known from there"
)

Progress = Callable[[str, int, int], None]
T = TypeVar("T")


def _silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What an investigation found.

    Attributes
    ----------
    split : Split
    search : Search
    comparison, location : Comparison, Location
        Of the baseline model.
    unexplained_before, unexplained_after : Unexplained
        Library-free account of what the baseline and the final model leave.
    widths : Widths or None
        Of the final model's parameters; ``None`` where they were not asked for, or failed.
    verdict : Verdict
    next_experiment : NextExperiment or None
    warnings : tuple of str
        What could not be done, and why.
    seed : int
    """

    split: Split
    search: Search
    comparison: Comparison | None
    location: Location | None
    unexplained_before: Unexplained | None
    unexplained_after: Unexplained
    widths: Widths | None
    verdict: Verdict
    next_experiment: NextExperiment | None
    warnings: tuple[str, ...]
    seed: int


class Investigation:
    """Trials of a perturbed joint, and what can be asked of them.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    held_out : sequence of Trial
        Trials, best of other conditions, that no model is fitted to; chosen by itself if empty.
    library : mapping of str to type of Effect, optional
        Effects that may be missing; the registry's by default. Add your own:
        ``EFFECTS | {MyEffect.key: MyEffect}``.
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    lowpass_hz : float, "auto" or None
        Zero-phase low-pass [Hz] of both channels where the angle is imposed; "auto" is the usual
        one, or that above which the angle is but noise (`noise_cutoff`).
    kept : Path, optional
        Folder in which every fit is kept as soon as it is done; the same investigation, run again,
        reads them (see `KeepingWorkbench`).
    progress : callable
        Told ``(what, done, total)``.

    Attributes
    ----------
    bench : Workbench
    warnings : tuple of str
        What the trials did not allow.

    Examples
    --------
    >>> study = Investigation(trials)                    # doctest: +SKIP
    >>> kbi = study.fit(KBI())                           # doctest: +SKIP
    >>> study.locate(kbi).sentences                      # doctest: +SKIP
    >>> study.rank(kbi).chosen                           # doctest: +SKIP
    'stretch_reflex'
    >>> better = study.fit(KBI() + StretchReflex())      # doctest: +SKIP
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        held_out: Sequence[Trial] = (),
        *,
        library: Mapping[str, type[Effect]] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        lowpass_hz: Lowpass = "auto",
        kept: Path | None = None,
        progress: Progress = _silent,
    ) -> None:
        self.library = dict(EFFECTS if library is None else library)
        split = gather(trials, held_out, lowpass_hz=lowpass_hz)
        others = dict(bounds or {})
        self.bench = (
            Workbench(split, others)
            if kept is None
            else KeepingWorkbench(split, others, folder=kept)
        )
        self.warnings: tuple[str, ...] = ()
        if self.split.has_noise and self.split.moves_early and self._leads_are_motion():
            self.bench = replace(self.bench, split=self.split.without_leads())
            self.warnings = (_MOVING,)
        self._searcher = Searcher(self.bench, self.library, progress)

    @property
    def split(self) -> Split:
        """Trials that models are fitted to, and those they are judged on."""
        return self.bench.split

    def _leads_are_motion(self) -> bool:
        """Whether K, B and I explain most of what precedes the onsets: then it is not noise."""
        kbi = self.fit(KBI())
        leads = [(r, slice(r.lead.n_samples)) for r in self.split.fitted]
        left = sum(
            float(np.sum(e[s] ** 2)) for e, (_, s) in zip(kbi.fitted.by_trial, leads, strict=True)
        )
        return left < 0.5 * sum(float(np.sum(r.compared[s] ** 2)) for r, s in leads)

    def fit(self, model: Model, *, refined: bool = False) -> Candidate:
        """Fit a model to the trials that are not held out.

        Parameters
        ----------
        model : Model
        refined : bool
            Whether parameters that refine an effect are free too.
        """
        kinds = {"K": self.bench.bounds.get("K"), "B": None, "I": self.bench.bounds.get("I")}
        prior = Prior.physical(KBI(), **{k: b for k, b in kinds.items() if b is not None})
        guess = first_guess([r.trial for r in self.split.fitted], prior)
        start = dict(zip(("K", "B", "I"), map(float, guess), strict=True))
        found = baseline(self.bench, model, start, refined=model.effect_keys if refined else ())
        if found.failure:
            raise InputError(f"{model!r} could not be fitted: {found.failure}")
        return found

    def compare(self, candidate: Candidate) -> Comparison:
        """How well a model fits, and whether its K, B and I are constants."""
        return compare(self.bench, candidate)

    def locate(self, candidate: Candidate) -> Location:
        """Where a model fails: in time, frequency, state, amplitude, direction, trial."""
        return locate(self.bench, candidate)

    def unexplained(self, candidate: Candidate, *, seed: int = 1) -> Unexplained:
        """What a model leaves, as a torque of which nothing is assumed but its family."""
        return unexplained(self.bench, candidate, seed=seed)

    def rank(self, candidate: Candidate) -> Ranking:
        """Add every effect of the library to a model, refit, and rank."""
        return self._searcher.rank(candidate)

    def search(self, candidate: Candidate, *, most: int = MOST_EFFECTS) -> Search:
        """Add, drop and swap effects for as long as the evidence is decisive."""
        return self._searcher.run(candidate, most)

    def widths(self, candidate: Candidate, *, seed: int = 1) -> Widths:
        """Every width of a fitted model's parameters, as of K, B and I.

        The noise is the residual's, with its variance times its autocorrelation time.
        """
        problem = self.bench.problem(
            candidate.model, self.split.fitted, refined=candidate.refined, scheme=candidate.scheme
        )
        noises = [
            float(np.sqrt(np.mean(left**2) * integrated_autocorrelation(left)))
            for left in candidate.fitted.by_trial
        ]
        sharpened = self.split.weights_sd(self.split.fitted) / np.maximum(noises, 1e-300)
        observations = [
            replace(o, scale=o.scale * sharpened[i])
            for o, i in zip(problem.observations, owners(problem.observations), strict=True)
        ]
        sharper = replace(problem, observations=observations, exact_hessian=False)
        start = candidate.model.vector(candidate.values)[list(problem.free)]
        sharper = sharper.with_scheme(_scheme_about(sharper, start))
        return widths(sharper, starts=start[None], seed=seed, referee=False, quick=True)

    def smallest_seen(self, candidate: Candidate) -> tuple[Detectable, ...]:
        """Smallest effects that would have been seen beside a fitted model."""
        return detectable(self.bench, candidate, self.library)

    def next_experiment(
        self,
        search: Search,
        verdict: Verdict,
        *,
        limits: Limits | None = None,
        seed: int = 1,
    ) -> NextExperiment | None:
        """Perturbation that would tell apart what these data cannot; ``None`` if none is open."""
        if search.description is not None:
            rival = search.description.candidate
            replaced = " and ".join(search.replaced_by(search.description))
            pair = (replaced, search.description.key)
            return next_experiment(self.bench, search.final, rival, pair, limits=limits, seed=seed)
        for chosen, members in zip(search.alternatives, verdict.equivalence_sets, strict=False):
            for ranked in search.alternatives[chosen]:
                if ranked.key in members and ranked.key not in self.library[chosen].equivalent:
                    pair = (chosen, ranked.key)
                    return next_experiment(
                        self.bench, search.final, ranked.candidate, pair, limits=limits, seed=seed
                    )
        return None


def investigate(
    trials: Sequence[Trial],
    held_out: Sequence[Trial] = (),
    *,
    model: Model | None = None,
    library: Mapping[str, type[Effect]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    lowpass_hz: Lowpass = "auto",
    limits: Limits | None = None,
    most: int = MOST_EFFECTS,
    with_widths: bool = True,
    seed: int = 1,
    kept: Path | None = None,
    progress: Progress = _silent,
) -> Findings:
    """Find out what a joint model misses in recorded trials.

    Parameters
    ----------
    trials, held_out, library, bounds, lowpass_hz, kept, progress
        See `Investigation`.
    model : Model, optional
        The model to start from; ``KBI()`` by default.
    limits : Limits, optional
        Of the next experiment; those that the trials kept by default.
    most : int
        Most effects to add.
    with_widths : bool
        Whether to compute the widths of the final model's parameters.
    seed : int

    Returns
    -------
    Findings

    Raises
    ------
    InputError
        Where the trials cannot be investigated.
    """
    study = Investigation(
        trials,
        held_out,
        library=library,
        bounds=bounds,
        lowpass_hz=lowpass_hz,
        kept=kept,
        progress=progress,
    )
    warnings = list(study.warnings)

    def attempt(what: str, work: Callable[[], T]) -> T | None:
        # One part that fails must not take the others with it; the report says that it failed.
        try:
            return work()
        except (InputError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            warnings.append(f"{what}: {error}")
            return None

    # What needs much Python runs beside the compiler and its programs. One thread for the linear
    # algebra of small matrices: then the order of its sums does not depend on what runs beside.
    with threadpool_limits(1), ThreadPoolExecutor(1) as aside:
        progress("fitting the baseline", 0, 1)
        first = study.fit(KBI() if model is None else model)
        progress("comparing", 0, 1)
        comparison = attempt("comparison", lambda: study.compare(first))
        location = attempt("location", lambda: study.locate(first))
        unexplained_before = aside.submit(
            attempt, "unexplained torque", lambda: study.unexplained(first, seed=seed)
        )
        search = study.search(first, most=most)
        final = search.final
        found_widths = None
        if with_widths:
            progress("widths of the parameters", 0, 1)
            found_widths = aside.submit(attempt, "widths", lambda: study.widths(final, seed=seed))
        progress("what is left", 0, 1)
        before = unexplained_before.result()
        after = before if final is first else None
        if after is None:
            after = study.unexplained(final, seed=seed)
        seen: tuple[Detectable, ...] = ()
        if not final.keys or final is first:
            progress("the smallest effects that would have been seen", 0, 1)
            seen = attempt("power", lambda: study.smallest_seen(final)) or ()
        verdict = judge(study.split, search, after, seen, study.library)
        progress("the next experiment", 0, 1)
        following = attempt(
            "next experiment",
            lambda: study.next_experiment(search, verdict, limits=limits, seed=seed),
        )
        found = None if found_widths is None else found_widths.result()
    return Findings(
        study.split,
        search,
        comparison,
        location,
        before,
        after,
        found,
        verdict,
        following,
        tuple(sorted(warnings)),
        seed,
    )


def _scheme_about(problem: Problem, optimum: np.ndarray) -> Scheme:
    """The finest scheme that parameters within three standard errors of the optimum ask for."""
    if problem.integration.exact:
        return problem.integration
    jacobian = problem.jacobian(optimum)
    reach = 3 * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    scheme = problem.integration
    for sign in (-1, 1):
        for move in np.diag(sign * reach):
            place = np.clip(optimum + move, problem.lower, problem.upper)
            asked = problem.suited(problem.complete(place))
            scheme = asked if asked.is_finer_than(scheme) else scheme
    return scheme
