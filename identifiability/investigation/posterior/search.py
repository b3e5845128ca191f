"""Which sets of effects are weighed: one effect at a time, for as long as something is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.errors import InputError
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.posterior.evidence import Evaluator
from identifiability.investigation.posterior.probabilities import Probabilities, Weighing
from identifiability.investigation.search.fitter import refinable
from identifiability.investigation.search.ranking import Ranker

_NEARER = 0.3  # share of what named sets were behind the unknown, that one effect more may leave
_ENOUGH = 0.05  # probability of "none of these" below which nothing more is looked for
_FRONTIER, _REFINED = 1, 3  # sets that are enlarged, and that are refined, at most
_WORTH_REFINING = 3.0  # nats before K, B and I alone
_BEHIND = 60.0  # nats behind the best from which a set is not enlarged


def weigh(ranker: Ranker, evaluator: Evaluator, baseline: Candidate, most: int) -> Probabilities:
    """Weigh the sets of effects that may be missing.

    All single effects are, the most probable ones refined too; where something is still missing
    beside all of them the most probable is enlarged by every effect whose signature is in what it
    leaves.

    Parameters
    ----------
    ranker : Ranker
        Fits the candidates.
    evaluator : Evaluator
    baseline : Candidate
        The model to start from.
    most : int
        Most effects to add.

    Raises
    ------
    InputError
        Where the model to start from cannot be evaluated.
    """
    search = _Search(ranker, Weighing(evaluator, len(ranker.library)), baseline)
    search.add("K, B and I", [baseline])
    if () not in search.weighing.found:
        raise InputError(f"the model to start from has no evidence: {search.weighing.failures['']}")
    frontier: Sequence[Candidate] = [baseline]
    posterior, behind = None, np.inf
    for _ in range(most):
        for current in frontier:
            search.enlarge(current)
        search.refine(frontier)
        posterior = search.weighing.posterior()
        # What is unknown stays so with more effects, unless each brings the named nearer to it.
        before, behind = behind, posterior.behind
        if posterior.none_of_these <= _ENOUGH or behind > _NEARER * before:
            break
        frontier = search.frontier(frontier)
    return search.weighing.posterior() if posterior is None else posterior


@dataclass(frozen=True, eq=False)
class _Search:
    ranker: Ranker
    weighing: Weighing
    baseline: Candidate

    def _keys(self, candidate: Candidate) -> tuple[str, ...]:
        return tuple(sorted(k for k in candidate.keys if k not in self.baseline.keys))

    def add(self, what: str, candidates: Sequence[Candidate]) -> None:
        for i, candidate in enumerate(candidates):
            self.ranker.progress(f"weighing {what}", i, len(candidates))
            self.weighing.weigh(candidate, self.baseline.keys)

    def enlarge(self, current: Candidate) -> None:
        """Add every effect to a set whose signature is in what it leaves."""
        named = " + ".join(["K, B, I", *self._keys(current)])
        keys = self.ranker.screen(
            [k for k in self.ranker.library if k not in current.keys], current
        )
        jobs = [(current.model + self.ranker.library[key](), key) for key in keys]
        fitted = self.ranker.fit_all(f"adding to {named}", jobs, current)
        self.add(f"what may be added to {named}", [c for _, c in fitted])

    def refine(self, frontier: Sequence[Candidate]) -> None:
        """Free the refining parameters of the best of the last sets."""
        nothing = self.weighing.found[()].log_evidence
        for keys in self._best(self._size(frontier), _REFINED):
            if self.weighing.found[keys].log_evidence < nothing + _WORTH_REFINING:
                continue
            plain = self.weighing.candidates[keys]
            for key in keys:
                if refinable(plain, key):
                    richer = self.ranker.fitter.refine(plain, (*plain.refined, key))
                    self.add(f"{key}, refined", [richer])

    def frontier(self, before: Sequence[Candidate]) -> list[Candidate]:
        """Sets of the size that was just reached, to be enlarged next."""
        return [
            self.weighing.candidates[keys] for keys in self._best(self._size(before), _FRONTIER)
        ]

    def _size(self, before: Sequence[Candidate]) -> int:
        return 1 + max((len(self._keys(c)) for c in before), default=0)

    def _best(self, size: int, n: int) -> list[tuple[str, ...]]:
        found = self.weighing.found
        sets = [k for k in self.weighing.candidates if len(k) == size]
        ranked = sorted(sets, key=lambda k: -found[k].log_evidence)
        top = found[ranked[0]].log_evidence if ranked else -np.inf
        return [k for k in ranked[:n] if found[k].log_evidence > top - _BEHIND]
