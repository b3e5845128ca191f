"""Probabilities of effect sets, "none of these" among them.

How many effects there are is as probable for every number from none to the most that are tried;
then every set of so many is, the unknown being one of the effects (Scott & Berger 2010, Ann Stat
38:2587-2619): trying more effects makes a false name no more likely. A set with a discrepancy of no
more than a tenth of what its effects explain, beyond what K, B and I do, is still that set, whose
equations are not exact; with more it is "none of these".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb, log

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.posterior.discrepancy import (
    Discrepancy,
    Discrepant,
    discrepancy_of,
)
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator

Keys = tuple[str, ...]

# Share of the response that is nothing unknown: instruments are linear to so much, and motion
# between samples is known to it.
_TRIFLE = 3e-3
_FORM = 0.1  # share of what its effects do, that a model's equations may be wrong by
_CONTENDS = 12.0  # nats that a set may be behind, for a discrepancy to be put beside it
_MOST_BESIDE, _BEST_OF_SIZE = 6, 2
_LOST = 60.0  # nats behind the best from which a set is not fitted any further
_SURE = 3.0  # nats by which values that no joint has must be better, to count
_SAME = 0.5  # nats by which two discrepancies of one size may differ


@dataclass(frozen=True, eq=False)
class SetProbability:
    """One set of effects.

    Attributes
    ----------
    effects : tuple of str or None
        Their keys in order; empty for none; ``None`` for none of these: something unknown, alone or
        beside known ones.
    probability : float
    log_evidence : float
        In nats, of the best form of the model, with its discrepancy where it needs one.
    """

    effects: tuple[str, ...] | None
    probability: float
    log_evidence: float


@dataclass(frozen=True, eq=False)
class Probabilities:
    """What is probable, of all that was tried.

    Attributes
    ----------
    rows : tuple of SetProbability
        The most probable first.
    best : tuple of str
        Effects of the most probable model; of "none of these", those beside which it is.
    values : dict of str to float
        Its parameters, by name, as fitted together with the noise.
    noise, response : float
        Root mean square of what it leaves, and of the response about its level [rad or Nm].
    discrepancy : Discrepant or None
        What the most probable set leaves, as a torque that nothing names; None where it could not
        be computed.
    unknown : tuple of str
        Of "none of these", the known effects beside which something unknown is most probable.
    candidates : mapping of tuple of str to Candidate
        Each set as it was weighed, or the fit that it was weighed from.
    failures : mapping of str to str
        Models that could not be evaluated, and why.
    """

    rows: tuple[SetProbability, ...]
    best: tuple[str, ...]
    values: Mapping[str, float]
    noise: float
    response: float
    discrepancy: Discrepant | None
    unknown: tuple[str, ...]
    candidates: Mapping[tuple[str, ...], Candidate]
    failures: Mapping[str, str] = field(default_factory=dict)

    def of(self, effects: Sequence[str] | None) -> float:
        """Probability of a set; 0 where it was not tried."""
        wanted = None if effects is None else tuple(sorted(effects))
        return sum(row.probability for row in self.rows if row.effects == wanted)

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return self.of(())

    @property
    def none_of_these(self) -> float:
        """Probability that something is missing which no known effect is."""
        return self.of(None)

    def claim(self, sets: Sequence[Sequence[str]]) -> float:
        """Probability that each of some sets of alternatives holds an effect that is there.

        Parameters
        ----------
        sets : sequence of sequence of str
            For each effect that is claimed all that it may be.
        """
        return sum(
            row.probability
            for row in self.rows
            if row.effects and _matched(row.effects, [set(s) for s in sets])
        )

    def credible(self, share: float = 0.95) -> tuple[SetProbability, ...]:
        """The fewest rows that together have at least this probability."""
        total, out = 0.0, []
        for row in self.rows:
            if total >= share:
                break
            out.append(row)
            total += row.probability
        return tuple(out)


def _moved(one: Evaluated, other: Evaluated) -> float:
    """Root mean square [rad or Nm] of the difference of two models' predictions."""
    moved = [a[:, 0] - b[:, 0] for a, b in zip(one.raw, other.raw, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(moved) ** 2)))


