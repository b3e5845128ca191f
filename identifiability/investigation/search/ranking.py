"""Every effect of the library beside a model: screened, fitted, refined, judged and ranked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.search.criterion import least
from identifiability.investigation.search.fitter import Fitter, refinable
from identifiability.investigation.search.found import Ranking
from identifiability.investigation.search.gate import Gate, Ranked
from identifiability.joint.effects import Effect
from identifiability.joint.model import KBI, Model
from identifiability.progress import Progress

_WORKERS = 2
_WITHIN_REACH = 0.5  # share of the best gain at which a candidate is worth refining
_MOST_REFINED = 3
_SCREENED = 6  # effects that are fitted beside a model that has effects already
# Share of the best gain at a glance, and least number, to be finished: at first, and later on,
# when models take longer.
_WORTH, _LEAST_FINISHED = 0.3, 4
_WORTH_LATER, _LEAST_LATER = 0.5, 2


@dataclass(frozen=True, eq=False)
class Ranker:
    """Tries effects beside models of one study.

    Attributes
    ----------
    bench : Workbench
    library : mapping of str to type of Effect
        Effects to be tried.
    fitter : Fitter
    gate : Gate
    progress : callable
        Told ``(what, done, total)``.
    """

    bench: Workbench
    library: Mapping[str, type[Effect]]
    fitter: Fitter
    gate: Gate
    progress: Progress

    def rank(self, current: Candidate) -> Ranking:
        """Add every effect of the library to a model, refit, and rank."""
        keys = [key for key in self.library if key not in current.keys]
        kept = self.screen(keys, current)
        jobs = [(current.model + self.library[key](), key) for key in kept]
        fitted = self.fit_all(f"adding to {_named(current)}", jobs, current)
        ranked = self._refine(self.judge_all(fitted, current), current)
        chosen = self._choose([r for r in ranked if r.passes])
        left_out = tuple(k for k in keys if k not in kept)
        return Ranking(current, tuple(ranked), chosen, self.bench.rules.decisive, left_out)

    def _choose(self, admitted: Sequence[Ranked]) -> str:
        """Effect to add: the best, or the plainest where the noise is unknown and many do."""
        admitted = [r for r in admitted if not r.doubt] or admitted
        if not self.bench.split.has_noise:
            enough = [r for r in admitted if self.gate.at_floor(r.candidate)]
            admitted = sorted(enough, key=lambda r: len(r.candidate.free)) or admitted
        return admitted[0].key if admitted else ""

    def screen(self, keys: Sequence[str], current: Candidate) -> list[str]:
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
        theta = problem.free_vector(current.values)
        basis, _ = np.linalg.qr(problem.jacobian(theta))
        left = _outside(basis, problem.residuals(theta))
        joint = {name: current.values[name] for name in ("K", "B", "I")}
        plain = self.bench.problem(KBI(), fitted).residuals(np.array(list(joint.values())))
        scores = {}
        for key in keys:
            model = KBI() + self.library[key]()
            alone = self.bench.problem(model, fitted)
            shapes = starting_values(model, joint)
            if (known := self.fitter.alone(key)) is not None:
                shapes.append({**known.values, **joint})
            best = 0.0
            for shape in shapes:
                change = alone.residuals(alone.free_vector(shape)) - plain
                signature = _outside(basis, change)
                size = float(signature @ signature)
                if np.isfinite(size) and size > 0:
                    best = max(best, float(signature @ left) ** 2 / size)
            scores[key] = best
        ranked = sorted(keys, key=lambda key: -scores[key])
        return [key for key in keys if key in ranked[:_SCREENED]]

    def fit_all(
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
        share, least_ = (_WORTH_LATER, _LEAST_LATER) if current.keys else (_WORTH, _LEAST_FINISHED)
        enough = {int(i) for i in order[:least_]}
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

    def judge_all(
        self, fitted: Iterable[tuple[str, Candidate]], current: Candidate
    ) -> list[Ranked]:
        """Candidates held to every rule against one model, best first."""
        fitted = list(fitted)
        best = least([current, *(c for _, c in fitted)])
        out = [self.gate.judge(key, c, current, best) for key, c in fitted]
        return sorted(out, key=lambda r: -r.evidence)

    def _refine(self, ranked: list[Ranked], current: Candidate) -> list[Ranked]:
        """Free the refining parameters of the best candidates; keep them where it pays."""
        # What is not admitted does not set the mark: with many samples a trifle may be evident.
        top = next((r for r in ranked if r.passes), ranked[0]).evidence
        worth = [
            r
            for r in ranked
            # A linear model costs little.
            if r.evidence >= (0.0 if r.candidate.model.linear else max(0.0, _WITHIN_REACH * top))
            and refinable(r.candidate, r.key)
            # Beside other effects only what its plain form nearly is: refining takes long.
            and (r.passes or r.refusal == "only mends" or not current.keys)
        ][:_MOST_REFINED]
        refined: dict[str, Candidate] = {}
        for r in worth:
            self.progress(f"refining {r.key}", len(refined) + 1, len(worth))
            refined[r.key] = self.fitter.refine(r.candidate, (*r.candidate.refined, r.key))
        best = least([current, *(r.candidate for r in ranked), *refined.values()])
        out = []
        for r in ranked:
            plain = self.gate.judge(r.key, r.candidate, current, best)
            if r.key in refined:
                richer = self.gate.judge(r.key, refined[r.key], current, best)
                if richer.evidence > plain.evidence + self.bench.rules.decisive and (
                    richer.passes or not plain.passes
                ):
                    plain = richer
            out.append(plain)
        return sorted(out, key=lambda r: -r.evidence)


def _outside(basis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Part of a vector outside the span of an orthonormal basis."""
    return np.asarray(vector - basis @ (basis.T @ vector))


def _named(candidate: Candidate) -> str:
    return " + ".join(["KBI", *candidate.keys])
