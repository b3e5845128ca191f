"""The search for missing effects: add, refine, drop, swap, each time refitted and held to a gate.

Evidence for a larger model is the logarithm of the ratio of the weighted residuals, times the
number of samples that count as independent, less a penalty for its parameters: the Bayesian
information criterion of Schwarz 1978 (Ann Stat 6: 461-464) with an unknown scale of the noise.
Trials that were held out add twice their gain in log likelihood, with no penalty: an effect may
show only in the condition that was not fitted. The residual of a model that is not exact is
correlated, so it counts for few samples; at the noise floor nearly all count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from identifiability.investigation.candidates import (
    Candidate,
    Workbench,
    difference,
    effective_samples,
    starting_values,
)
from identifiability.investigation.evidence import DISCREPANCY
from identifiability.joint.effects import (
    EFFECTS,
    Effect,
    LooseCoupling,
    RelaxationSpectrum,
    StiffeningHysteresis,
)
from identifiability.joint.model import KBI, Model

DECISIVE = 10.0
"""Difference of the information criterion that counts as decisive (Kass & Raftery 1995: more than
10 is very strong evidence)."""
MOST_EFFECTS = 3
_WORKERS = 2
_WITHIN_REACH = 0.5  # share of the best gain at which a candidate is worth refining or swapping
_MOST_REFINED, _MOST_SWAPS = 3, 4
_SHARE, _SHARE_UNKNOWN_NOISE = 1 / 3, 0.1
"""Share of the remaining misfit that an effect must remove, and the same where the noise is not
known: conventions."""
_NEAR_FLOOR = 1.5
FORM = 0.01
"""Share of a misfit that equations right to a tenth of their torque may leave: its square.
A further effect that removes less than this share of what those before it removed may only mend
their equations, and a rival that removes all but this share is not excluded by it."""
ONLY_MENDS = "may only mend the equations of the effects before it"
_CONTENDS = 0.1  # share of what an effect removes, that a rival worth refining may leave
_SCREENED = 6  # effects that are fitted at every step after the first
# Share of the best gain at a glance, and least number, to be finished: at first, and later on,
# when models take longer.
_WORTH, _LEAST_FINISHED = 0.3, 4
_WORTH_LATER, _LEAST_LATER = 0.5, 2

Progress = Callable[[str, int, int], None]


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
        Evidence with the held-out trials fitted too, where only these speak against a rival: they
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


@dataclass(frozen=True, eq=False)
class Step:
    """One effect added.

    Attributes
    ----------
    before : Candidate
    ranking : tuple of Ranked
        All candidates, best first.
    chosen : str
        Effect that was added, empty where none was admitted.
    screened_out : tuple of str
        Effects that were not fitted at this step, because their signature is not in the residual.
    """

    before: Candidate
    ranking: tuple[Ranked, ...]
    chosen: str
    screened_out: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Search:
    """What the search did.

    Attributes
    ----------
    baseline : Candidate
    steps : tuple of Step
        The last one admitted nothing, unless the search ended for another reason.
    final : Candidate
    ladder : tuple of (str, Candidate)
        The final model's effects one by one, each with the model up to it: at every rung the
        effect that lowers the error most.
    alternatives : dict of str to tuple of Ranked
        For each effect of the final model, what could stand in its place, best first; evidence is
        against the final model.
    without : dict of str to Candidate
        For each effect of the final model, the model without it.
    descriptions : tuple of Ranked
        Descriptions that name no one mechanism, in the place of effects of the final model that may
        be no more than that; one that passes stands for them. Evidence is against the final model.
    exact : bool
        Whether the final model leaves no more than noise.
    n_fits : int
        Number of models that were fitted.
    ended : str
        Why the search ended.
    """

    baseline: Candidate
    steps: tuple[Step, ...]
    final: Candidate
    ladder: tuple[tuple[str, Candidate], ...]
    alternatives: dict[str, tuple[Ranked, ...]]
    without: dict[str, Candidate]
    descriptions: tuple[Ranked, ...]
    exact: bool
    n_fits: int
    ended: str

    @property
    def description(self) -> Ranked | None:
        """The description that stands for effects of the final model best, if one does."""
        passing = [r for r in self.descriptions if r.passes]
        return max(passing, key=lambda r: r.evidence, default=None)

    def replaced_by(self, description: Ranked) -> tuple[str, ...]:
        """Effects of the final model in whose place a description was fitted."""
        return tuple(key for key in self.alternatives if key not in description.candidate.keys)


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
    """Evidence of the fitted trials, and of the held-out ones."""
    return evidence_for(larger, smaller, best) + predictive_evidence(larger, smaller)


@dataclass(eq=False)
class Searcher:
    """Runs the search over one body of evidence.

    Attributes
    ----------
    bench : Workbench
    library : dict of str to type of Effect
        Effects to be tried.
    progress : callable
        Told ``(what, done, total)``.
    """

    bench: Workbench
    library: dict[str, type[Effect]] = field(default_factory=lambda: dict(EFFECTS))
    progress: Progress = lambda what, done, total: None
    known: dict[tuple[tuple[str, ...], tuple[str, ...]], Candidate] = field(default_factory=dict)
    refits: dict[tuple[tuple[str, ...], tuple[str, ...]], Candidate] = field(
        default_factory=dict, init=False
    )
    baseline: Candidate | None = field(default=None, init=False)

    def run(self, baseline: Candidate, most: int = MOST_EFFECTS) -> Search:
        """Search from a fitted model.

        Parameters
        ----------
        baseline : Candidate
        most : int
            Most effects to add.
        """
        current, steps, ended = baseline, [], f"{most} effects were added"
        self.baseline = baseline
        while len(current.keys) < len(baseline.keys) + most:
            step = self.rank(current)
            steps.append(step)
            if not step.chosen:
                ended = "no further effect was admitted"
                break
            current = next(r.candidate for r in step.ranking if r.key == step.chosen)
            current = self._improve(current, baseline, step)
            if self.at_floor(current):
                ended = self._reached
                break
        current = self._simplify(self._prune(current, baseline), baseline)
        exact = self._leaves_noise(current)
        ladder = self._ladder(current, baseline)
        added = [key for key, _ in ladder]
        alternatives = self._alternatives(current, baseline, added, steps)
        without = {
            key: self.fit(current.model.without(key), baseline, refined=current.refined)
            if len(added) > 1
            else baseline
            for key in added
        }
        return Search(
            baseline,
            tuple(steps),
            current,
            ladder,
            alternatives,
            without,
            self._descriptions(current, baseline, exact),
            exact,
            len(self.known),
            ended,
        )

    def at_floor(self, candidate: Candidate) -> bool:
        """Whether a model leaves no more than the noise does, or an error of measurement may."""
        floor = self.bench.evidence.noise_floor()
        if floor is None:
            return candidate.fitted.error <= DISCREPANCY
        slack = 2 * self.bench.evidence.floor_uncertainty()
        return candidate.fitted.error <= floor * (1 + min(slack, 0.3))

    @property
    def _reached(self) -> str:
        if self.bench.evidence.has_noise:
            return "the error reached the noise floor"
        return (
            f"the noise is not known, and an error below {DISCREPANCY:g} may be one of measurement"
        )

    def rank(self, current: Candidate) -> Step:
        """Add every effect of the library to a model, refit, and rank."""
        keys = [key for key in self.library if key not in current.keys]
        kept = self._screen(keys, current)
        jobs = [(current.model + self.library[key](), key) for key in kept]
        fitted = self._fit_all(f"adding to {_named(current)}", jobs, current)
        ranking = self._refine(self._ranked(fitted, current), current)
        chosen = self._choose([r for r in ranking if r.passes])
        return Step(current, tuple(ranking), chosen, tuple(k for k in keys if k not in kept))

    def _choose(self, admitted: Sequence[Ranked]) -> str:
        """Effect to add: the best, or the plainest where the noise is unknown and many do."""
        admitted = [r for r in admitted if not r.doubt] or admitted
        if not self.bench.evidence.has_noise:
            enough = [r for r in admitted if self.at_floor(r.candidate)]
            admitted = sorted(enough, key=lambda r: len(r.candidate.free)) or admitted
        return admitted[0].key if admitted else ""

    def _screen(self, keys: Sequence[str], current: Candidate) -> list[str]:
        """Effects worth a refit: all at the first step, later those whose signature is there.

        The signature is the change of KBI's response by a small effect, at the shapes that a fit
        would start from and at the one it had alone; of it and of the residual only the part
        counts that the model's own parameters cannot absorb.
        """
        if not current.keys or len(keys) <= _SCREENED:
            return list(keys)
        fitted = self.bench.evidence.fitted
        problem = self.bench.problem(current.model, fitted, refined=current.refined)
        theta = current.model.vector(current.values)[list(problem.free)]
        basis, _ = np.linalg.qr(problem.jacobian(theta))
        left = _outside(basis, problem.residuals(theta))
        joint = {name: current.values[name] for name in ("K", "B", "I")}
        plain = self.bench.problem(KBI(), fitted).residuals(np.array(list(joint.values())))
        scores = {}
        for key in keys:
            model = KBI() + self.library[key]()
            alone = self.bench.problem(model, fitted)
            shapes = starting_values(model, joint)
            known = self.known.get((model.effect_keys, ()))
            if known is not None and not known.failure:
                shapes.append({**known.values, **joint})
            best = 0.0
            for shape in shapes:
                change = alone.residuals(model.vector(shape)[list(alone.free)]) - plain
                signature = _outside(basis, change)
                size = float(signature @ signature)
                if np.isfinite(size) and size > 0:
                    best = max(best, float(signature @ left) ** 2 / size)
            scores[key] = best
        ranked = sorted(keys, key=lambda key: -scores[key])
        return [key for key in keys if key in ranked[:_SCREENED]]

    def _fit_all(
        self, what: str, jobs: Sequence[tuple[Model, str]], current: Candidate
    ) -> list[tuple[str, Candidate]]:
        """A glance at every model, then the end of those that are worth it."""
        glanced = self._map(
            f"{what}: a glance",
            jobs,
            lambda model: self.fit(model, current, refined=current.refined, thorough=False),
        )
        gains = [
            np.log(current.fitted.weighted / c.fitted.weighted) if not c.failure else -np.inf
            for _, c in glanced
        ]
        best = max(gains, default=0.0)
        order = np.argsort(gains)[::-1]
        share, least = (_WORTH_LATER, _LEAST_LATER) if current.keys else (_WORTH, _LEAST_FINISHED)
        enough = {int(i) for i in order[:least]}
        worth = {i for i, gain in enumerate(gains) if gain > share * best} | enough
        todo = [(c.model, key) for i, (key, c) in enumerate(glanced) if i in worth]
        finished = dict(
            self._map(
                f"{what}: fitting",
                todo,
                lambda model: self.fit(model, current, refined=current.refined),
            )
        )
        return [(key, finished.get(key, c)) for key, c in glanced]

    def _map(
        self, what: str, jobs: Sequence[tuple[Model, str]], work: Callable[[Model], Candidate]
    ) -> list[tuple[str, Candidate]]:
        done = 0

        def one(job: tuple[Model, str]) -> tuple[str, Candidate]:
            nonlocal done
            found = work(job[0])
            done += 1
            self.progress(f"{what} {job[1]}", done, len(jobs))
            return job[1], found

        with ThreadPoolExecutor(_WORKERS) as pool:
            return list(pool.map(one, jobs))

    def fit(
        self,
        model: Model,
        near: Candidate,
        *,
        refined: Sequence[str] = (),
        thorough: bool = True,
    ) -> Candidate:
        """Fit a model from starts about a fitted one; each model is fitted once."""
        refined = tuple(sorted(key for key in refined if key in model.effect_keys))
        known = self.known.get((model.effect_keys, refined))
        if known is not None:
            found = self.bench.finish(known) if thorough else known
        else:
            starts = self._starts(model, near, refined)
            found = self.bench.fit(model, starts, refined=refined, thorough=thorough)
        self.known[model.effect_keys, refined] = found
        return found

    def _starts(
        self, model: Model, near: Candidate, refined: tuple[str, ...]
    ) -> list[dict[str, float]]:
        names = model.parameter_names
        shared = {name: value for name, value in near.values.items() if name in names}
        if len(shared) == len(names) and set(refined) != set(near.refined):
            return _refinements(model, near)
        if not near.keys:
            return starting_values(model, shared, most=6)
        starts = starting_values(model, shared, most=2)
        alone = self._alone([key for key in model.effect_keys if key not in near.keys])
        if alone:
            # A shape that served once is a better start than the nominal one.
            starts[:1] = starting_values(model, shared | alone, most=1)
        # With a second effect the first one may have to take another shape.
        plain = {n: shared[n] for n in ("K", "B", "I")}
        return starts + starting_values(model, plain, most=1)

    def _alone(self, keys: Sequence[str]) -> dict[str, float]:
        """Shapes that effects had when each was added to the baseline alone."""
        base = () if self.baseline is None else self.baseline.keys
        return {
            name: value
            for key in keys
            if (found := self._fitted_alone(key, base)) is not None
            for name, value in found.values.items()
            if name.startswith(f"{key}.") and found.model.parameters[name].null is None
        }

    def _fitted_alone(self, key: str, base: Sequence[str]) -> Candidate | None:
        """Plain fit of one effect added to the baseline's, if there was one."""
        found = self.known.get((tuple(sorted((*base, key))), ()))
        return None if found is None or found.failure else found

    def _ranked(self, fitted: Iterable[tuple[str, Candidate]], current: Candidate) -> list[Ranked]:
        fitted = list(fitted)
        best = _least([current, *(c for _, c in fitted)])
        out = [self._judge(key, c, current, best) for key, c in fitted]
        return sorted(out, key=lambda r: -r.evidence)

    def _judge(self, key: str, candidate: Candidate, current: Candidate, best: Candidate) -> Ranked:
        if candidate.failure:
            return Ranked(key, candidate, -np.inf, -np.inf, False, candidate.failure)
        gain = total_evidence(candidate, current, best)
        held = held_out_gain(candidate, current)
        objection = self.bench.objection(candidate)
        reason = objection
        if gain < DECISIVE:
            reason = "no decisive evidence"
        elif not self._held_out_agrees(candidate, current, held):
            reason = "the held-out trials do not agree"
        elif not self._matters(candidate, current):
            reason = "removes too little of what is left"
        elif self._only_mends(candidate, current):
            reason = ONLY_MENDS
        doubt = self.bench.doubt(candidate, key)
        return Ranked(key, candidate, gain, held, not reason, reason, objection, doubt)

    def _held_out_agrees(self, candidate: Candidate, current: Candidate, held: float) -> bool:
        if not self.bench.evidence.held_out:
            return True
        fit_gain = np.log(current.fitted.weighted / candidate.fitted.weighted)
        # A quarter of the gain, less what chance may take away from it.
        moved = difference(current.held_out, candidate.held_out)
        samples = effective_samples(candidate.held_out, moved)
        chance = 2 * np.sqrt(max(fit_gain, 0.0) / samples)
        return bool(held > 0.25 * fit_gain - chance and held > 0)

    def _only_mends(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether a further effect removes no more than inexact equations may leave.

        It is believed all the same where nothing but noise is left with it, and clearly more
        without it: an effect that stands for an error of form seldom fits that well.
        """
        first = self.baseline
        if first is None or not set(first.keys) < set(current.keys) < set(candidate.keys):
            return False
        before, now, after = (pooled_error(c) for c in (first, current, candidate))
        if now - after >= FORM * (before - now):
            return False
        return self._near_noise(current, 2) or not self._leaves_noise(candidate)

    def _leaves_noise(self, candidate: Candidate) -> bool:
        return self.at_floor(candidate) and self._near_noise(candidate)

    def _near_noise(self, candidate: Candidate, margins: float = 1) -> bool:
        """Whether the pooled error is within so many margins of the noise floor's uncertainty."""
        evidence = self.bench.evidence
        floor = evidence.noise_floor((*evidence.fitted, *evidence.held_out))
        if floor is None:
            return self.at_floor(candidate)
        margin = min(3 * evidence.floor_uncertainty(), 0.3)
        return pooled_error(candidate) <= floor * (1 + margins * margin)

    def _matters(self, candidate: Candidate, current: Candidate) -> bool:
        """Whether an effect removes a fair share of the misfit that the model before left.

        No equation is exact, and with enough data the evidence for mending one with another is
        always decisive. What is left near the noise floor is not judged by its share.
        """
        evidence = self.bench.evidence
        everything = (*evidence.fitted, *evidence.held_out)
        floor = evidence.noise_floor(everything)
        before, after = (pooled_error(c) for c in (current, candidate))
        if floor is None:
            return after < (1 - _SHARE_UNKNOWN_NOISE) * before
        if before < _NEAR_FLOOR * floor:
            return True
        return after - floor < (1 - _SHARE) * (before - floor)

    def _refine(self, ranking: list[Ranked], current: Candidate) -> list[Ranked]:
        """Free the refining parameters of the best candidates; keep them where it pays."""
        # What is not admitted does not set the mark: with many samples a trifle may be evident.
        top = next((r for r in ranking if r.passes), ranking[0]).evidence
        worth = [
            r
            for r in ranking
            # A linear model costs little.
            if r.evidence >= (0.0 if r.candidate.model.linear else max(0.0, _WITHIN_REACH * top))
            and _refinable(r.candidate, r.key)
            # Beside other effects only what its plain form nearly is: refining takes long.
            and (r.passes or r.reason == ONLY_MENDS or not current.keys)
        ][:_MOST_REFINED]
        refined: dict[str, Candidate] = {}
        for r in worth:
            self.progress(f"refining {r.key}", len(refined) + 1, len(worth))
            more = (*r.candidate.refined, r.key)
            refined[r.key] = self._refined(r.candidate, more)
        best = _least([current, *(r.candidate for r in ranking), *refined.values()])
        out = []
        for r in ranking:
            plain = self._judge(r.key, r.candidate, current, best)
            if r.key in refined:
                richer = self._judge(r.key, refined[r.key], current, best)
                if richer.evidence > plain.evidence + DECISIVE and (
                    richer.passes or not plain.passes
                ):
                    plain = richer
            out.append(plain)
        return sorted(out, key=lambda r: -r.evidence)

    def _improve(self, current: Candidate, baseline: Candidate, step: Step) -> Candidate:
        """Swap earlier effects for others now that one more is known."""
        added = [key for key in current.keys if key not in baseline.keys]
        if len(added) < 2:
            return current
        for key in added:
            if key == step.chosen:
                continue
            for other in self._swaps(key, current, baseline):
                if other.passes and not other.doubt and other.evidence > DECISIVE:
                    current = other.candidate
                    break
        return current

    def _swaps(self, key: str, current: Candidate, baseline: Candidate) -> list[Ranked]:
        """Other effects in the place of one, ranked against the model with it."""
        # Others start from the best fit without the effect, not from what is left of this one.
        rest = self.fit(current.model.without(key), baseline, refined=current.refined)
        likely = self._likely(key, current, baseline)
        jobs = [(rest.model + self.library[other](), other) for other in likely]
        near = baseline if rest.failure else rest
        fitted = self._fit_all(f"in the place of {key}", jobs, near)
        # A rival to a refined effect is refined too, or the comparison is not fair; so is one that
        # comes near in its plain form.
        near_to = pooled_error(current)
        near_to += _CONTENDS * (pooled_error(rest) - near_to)
        fitted = [
            (other, self._richer(plain, other))
            if key in current.refined or pooled_error(plain) < near_to
            else (other, plain)
            for other, plain in fitted
        ]
        best = _least([current, *(c for _, c in fitted)])
        out = [self._judge(other, c, current, best) for other, c in fitted]
        return sorted(out, key=lambda r: -r.evidence)

    def _richer(self, plain: Candidate, key: str) -> Candidate:
        if plain.failure or not _refinable(plain, key):
            return plain
        richer = self._refined(plain, (*plain.refined, key))
        return plain if richer.failure else richer

    def _refined(self, plain: Candidate, keys: Sequence[str]) -> Candidate:
        self.fit(plain.model, plain, refined=keys, thorough=False)
        return self.fit(plain.model, plain, refined=keys)

    def _likely(self, key: str, current: Candidate, baseline: Candidate) -> list[str]:
        """Effects that may stand in the place of another: alike by nature, or alike alone."""
        alone = {
            k: c.fitted.weighted
            for k in self.library
            if (c := self._fitted_alone(k, baseline.keys)) is not None
        }
        by_merit = sorted(alone, key=alone.__getitem__)
        order = [*self.library[key].confused_with, *by_merit] if key in self.library else by_merit
        unique = dict.fromkeys(k for k in order if k not in current.keys and k in self.library)
        return list(unique)[:_MOST_SWAPS]

    def _prune(self, current: Candidate, baseline: Candidate) -> Candidate:
        """Drop what the final model does not need."""
        for key in [k for k in current.keys if k not in baseline.keys]:
            if len(current.keys) - len(baseline.keys) < 2:
                break
            smaller = self.fit(current.model.without(key), baseline, refined=current.refined)
            if smaller.failure:
                continue
            if total_evidence(current, smaller, current) < DECISIVE:
                current = smaller
        return current

    def _simplify(self, current: Candidate, baseline: Candidate) -> Candidate:
        """Take the plainer effect, or the first of those of one form, where it does as well."""
        order = list(self.library)
        for key in [k for k in current.keys if k not in baseline.keys and k in self.library]:
            effect = self.library[key]
            for other in (*effect.refines, *effect.equivalent):
                if other not in order or other in current.keys:
                    continue
                if other in effect.equivalent and order.index(other) > order.index(key):
                    continue
                model = current.model.without(key) + self.library[other]()
                found = self.fit(model, current, refined=current.refined)
                plainer = len(found.free) < len(current.free) or other in effect.equivalent
                if found.failure or not plainer:
                    continue
                if total_evidence(current, found, current) < DECISIVE:
                    current = found
                    break
        return current

    def _ladder(self, final: Candidate, baseline: Candidate) -> tuple[tuple[str, Candidate], ...]:
        rungs: list[tuple[str, Candidate]] = []
        left, below = [k for k in final.keys if k not in baseline.keys], baseline
        while left:
            if len(left) == 1:
                rungs.append((left[0], final))
                break
            tried = [
                (
                    key,
                    self.fit(below.model + final.model.effect(key), below, refined=final.refined),
                )
                for key in left
            ]
            key, below = min(tried, key=lambda pair: pooled_error(pair[1]))
            rungs.append((key, below))
            left.remove(key)
        return tuple(rungs)

    def _descriptions(
        self, final: Candidate, baseline: Candidate, exact: bool
    ) -> tuple[Ranked, ...]:
        """What names no one mechanism, in the place of those that it may unmask.

        Two mechanisms with memory may together be no more than relaxation at several paces, and
        that need only do as well. The others are richer than the one that they unmask, and must do
        better by all that an effect has to.
        """
        memory = [e.key for e in final.model.effects if e.has_memory and e.key not in baseline.keys]
        out = []
        if len(memory) > 1:
            found = self._described(RelaxationSpectrum(), memory, final, baseline)
            out.append(replace(found, passes=found.evidence > -DECISIVE))
        if not exact:
            out += [
                self._described(kind(), [key], final, baseline)
                for kind in (StiffeningHysteresis, LooseCoupling)
                for key in kind.refines
                if key in memory
            ]
        return tuple(out)

    def _described(
        self, description: Effect, instead_of: list[str], final: Candidate, baseline: Candidate
    ) -> Ranked:
        model, near = final.model, baseline
        for key in instead_of:
            model = model.without(key)
        if model.effect_keys != baseline.keys:
            near = self.fit(model, baseline, refined=final.refined)
        self.progress(f"describing {' and '.join(instead_of)}", 1, 1)
        plain = self.fit(model + description, near, refined=final.refined)
        found = self._richer(plain, description.key)
        return self._judge(description.key, found, final, _least([final, found]))

    def _alternatives(
        self,
        final: Candidate,
        baseline: Candidate,
        added: Sequence[str],
        steps: Sequence[Step],
    ) -> dict[str, tuple[Ranked, ...]]:
        out = {}
        for key in added:
            if len(added) == 1 and steps and steps[0].chosen == key:
                pairs = [(r.key, r.candidate) for r in steps[0].ranking if r.key != key]
                ranked = [self._judge(k, c, final, final) for k, c in pairs]
            else:
                ranked = self._swaps(key, final, baseline)
            ranked = [self._with_all_trials(r, final) for r in ranked]
            out[key] = tuple(sorted(ranked, key=lambda r: -r.evidence))
        return out

    def _with_all_trials(self, rival: Ranked, final: Candidate) -> Ranked:
        """A rival with what it does once the held-out trials that speak against it are fitted."""
        if not only_held_out_objects(rival, final):
            return rival
        self.progress(f"{rival.key} fitted to all trials", 1, 1)
        mine, other = self._fit_to_all(final), self._fit_to_all(rival.candidate)
        if mine.failure or other.failure:
            return rival
        return replace(rival, refitted=evidence_for(other, mine, _least([other, mine])))

    def _fit_to_all(self, candidate: Candidate) -> Candidate:
        key = candidate.model.effect_keys, candidate.refined
        if key not in self.refits:
            evidence = self.bench.evidence
            both = replace(evidence, fitted=(*evidence.fitted, *evidence.held_out), held_out=())
            self.refits[key] = replace(self.bench, evidence=both).fit(
                candidate.model, [candidate.values], refined=candidate.refined
            )
        return self.refits[key]


def unpenalised(rival: Candidate, final: Candidate) -> float:
    """What a rival's larger number of parameters cost it: parsimony may rank, but not exclude."""
    extra = len(rival.free) - len(final.free)
    samples = effective_samples(final.fitted, difference(final.fitted, rival.fitted))
    return float(max(0, extra) * np.log(samples))


def only_held_out_objects(rival: Ranked, final: Candidate) -> bool:
    """Whether a possible rival fits as well as the final model, but does not predict as well."""
    if rival.candidate.failure or rival.objection or rival.doubt or not final.held_out.by_trial:
        return False
    free = unpenalised(rival.candidate, final)
    fitted = evidence_for(rival.candidate, final, _least([rival.candidate, final]))
    if fitted + free <= -DECISIVE:
        return False
    return rival.evidence + free <= -DECISIVE or predicts_worse(rival, final)


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


def _least(candidates: Iterable[Candidate]) -> Candidate:
    """The candidate that leaves least."""
    return min(
        (c for c in candidates if not c.failure), key=lambda candidate: candidate.fitted.weighted
    )


def held_out_gain(candidate: Candidate, current: Candidate) -> float:
    """Logarithm of the ratio of the weighted held-out residuals, positive if smaller."""
    if not current.held_out.by_trial or not candidate.held_out.by_trial:
        return 0.0
    if not np.isfinite(candidate.held_out.weighted):
        return -np.inf
    return float(np.log(current.held_out.weighted / candidate.held_out.weighted))


def baseline(
    bench: Workbench, model: Model, guess: dict[str, float], *, refined: Sequence[str] = ()
) -> Candidate:
    """Fit of the model that the investigation starts from."""
    starts = []
    for factor in (1.0, 0.3, 3.0):
        start = guess | {"K": factor * guess["K"], "B": guess["B"] / factor}
        starts += starting_values(model, start, most=3 if model.effects else 1)
    return bench.fit(model, starts, refined=refined)


def _outside(basis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Part of a vector outside the span of an orthonormal basis."""
    return np.asarray(vector - basis @ (basis.T @ vector))


def _refinable(candidate: Candidate, key: str) -> bool:
    return key not in candidate.refined and any(
        p.plain is not None and name.startswith(f"{key}.")
        for name, p in candidate.model.parameters.items()
    )


def _refinements(model: Model, near: Candidate) -> list[dict[str, float]]:
    """Starts of the refined model: the plain optimum, and its refinements one way and the other."""
    starts = [dict(near.values)]
    new = {
        name: (p, p.plain)
        for name, p in model.parameters.items()
        if p.plain is not None and name not in near.free
    }
    own = {name.split(".")[0] for name in new}
    for side in (1.0, -1.0):
        start = dict(near.values)
        for name, (p, plain) in new.items():
            # Most of the way to one side and, where there is one, to the other.
            room = p.upper - plain if side > 0 or p.lower >= plain else p.lower - plain
            start[name] = plain + float(np.clip(0.8 * room, -0.5, 0.8))
        starts.append(start)
        # The plain form may have gone astray for want of the refinement.
        fresh = dict(start)
        for name, p in model.parameters.items():
            if name.split(".")[0] in own and p.plain is None and p.null is None:
                fresh[name] = p.nominal
        starts.append(fresh)
    return starts


def _named(candidate: Candidate) -> str:
    return " + ".join(["KBI", *candidate.keys])