def _matched(effects: Sequence[str], sets: Sequence[set[str]]) -> bool:
    """Whether every set can be given an effect of its own."""
    if not sets:
        return True
    first, *rest = sets
    return any(
        _matched([e for e in effects if e != effect], rest) for effect in effects if effect in first
    )


@dataclass(eq=False)
class Weighing:
    """Evaluates candidates as they come, and puts them together.

    Attributes
    ----------
    evaluator : Evaluator
    n_library : int
        Number of effects that could be tried.
    """

    evaluator: Evaluator
    n_library: int
    found: dict[Keys, Evaluated] = field(default_factory=dict)
    candidates: dict[Keys, Candidate] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    def weigh(self, candidate: Candidate, base: Sequence[str] = ()) -> Evaluated | None:
        """Evaluate a fitted model; of the forms of one set the best is kept.

        Parameters
        ----------
        candidate : Candidate
        base : sequence of str
            Effects of the model that the search starts from: they are no findings.
        """
        keys = tuple(sorted(k for k in candidate.keys if k not in base))
        if candidate.failure:
            self.failures["+".join(keys)] = candidate.failure
            return None
        try:
            found = self.evaluator.evaluate(
                candidate.model,
                [candidate.values] if candidate.thorough else candidate.reached,
                refined=candidate.refined,
                scheme=candidate.scheme,
                least=max((f.log_evidence for f in self.found.values()), default=-np.inf) - _LOST,
            )
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            self.failures["+".join(keys)] = str(error)
            return None
        # Where an imposed angle moves the joint, parameters may lie anywhere on a ridge.
        if not self.evaluator.band.angle_imposed and (why := found.model.objection(found.values)):
            self.failures["+".join(keys)] = why
            return None
        if not candidate.thorough:
            candidate = replace(candidate, values=found.values, reached=(found.values,))
        known = self.found.get(keys)
        if known is None or found.log_evidence > known.log_evidence:
            self.found[keys], self.candidates[keys] = found, candidate
        return found

    def take_up(self, keys: Keys) -> None:
        """Evaluate a set further, from where its fit ended."""
        known = self.found[keys]
        try:
            found = self.evaluator.evaluate(
                known.model, [known.values], refined=known.refined, scheme=known.scheme
            )
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            return  # what is known stays
        if found.log_evidence > known.log_evidence:
            near = replace(self.candidates[keys], values=found.values, reached=(found.values,))
            self.found[keys], self.candidates[keys] = found, near

    def log_prior(self, n_effects: int) -> float:
        """Of one set of so many effects, the unknown counted as one of the library."""
        return -log(comb(self.n_library + 1, min(n_effects, self.n_library + 1)))

    def score(self, keys: Keys) -> float:
        """Log evidence and log prior [nats] of a set whose equations are exact."""
        return self.found[keys].log_evidence + self.log_prior(len(keys))

    def posterior(self) -> Probabilities:
        """Probabilities of all that was weighed."""
        ranked = sorted(self.found, key=lambda keys: -self.score(keys))
        best = self.found[ranked[0]]
        discrepancies = discrepancy_of(self.evaluator, best)
        exact = {k: self.score(k) for k in self.found}
        unknown, beside = dict[Keys, float](), dict[Keys, Discrepant]()
        inexact: dict[Keys, float] = {}
        near = [k for k in ranked if exact[k] > exact[ranked[0]] - _CONTENDS][:_MOST_BESIDE]
        # The best of every size too: inexact equations may make up for an effect more.
        for n in sorted({len(keys) for keys in ranked}):
            near += [keys for keys in ranked if len(keys) == n][:_BEST_OF_SIZE]
        for keys in dict.fromkeys(near):
            if self.found[keys].beyond > _SURE and exact[keys] > exact[ranked[0]] - _CONTENDS:
                # The same effects with values that no joint has are none of these. By how much more
                # probable is not known far from what was fitted.
                more = self.found[keys].log_evidence + self.found[keys].beyond
                unknown[keys] = more + self.log_prior(len(keys) + 1)
            one = self._beside(discrepancies, keys)
            if one is None:
                continue
            free, form = one
            beside[keys] = free
            if free.kind == "none":
                continue  # a discrepancy of no size is none
            # One that the equations' error explains is not something unknown besides.
            if form.log_evidence < free.log_evidence - _SAME:
                besides = free.log_evidence + self.log_prior(len(keys) + 1)
                unknown[keys] = max(besides, unknown.get(keys, -np.inf))
            inexact[keys] = form.log_evidence
        named = self._named(inexact)
        top = max([*named.values(), *unknown.values()])
        weights = {k: np.exp(v - top) for k, v in named.items()}
        of_unknown = {k: np.exp(v - top) for k, v in unknown.items()}
        total = sum(weights.values()) + sum(of_unknown.values())
        rows = [
            SetProbability(k, float(w / total), named[k] - self.log_prior(len(k)))
            for k, w in weights.items()
        ]
        first = max(of_unknown, key=lambda k: of_unknown[k], default=())
        rows.append(
            SetProbability(
                None,
                float(sum(of_unknown.values()) / total),
                max((d.log_evidence for d in beside.values()), default=-np.inf),
            )
        )
        rows.sort(key=lambda row: -row.probability)
        chosen = next((r.effects for r in rows if r.effects is not None), ())
        assert chosen is not None
        shown = first if rows[0].effects is None else chosen
        return Probabilities(
            tuple(rows),
            shown,
            self.found[shown].values,
            self.found[shown].weights.estimate.rms,
            self.evaluator.band.scale,
            beside.get(shown),
            first,
            dict(self.candidates),
            dict(self.failures),
        )

    def _named(self, inexact: Mapping[Keys, float]) -> dict[Keys, float]:
        """Log of what is proportional to the probability of each set, its equations exact or not.

        Equations that are wrong by so little as `_FORM` may be mended by an effect that is not
        there: then a set and the same with that effect are both what the data would look like.
        """
        every = self.n_library + 1
        found: dict[Keys, float] = {}
        for keys in sorted(self.found, key=len, reverse=True):
            exact = self.found[keys].log_evidence
            mended = [inexact[keys]] if keys in inexact else []
            for more, value in found.items():
                if len(more) == len(keys) + 1 and set(keys) < set(more) and self._mends(keys, more):
                    mended.append(value - log(every))
            # As probable as that the equations are exact.
            found[keys] = float(np.logaddexp.reduce([exact, *mended])) - log(2) * bool(mended)
        return {keys: value + self.log_prior(len(keys)) for keys, value in found.items()}

    def _mends(self, keys: Keys, more: Keys) -> bool:
        """Whether one effect more does no more than the error of a set's equations may be."""
        fewer, richer = self.found[keys], self.found[more]
        return _moved(fewer, richer) <= _FORM * self._explained(fewer)

    def _explained(self, found: Evaluated) -> float:
        """What effects explain: root mean square by which the prediction moves because of them.

        From that of K, B and I alone, so that what K, B and I do as well, and effects that cancel
        each other, do not count.
        """
        return _moved(self.found[()], found)

    def _beside(
        self, discrepancies: Discrepancy, keys: Keys
    ) -> tuple[Discrepant, Discrepant] | None:
        """A set with any discrepancy, and with one that its equations' error explains."""
        found = self.found[keys]
        try:
            free = discrepancies.beside(found)
            scale = self.evaluator.band.scale
            most = max(_FORM * self._explained(found), _TRIFLE * scale)
            if free.size * scale <= most:
                return free, free
            return free, discrepancies.beside(found, most)
        except (ValueError, np.linalg.LinAlgError) as error:
            self.failures[f"{'+'.join(keys)} and a discrepancy"] = str(error)
            return None
