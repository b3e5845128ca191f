"""Sets of effects weighed by several records of one joint."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import comb, log

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.probabilities import WeighedSet
from identifiability.investigation.session import Investigation, evaluations_of
from identifiability.progress import Progress, silent

_NEAREST = 12  # sets of each record that are weighed in all


@dataclass(frozen=True)
class SetAcross:
    """A set of effects, by all records.

    Attributes
    ----------
    effects : tuple of str
    probability : float
        Among the sets that came near in any record.
    log_evidence : float
        Of all records [nats], above that of K, B and I alone.
    by_record : dict of str to float
        The same of each.
    """

    effects: tuple[str, ...]
    probability: float
    log_evidence: float
    by_record: dict[str, float]


def weigh_across(
    records: Mapping[str, Investigation], *, seed: int = 1, progress: Progress = silent
) -> tuple[SetAcross, ...]:
    """Weigh sets of effects by several records of one joint: what one hides another may show.

    Every record is investigated by itself. The sets that came near in any are then weighed in all,
    each with its own parameters and noise, and their evidence is added up.

    Parameters
    ----------
    records : mapping of str to Investigation
        By name.
    seed : int
    progress : callable
        Told ``(what, done, total)``.

    Returns
    -------
    tuple of SetAcross
        The most probable first.

    Raises
    ------
    InputError
        Where a record cannot be weighed.
    """
    found = {}
    for i, (name, study) in enumerate(records.items()):
        progress(f"investigating {name}", i, len(records))
        found[name] = study.weigh(seed=seed).sets
    near: dict[tuple[str, ...], None] = {(): None}
    for sets in found.values():
        ranked = sorted(sets, key=lambda keys: -sets[keys].log_evidence)
        near |= dict.fromkeys(ranked[:_NEAREST])
    evidence: dict[tuple[str, ...], dict[str, float]] = {}
    for i, keys in enumerate(near):
        progress("weighing in all records", i, len(near))
        evidence[keys] = {
            name: _evidence(study, found[name], keys, found.values(), seed)
            for name, study in records.items()
        }
    library = next(iter(records.values())).library
    score = {
        keys: sum(by.values()) - log(comb(len(library) + 1, len(keys)))
        for keys, by in evidence.items()
    }
    top = max(score.values())
    total = sum(np.exp(value - top) for value in score.values())
    rows = []
    for keys in sorted(score, key=lambda keys: -score[keys]):
        above = {name: value - evidence[()][name] for name, value in evidence[keys].items()}
        chance = float(np.exp(score[keys] - top) / total)
        rows.append(SetAcross(keys, chance, sum(above.values()), above))
    return tuple(rows)


def _evidence(
    study: Investigation,
    known: Mapping[tuple[str, ...], WeighedSet],
    keys: tuple[str, ...],
    others: Collection[Mapping[tuple[str, ...], WeighedSet]],
    seed: int,
) -> float:
    """Log evidence of a set in one record; from the values of other records where it is new."""
    if keys in known:
        return known[keys].log_evidence
    weighed = [sets[keys] for sets in others if keys in sets]
    model = weighed[0].candidate.model
    joint = {name: study.baseline.values[name] for name in ("K", "B", "I")}
    starts = [
        *starting_values(model, joint, wide=True),
        *(dict(one.candidate.values) for one in weighed),
    ]
    kept = evaluations_of(study, seed)
    try:
        with threadpool_limits(limits=1):
            found = kept.evaluate(model, starts)
            if forms := model.refinable(weighed[0].candidate.refined):
                richer = kept.evaluate(model, [found.values], refined=forms, nested=found)
                found = max(found, richer, key=lambda one: one.log_evidence)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError):
        return -np.inf  # what cannot be fitted explains nothing
    return found.log_evidence
