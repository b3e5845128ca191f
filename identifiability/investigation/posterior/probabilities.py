"""Probabilities of effect sets, "none of these" among them: what a weighing found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.posterior.discrepancy import Discrepant


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
class WeighedSet:
    """One set of effects as it was weighed, in the best form of its model.

    Attributes
    ----------
    candidate : Candidate
        Its values, as fitted together with the noise; to be fitted from there.
    log_evidence : float
        In nats, its equations taken to be exact.
    error : float
        Share of the response's energy that it leaves, of all trials in the compared band.
    sds : mapping of str to float
        Standard deviations of the free parameters by the curvature of the posterior; 0 at a bound.
    """

    candidate: Candidate
    log_evidence: float
    error: float
    sds: Mapping[str, float] = field(default_factory=dict)


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
    beside_unknown : mapping of tuple of str to float
        Probability of each set of known effects and something unknown besides; together that of
        "none of these".
    description : str or None
        Key of the description that something unknown comes nearest to; None where it is of another
        form.
    sets : mapping of tuple of str to WeighedSet
        Each set that was weighed, its keys in order.
    samples : tuple of int
        Number of samples that were compared, and of those that were recorded in that band.
    failures : mapping of str to str
        Models that could not be evaluated, and why.
    screened : mapping of tuple of str to float
        Sets that were begun by a part of a long record's samples and not weighed by all, and how
        many nats each was behind the best of as many effects there.
    """

    rows: tuple[SetProbability, ...]
    best: tuple[str, ...]
    values: Mapping[str, float]
    noise: float
    response: float
    discrepancy: Discrepant | None
    unknown: tuple[str, ...]
    beside_unknown: Mapping[tuple[str, ...], float]
    description: str | None
    sets: Mapping[tuple[str, ...], WeighedSet]
    samples: tuple[int, int]
    failures: Mapping[str, str] = field(default_factory=dict)
    screened: Mapping[tuple[str, ...], float] = field(default_factory=dict)

    def of(self, effects: Sequence[str] | None) -> float:
        """Probability of a set; 0 where it was not tried."""
        wanted = None if effects is None else tuple(sorted(effects))
        return sum(row.probability for row in self.rows if row.effects == wanted)

    @property
    def noise_share(self) -> float:
        """Share of the response's energy that is noise to the most probable model."""
        return (self.noise / self.response) ** 2

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return self.of(())

    @property
    def none_of_these(self) -> float:
        """Probability that something is missing which no known effect is."""
        return self.of(None)

    def present(self, effect: str) -> float:
        """Probability that an effect is there, whatever else is, something unknown included."""
        named = sum(row.probability for row in self.rows if effect in (row.effects or ()))
        return named + sum(p for keys, p in self.beside_unknown.items() if effect in keys)

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


def _matched(effects: Sequence[str], sets: Sequence[set[str]]) -> bool:
    """Whether every set can be given an effect of its own."""
    if not sets:
        return True
    first, *rest = sets
    return any(
        _matched([e for e in effects if e != effect], rest) for effect in effects if effect in first
    )
