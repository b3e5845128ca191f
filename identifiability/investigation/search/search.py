"""The search for missing effects: add, refine, drop, swap; each time refitted, and judged."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.starts import starting_values
from identifiability.investigation.search.fitter import Fitter, refinable
from identifiability.investigation.search.gate import (
    DECISIVE,
    ONLY_MENDS,
    Gate,
    Ranked,
    evidence_for,
    least,
    only_held_out_objects,
    pooled_error,
    total_evidence,
)
from identifiability.joint.effects import (
    EFFECTS,
    Effect,
    LooseCoupling,
    RelaxationSpectrum,
    StiffeningHysteresis,
)
from identifiability.joint.model import KBI, Model

MOST_EFFECTS = 3
_WORKERS = 2
_WITHIN_REACH = 0.5  # share of the best gain at which a candidate is worth refining or swapping
_MOST_REFINED, _MOST_SWAPS = 3, 4
_CONTENDS = 0.1  # share of what an effect removes, that a rival worth refining may leave
_SCREENED = 6  # effects that are fitted at every step after the first
# Share of the best gain at a glance, and least number, to be finished: at first, and later on,
# when models take longer.
_WORTH, _LEAST_FINISHED = 0.3, 4
_WORTH_LATER, _LEAST_LATER = 0.5, 2

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Ranking:
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
    steps : tuple of Ranking
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
        be no more than that; one that passes stands for them. Split is against the final model.
    exact : bool
        Whether the final model leaves no more than noise.
    n_fits : int
        Number of models that were fitted.
    ended : str
        Why the search ended.
    """

    baseline: Candidate
    steps: tuple[Ranking, ...]
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
    fitter: Fitter = field(init=False)
    gate: Gate = field(init=False)

    def __post_init__(self) -> None:
        self.fitter, self.gate = Fitter(self.bench), Gate(self.bench)

    def run(self, baseline: Candidate, most: int = MOST_EFFECTS) -> Search:
        """Search from a fitted model.

        Parameters
        ----------
        baseline : Candidate
        most : int
            Most effects to add.
        """
        current, steps, ended = baseline, [], f"{most} effects were added"
        self.fitter.first = self.gate.first = baseline
        while len(current.keys) < len(baseline.keys) + most:
            step = self.rank(current)
            steps.append(step)
            if not step.chosen:
                ended = "no further effect was admitted"
                break
            current = next(r.candidate for r in step.ranking if r.key == step.chosen)
            current = self._improve(current, baseline, step)
            if self.gate.at_floor(current):
                ended = self._reached
                break
        current = self._simplify(self._prune(current, baseline), baseline)
        exact = self.gate.leaves_noise(current)
        ladder = self._ladder(current, baseline)
        added = [key for key, _ in ladder]
        alternatives = self._alternatives(current, baseline, added, steps)
        without = {
            key: self.fitter.fit(current.model.without(key), baseline, refined=current.refined)
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
            len(self.fitter.known),
            ended,
        )

    @property
    def _reached(self) -> str:
        if self.bench.split.has_noise:
            return "the error reached the noise floor"
        error = self.bench.rules.discrepancy
        return f"the noise is not known, and an error below {error:g} may be one of measurement"

    def rank(self, current: Candidate) -> Ranking:
        """Add every effect of the library to a model, refit, and rank."""
        keys = [key for key in self.library if key not in current.keys]
        kept = self._screen(keys, current)
        jobs = [(current.model + self.library[key](), key) for key in kept]
        fitted = self._fit_all(f"adding to {_named(current)}", jobs, current)
        ranking = self._refine(self._ranked(fitted, current), current)
        chosen = self._choose([r for r in ranking if r.passes])
        return Ranking(current, tuple(ranking), chosen, tuple(k for k in keys if k not in kept))

    def _choose(self, admitted: Sequence[Ranked]) -> str:
        """Effect to add: the best, or the plainest where the noise is unknown and many do."""
        admitted = [r for r in admitted if not r.doubt] or admitted
        if not self.bench.split.has_noise:
            enough = [r for r in admitted if self.gate.at_floor(r.candidate)]
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
        fitted = self.bench.split.fitted
        problem = self.bench.problem(
            current.model, fitted, refined=current.refined, scheme=current.scheme
        )
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
            known = self.fitter.known.get((model.effect_keys, ()))
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
            lambda model: self.fitter.fit(model, current, refined=current.refined, thorough=False),
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
                lambda model: self.fitter.fit(model, current, refined=current.refined),
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

    def _ranked(self, fitted: Iterable[tuple[str, Candidate]], current: Candidate) -> list[Ranked]:
        fitted = list(fitted)
        best = least([current, *(c for _, c in fitted)])
        out = [self.gate.judge(key, c, current, best) for key, c in fitted]
        return sorted(out, key=lambda r: -r.evidence)

    def _refine(self, ranking: list[Ranked], current: Candidate) -> list[Ranked]:
        """Free the refining parameters of the best candidates; keep them where it pays."""
        # What is not admitted does not set the mark: with many samples a trifle may be evident.
        top = next((r for r in ranking if r.passes), ranking[0]).evidence
        worth = [
            r
            for r in ranking
            # A linear model costs little.
            if r.evidence >= (0.0 if r.candidate.model.linear else max(0.0, _WITHIN_REACH * top))
            and refinable(r.candidate, r.key)
            # Beside other effects only what its plain form nearly is: refining takes long.
            and (r.passes or r.reason == ONLY_MENDS or not current.keys)
        ][:_MOST_REFINED]
        refined: dict[str, Candidate] = {}
        for r in worth:
            self.progress(f"refining {r.key}", len(refined) + 1, len(worth))
            more = (*r.candidate.refined, r.key)
            refined[r.key] = self.fitter.refine(r.candidate, more)
        best = least([current, *(r.candidate for r in ranking), *refined.values()])
        out = []
        for r in ranking:
            plain = self.gate.judge(r.key, r.candidate, current, best)
            if r.key in refined:
                richer = self.gate.judge(r.key, refined[r.key], current, best)
                if richer.evidence > plain.evidence + DECISIVE and (
                    richer.passes or not plain.passes
                ):
                    plain = richer
            out.append(plain)
        return sorted(out, key=lambda r: -r.evidence)

    def _improve(self, current: Candidate, baseline: Candidate, step: Ranking) -> Candidate:
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
        rest = self.fitter.fit(current.model.without(key), baseline, refined=current.refined)
        likely = self._likely(key, current, baseline)
        jobs = [(rest.model + self.library[other](), other) for other in likely]
        near = baseline if rest.failure else rest
        fitted = self._fit_all(f"in the place of {key}", jobs, near)
        # A rival to a refined effect is refined too, or the comparison is not fair; so is one that
        # comes near in its plain form.
        near_to = pooled_error(current)
        near_to += _CONTENDS * (pooled_error(rest) - near_to)
        fitted = [
            (other, self.fitter.richer(plain, other))
            if key in current.refined or pooled_error(plain) < near_to
            else (other, plain)
            for other, plain in fitted
        ]
        return self._ranked(fitted, current)

    def _likely(self, key: str, current: Candidate, baseline: Candidate) -> list[str]:
        """Effects that may stand in the place of another: alike by nature, or alike alone."""
        alone = {
            k: c.fitted.weighted for k in self.library if (c := self.fitter.alone(k)) is not None
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
            smaller = self.fitter.fit(current.model.without(key), baseline, refined=current.refined)
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
                found = self.fitter.fit(model, current, refined=current.refined)
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
            models = {key: below.model + final.model.effect(key) for key in left}
            tried = [
                (key, self.fitter.fit(model, below, refined=final.refined))
                for key, model in models.items()
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
            near = self.fitter.fit(model, baseline, refined=final.refined)
        self.progress(f"describing {' and '.join(instead_of)}", 1, 1)
        plain = self.fitter.fit(model + description, near, refined=final.refined)
        found = self.fitter.richer(plain, description.key)
        return self.gate.judge(description.key, found, final, least([final, found]))

    def _alternatives(
        self,
        final: Candidate,
        baseline: Candidate,
        added: Sequence[str],
        steps: Sequence[Ranking],
    ) -> dict[str, tuple[Ranked, ...]]:
        out = {}
        for key in added:
            if len(added) == 1 and steps and steps[0].chosen == key:
                pairs = [(r.key, r.candidate) for r in steps[0].ranking if r.key != key]
                ranked = [self.gate.judge(k, c, final, final) for k, c in pairs]
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
        mine, other = self.fitter.fit_to_all(final), self.fitter.fit_to_all(rival.candidate)
        if mine.failure or other.failure:
            return rival
        return replace(rival, refitted=evidence_for(other, mine, least([other, mine])))


def _outside(basis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Part of a vector outside the span of an orthonormal basis."""
    return np.asarray(vector - basis @ (basis.T @ vector))


def _named(candidate: Candidate) -> str:
    return " + ".join(["KBI", *candidate.keys])
