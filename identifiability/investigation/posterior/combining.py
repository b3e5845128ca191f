"""Weighed sets of effects, put together as probabilities.

How many effects there are is as probable for every number from none to the most that are tried;
then every set of so many is, the unknown being one of the effects (Scott & Berger 2010, Ann Stat
38:2587-2619): trying more effects makes a false name no more likely. A set with a discrepancy of no
more than a tenth of what its effects explain, beyond what K, B and I do, is still that set, whose
equations are not exact; with more it is "none of these".
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import comb, log

import numpy as np

from identifiability.investigation.fits.candidate import unfitted
from identifiability.investigation.posterior.discrepancy import (
    Discrepancy,
    Discrepant,
    discrepancy_of,
)
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.probabilities import (
    Probabilities,
    SetProbability,
    WeighedSet,
)
from identifiability.investigation.rules import Rules
from identifiability.joint.effects import DESCRIPTIONS
from identifiability.progress import Progress

Keys = tuple[str, ...]

LOST = 60.0
"""Log evidence [nats] behind the best from which a set is not fitted any further."""
CONTENDS = 12.0
"""Nats that a set may be behind, for a discrepancy to be put beside it."""
SAME = 0.5
"""Nats by which two evidences of one thing may differ."""

_MOST_BESIDE, _BEST_OF_SIZE = 6, 2
_FAR = 0.05  # share of what the best of its size gained, that a set may lack
_SURE = 3.0  # nats by which values that no joint has must be better, to count
_DRIFT = "sensor_drift"  # the effect that a discrepancy of the kind "drift" is
_MENDERS = 4
"""Effects that may mend the equations of any other: with so many a set and the same with one effect
more, which does no more than that, are as probable as each other. In blind cases the larger set was
true about half the time."""


@dataclass(frozen=True, eq=False)
class _Forms:
    """Sets whose equations are not exact, or beside which there is something unknown.

    Attributes
    ----------
    inexact : dict of tuple of str to float
        Log evidence [nats] of a set whose equations are wrong by no more than they may be.
    unknown : dict of tuple of str to float
        Log evidence and log prior of a set and something unknown.
    described : dict of tuple of str to str
        Of these, those in which a description of no mechanism is what is unknown, and its key.
    beside : dict of tuple of str to Discrepant
        Each set that was tried, with any discrepancy.
    """

    inexact: dict[Keys, float] = field(default_factory=dict)
    unknown: dict[Keys, float] = field(default_factory=dict)
    described: dict[Keys, str] = field(default_factory=dict)
    beside: dict[Keys, Discrepant] = field(default_factory=dict)


@dataclass(eq=False)
class Combining:
    """Puts sets together as probabilities, as they are when it is asked.

    Attributes
    ----------
    evaluator : Evaluator
    library : collection of str
        Keys of the effects that could be tried.
    rules : Rules
        Conventions.
    progress : callable
        Told ``(what, done, total)``.
    found : mapping of tuple of str to Evaluated
        The best form of each set.
    described : mapping of tuple of str to mapping
        By the known effects beside it, each description that was evaluated, by its key.
    screened : mapping of tuple of str to float
        Sets that a part of a long record's samples left far behind, and by how many nats.
    failures : dict of str to str
        What could not be weighed, and why.
    """

    evaluator: Evaluator
    library: Collection[str]
    rules: Rules
    progress: Progress
    found: Mapping[Keys, Evaluated]
    described: Mapping[Keys, Mapping[str, Evaluated]]
    screened: Mapping[Keys, float]
    failures: dict[str, str]
    _discrepancies: tuple[Evaluated, Discrepancy] | None = None
    _inexact: dict[
        tuple[Evaluated, Evaluated, Discrepant | None], tuple[Discrepant, Discrepant]
    ] = field(default_factory=dict)

    @property
    def ranked(self) -> list[Keys]:
        """Sets, the most probable first, their equations taken to be exact."""
        return sorted(self.found, key=lambda keys: -self.score(keys))

    def log_prior(self, n_effects: int) -> float:
        """Of one set of so many effects, the unknown counted as one of the library."""
        return log_prior(n_effects, len(self.library) + 1)

    def score(self, keys: Keys) -> float:
        """Log evidence and log prior [nats] of a set whose equations are exact."""
        return self.found[keys].log_evidence + self.log_prior(len(keys))

    def within(self, nats: float) -> list[Keys]:
        """The most probable sets, no more than so many nats behind the first."""
        ranked = self.ranked
        least = self.score(ranked[0]) - nats
        return [keys for keys in ranked[:_MOST_BESIDE] if self.score(keys) > least]

    def is_far(self, keys: Keys, best: Keys) -> bool:
        """Whether a set leaves so much more than the best of its size that it cannot pass it."""
        top = self.found[best].log_evidence
        gained = top - self.found[()].log_evidence
        return top - self.found[keys].log_evidence > max(LOST, _FAR * gained)

    def posterior(self) -> Probabilities:
        """Probabilities of all that was weighed."""
        forms = self._forms()
        rows = self._rows(self.named(forms.inexact), forms)
        named = next(row.effects for row in rows if row.effects is not None)
        unknown = max(forms.unknown, key=lambda keys: forms.unknown[keys], default=())
        shown = unknown if rows[0].effects is None else named
        return Probabilities(
            rows,
            shown,
            self.found[shown].values,
            self.found[shown].weights.estimate.rms,
            self.evaluator.band.scale,
            forms.beside.get(shown),
            unknown,
            self._beside_unknown(rows, forms),
            forms.described.get(unknown),
            {keys: self._weighed(found) for keys, found in self.found.items()},
            (self.evaluator.band.n_samples, self.evaluator.band.n_recorded),
            dict(self.failures),
            {keys: behind for keys, behind in self.screened.items() if keys not in self.found},
        )

    def _weighed(self, found: Evaluated) -> WeighedSet:
        """A model as it was weighed, for those who look at it later."""
        candidate = unfitted(found.model, found.values, found.refined, found.scheme)
        error = (found.weights.estimate.rms / self.evaluator.band.scale) ** 2
        return WeighedSet(candidate, found.log_evidence, error, found.sds)

    def _near(self) -> list[Keys]:
        """Sets that come near the best, and the best of every size."""
        ranked, near = self.ranked, self.within(CONTENDS)
        # Inexact equations may make up for an effect more.
        for n in sorted({len(keys) for keys in ranked}):
            of_size = [keys for keys in ranked if len(keys) == n][:_BEST_OF_SIZE]
            near += [keys for keys in of_size if not self.is_far(keys, of_size[0])]
        return list(dict.fromkeys(near))

    def _forms(self) -> _Forms:
        """The sets that come near, with their equations inexact, and with something unknown."""
        first = self.ranked[0]
        likeliest = self.found[first]
        if self._discrepancies is None or self._discrepancies[0] is not likeliest:
            self._discrepancies = likeliest, discrepancy_of(self.evaluator, likeliest)
            self._inexact.clear()
        least, forms = self.score(first) - CONTENDS, _Forms()
        near = sorted(self._near(), key=len)
        for i, keys in enumerate(near):
            self.progress("weighing something unknown", i, len(near))
            found, besides = self.found[keys], self._besides(keys)
            if found.beyond > _SURE and self.score(keys) > least:
                # The same effects with values that no joint has are none of these. By how much more
                # probable is not known far from what was fitted.
                forms.unknown[keys] = found.log_evidence + found.beyond + besides
            smaller = [d for k, d in forms.beside.items() if set(k) < set(keys)]
            nested = max(smaller, key=lambda d: d.log_evidence, default=None)
            one = self._beside(self._discrepancies[1], keys, nested)
            if one is None:
                continue
            free, form = one
            forms.beside[keys] = free
            if free.kind == "none":
                continue  # a discrepancy of no size is none
            # One that the equations' error explains is not something unknown besides.
            if self._drifts(keys, free):
                drifting = tuple(sorted((*keys, _DRIFT)))
                known = forms.inexact.get(drifting, -np.inf)
                forms.inexact[drifting] = max(free.log_evidence, known)
            elif form.log_evidence < free.log_evidence - SAME:
                known = forms.unknown.get(keys, -np.inf)
                forms.unknown[keys] = max(free.log_evidence + besides, known)
            known = forms.inexact.get(keys, -np.inf)
            forms.inexact[keys] = max(form.log_evidence, known)
        for keys, by_key in self.described.items():
            for key, found in by_key.items():
                value = found.log_evidence + self._besides(keys)
                if value > forms.unknown.get(keys, -np.inf):
                    forms.unknown[keys], forms.described[keys] = value, key
        return forms

    def _besides(self, keys: Keys) -> float:
        """Log prior [nats] of a set and one form of something unknown, of all that there are."""
        return self.log_prior(len(keys) + 1) - log(1 + len(DESCRIPTIONS))

    def _drifts(self, keys: Keys, free: Discrepant) -> bool:
        """Whether a discrepancy is a drift of the recorder, which is known, in another form."""
        if _DRIFT in keys or tuple(sorted((*keys, _DRIFT))) not in self.found:
            return False
        others = np.sqrt(sum(size**2 for kind, size in free.sizes.items() if kind != "drift"))
        return free.kind == "drift" and others <= self._tolerated(keys)

    def _tolerated(self, keys: Keys) -> float:
        """Discrepancy, over the response, that inexact equations of a set may leave."""
        explained = self._explained(self.found[keys]) / self.evaluator.band.scale
        return max(self.rules.equations * explained, self.rules.trifle)

    def _rows(self, named: Mapping[Keys, float], forms: _Forms) -> tuple[SetProbability, ...]:
        """Probabilities from their logarithms, which lack a constant."""
        top = max([*named.values(), *forms.unknown.values()])
        weights = {keys: np.exp(value - top) for keys, value in named.items()}
        of_unknown = sum(np.exp(value - top) for value in forms.unknown.values())
        total = sum(weights.values()) + of_unknown
        rows = [
            SetProbability(keys, float(w / total), named[keys] - self.log_prior(len(keys)))
            for keys, w in weights.items()
        ]
        most = max((d.log_evidence for d in forms.beside.values()), default=-np.inf)
        rows.append(SetProbability(None, float(of_unknown / total), most))
        return tuple(sorted(rows, key=lambda row: -row.probability))

    @staticmethod
    def _beside_unknown(rows: Sequence[SetProbability], forms: _Forms) -> dict[Keys, float]:
        """Probability of "none of these" by the known effects beside which it is."""
        whole = next(row.probability for row in rows if row.effects is None)
        top = max(forms.unknown.values(), default=0.0)
        weights = {keys: np.exp(value - top) for keys, value in forms.unknown.items()}
        total = sum(weights.values())
        return {keys: float(whole * w / total) for keys, w in weights.items()}

    def named(self, inexact: Mapping[Keys, float]) -> dict[Keys, float]:
        """Log of what is proportional to the probability of each set, its equations exact or not.

        Equations that are wrong by as little as the rules allow may be mended by an effect that is
        not there: then a set and the same with that effect are both what the data would look like.
        """
        every = len(self.library) + 1
        found: dict[Keys, float] = {}
        for keys in sorted(self.found, key=len, reverse=True):
            exact = self.found[keys].log_evidence
            mended = [inexact[keys]] if keys in inexact else []
            for more, value in found.items():
                if len(more) == len(keys) + 1 and set(keys) < set(more) and self.mends(keys, more):
                    mended.append(value + log(min(1.0, _MENDERS / every)))
            # As probable as that the equations are exact.
            found[keys] = float(np.logaddexp.reduce([exact, *mended])) - log(2) * bool(mended)
        return {keys: value + self.log_prior(len(keys)) for keys, value in found.items()}

    def mends(self, keys: Keys, more: Keys) -> bool:
        """Whether one effect more does no more than the error of a set's equations may be."""
        fewer, richer = self.found[keys], self.found[more]
        return _moved(fewer, richer) <= self.rules.equations * self._explained(fewer)

    def _explained(self, found: Evaluated) -> float:
        """What effects explain: root mean square by which the prediction moves because of them.

        From that of K, B and I alone, so that what K, B and I do as well, and effects that cancel
        each other, do not count.
        """
        return _moved(self.found[()], found)

    def _beside(
        self, discrepancies: Discrepancy, keys: Keys, nested: Discrepant | None
    ) -> tuple[Discrepant, Discrepant] | None:
        """A set with any discrepancy, and with one that its equations' error explains.

        Computed once, for as long as nothing that it follows from is another.
        """
        # The explained share hangs on what K, B and I leave, too.
        asked = self.found[keys], self.found[()], nested
        if asked not in self._inexact:
            try:
                found = discrepancies.inexact(self.found[keys], self._tolerated(keys), nested)
            except (ValueError, np.linalg.LinAlgError) as error:
                self.failures[f"{'+'.join(keys)} and a discrepancy"] = str(error)
                return None
            self._inexact[asked] = found
        return self._inexact[asked]


def log_prior(n_effects: int, every: int) -> float:
    """Log prior [nats] of one set of so many effects of `every`, but for a constant."""
    return -log(comb(every, min(n_effects, every)))


def _moved(one: Evaluated, other: Evaluated) -> float:
    """Root mean square [rad or Nm] of the difference of two models' predictions."""
    moved = [a[:, 0] - b[:, 0] for a, b in zip(one.raw, other.raw, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(moved) ** 2)))
