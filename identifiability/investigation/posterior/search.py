"""Which sets of effects are weighed: one effect at a time, for as long as something is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from identifiability.errors import InputError
from identifiability.investigation.fits.candidate import Candidate, unfitted
from identifiability.investigation.posterior.evidence import Evaluator
from identifiability.investigation.posterior.probabilities import Keys, Probabilities, Weighing
from identifiability.investigation.posterior.signatures import strongest
from identifiability.investigation.search.fitter import refinable
from identifiability.investigation.search.ranking import Ranker
from identifiability.joint.model import Model

_SEEN = 6  # effects that are added to a set that has effects already
_TAKEN_UP = 3  # sets of one size that are evaluated further, at most
_REFINED = 3  # sets of one size that are refined, at most
_WORTH_REFINING = 3.0  # nats before K, B and I alone
_BEHIND = 60.0  # nats behind the best of its size, from which a set is not refined
_NEAR = 12.0  # nats behind the best single effect, within which another is enlarged too
_EXCHANGED = 2  # effects up to which each is tried without the one that was found before it


def weigh(ranker: Ranker, evaluator: Evaluator, baseline: Candidate, most: int) -> Probabilities:
    """Weigh the sets of effects that may be missing.

    All single effects are, the most probable ones refined too. The most probable set is enlarged by
    every effect whose signature is in what it leaves, for as long as that makes it more probable;
    so is a single effect that comes near.
    What was added last may be what was missing all along, and what was found before it a poor
    picture of it: of a pair, both are enlarged.

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
    search.enlarge(())
    for size in range(2, most + 1):
        before = search.best(size - 1)
        if before is None or not search.improves(before):
            break
        for keys in search.contenders(size - 1):
            search.enlarge(keys)
        for _ in range(size if size <= _EXCHANGED else 0):
            found = search.best(size)
            left = search.not_enlarged(found) if found is not None else None
            if left is None:
                break
            search.enlarge(left)
    return search.weighing.posterior()


@dataclass(eq=False)
class _Search:
    ranker: Ranker
    weighing: Weighing
    baseline: Candidate
    enlarged: list[Keys] = field(default_factory=list)
    refined: set[Keys] = field(default_factory=set)
    plain: dict[Keys, float] = field(default_factory=dict)

    def add(self, what: str, candidates: Sequence[Candidate]) -> None:
        for i, candidate in enumerate(candidates):
            self.ranker.progress(f"weighing {what}", i, len(candidates))
            self.weighing.weigh(candidate, self.baseline.keys)
        # Before any is refined: a set is compared with others in one form.
        for keys, found in self.weighing.found.items():
            self.plain.setdefault(keys, found.log_evidence)

    def enlarge(self, keys: Keys) -> None:
        """Add every effect to a set whose signature is in what it leaves; refine the best."""
        self.enlarged.append(keys)
        current = self.weighing.candidates[keys]
        named = " + ".join(["K, B, I", *keys])
        more = {
            key: effect
            for key, effect in self.ranker.library.items()
            if key not in current.keys and tuple(sorted((*keys, key))) not in self.weighing.found
        }
        what = f"what may be added to {named}"
        if not keys:
            jobs = [(current.model + effect(), key) for key, effect in more.items()]
            fitted = self.ranker.fit_all(f"adding to {named}", jobs, current)
            self.add(what, [c for _, c in fitted])
        else:
            found = self.weighing.found
            alone = {k: found[k,].values for k in more if (k,) in found}
            seen = strongest(self.weighing.evaluator, found[keys], more, alone, _SEEN)
            # Fitted by the noise that they leave alone: another fit is for what is named.
            models = [current.model + more[key]() for key in seen]
            self.add(what, [self._unfitted(model, current) for model in models])
            for near in self._ranked(len(keys) + 1)[:_TAKEN_UP]:
                self.weighing.take_up(near)
        self._refine(len(keys) + 1)

    def _unfitted(
        self, model: Model, near: Candidate, more: Sequence[str] | None = None
    ) -> Candidate:
        refined = near.refined if more is None else tuple(more)
        starts = self.ranker.fitter.starts(model, near, refined)
        return unfitted(model, starts, refined, near.scheme)

    def _refine(self, size: int) -> None:
        """Free the refining parameters of the best sets of a size."""
        found = self.weighing.found
        of_size = [keys for keys in found if len(keys) == size]
        ranked = sorted(of_size, key=lambda keys: -self.plain[keys])[:_REFINED]
        for keys in ranked:
            behind = self.plain[ranked[0]] - self.plain[keys]
            gain = found[keys].log_evidence - found[()].log_evidence
            plain = self.weighing.candidates[keys]
            if keys in self.refined or behind > _BEHIND or gain < _WORTH_REFINING:
                continue
            self.refined.add(keys)
            for key in keys:
                if not refinable(plain, key):
                    continue
                more = (*plain.refined, key)
                richer = (
                    self.ranker.fitter.refine(plain, more)
                    if size == 1
                    else self._unfitted(plain.model, plain, more)
                )
                self.add(f"{key}, refined", [richer])

    def _ranked(self, size: int) -> list[Keys]:
        """Sets of a size, the best first."""
        sets = [keys for keys in self.weighing.found if len(keys) == size]
        return sorted(sets, key=lambda keys: -self.weighing.found[keys].log_evidence)

    def best(self, size: int) -> Keys | None:
        """Best set of a size."""
        return next(iter(self._ranked(size)), None)

    def contenders(self, size: int) -> list[Keys]:
        """Sets of a size to be enlarged: the best, and a single effect that comes near."""
        ranked, found = self._ranked(size), self.weighing.found
        least = found[ranked[0]].log_evidence - _NEAR
        return [
            keys for keys in ranked[: 2 if size == 1 else 1] if found[keys].log_evidence > least
        ]

    def improves(self, keys: Keys) -> bool:
        """Whether a set is more probable than the best with one effect less."""
        smaller = self._ranked(len(keys) - 1)[0]
        return self.weighing.score(keys) > self.weighing.score(smaller)

    def not_enlarged(self, keys: Keys) -> Keys | None:
        """Rest of a set without one of its effects that has not been enlarged itself."""
        rests = [tuple(k for k in keys if k != key) for key in keys]
        return next((r for r in rests if r in self.weighing.found and r not in self.enlarged), None)
