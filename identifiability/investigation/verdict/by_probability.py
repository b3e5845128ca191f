"""What the probabilities of effect sets allow to name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

from identifiability.investigation.posterior.discrepancy import Discrepant
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.search.equivalence import same_form
from identifiability.investigation.search.smallest_seen import Detectable
from identifiability.investigation.verdict.judge import Kind, Verdict
from identifiability.investigation.verdict.reasons import Reason
from identifiability.joint.effects import Effect

# Kinds of verdict by the kind of torque that nothing names.
_UNKNOWN: dict[str, Kind] = {
    "static": "unknown_static",
    "hysteresis": "unknown_memory",
    "memory": "unknown_memory",
    "varying": "unrepeatable",
    "drift": "measurement",
    "sensor": "measurement",
}
_MOST_OF_ONE = 3  # effects of which one is there
_SHARE = 0.2  # of what differs between trials, from which one torque for all is spoken of


@dataclass(frozen=True)
class Claim:
    """What is claimed, of all that is probable.

    Attributes
    ----------
    kind : {"effects", "nothing", "unknown", "undecided"}
        Effects are there; nothing is missing, or it cannot be excluded; something is missing that
        is no known effect, or that cannot be excluded; effects are there, but no one of them is
        sure enough.
    effects : tuple of str
        Of the most probable of the models that the claim speaks of; beside something unknown, those
        that are there whatever else is.
    sets : tuple of tuple of str
        For each effect that is there all that it could be, the most probable first; empty where
        none is claimed.
    probability : float
        That the claim is right.
    """

    kind: Literal["effects", "nothing", "unknown", "undecided"]
    effects: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    probability: float


def claim_of(posterior: Probabilities, library: Mapping[str, type[Effect]], share: float) -> Claim:
    """The most that can be named with a probability.

    Nothing where that nothing is missing, or that it is something unknown, is among what together
    has this probability. Otherwise each effect of the most probable set, with what stands in its
    place in the others, and with what is of the same form; an effect in whose place others have
    nothing, or more than one thing, is not claimed. If none can be, the two or three effects of
    which one is surely there.

    Parameters
    ----------
    posterior : Probabilities
    library : mapping of str to type of Effect
    share : float
        Such as 0.95.
    """
    rows = posterior.credible(share)
    if any(row.effects == () for row in rows):
        return Claim("nothing", (), (), posterior.nothing)
    if any(row.effects is None for row in rows):
        return Claim("unknown", _beside(posterior, share), (), posterior.none_of_these)
    sets = [row.effects or () for row in rows]
    slots = {effect: [effect] for effect in sets[0]}
    for other in sets[1:]:
        gone = [effect for effect in slots if effect not in other]
        instead = [effect for effect in other if effect not in sets[0]]
        if len(gone) == 1 and len(instead) == 1:
            slots[gone[0]] += [e for e in instead if e not in slots[gone[0]]]
        else:
            for effect in gone:
                del slots[effect]
    if not slots and (either := _one_of(posterior, sets, share)):
        slots = {next(e for e in either if e in sets[0]): list(either)}
    if not slots:
        return Claim("undecided", sets[0], (), posterior.of(sets[0]))
    named = tuple(_with_equals(names, library) for names in slots.values())
    return Claim("effects", tuple(slots), named, posterior.claim(named))


def _beside(posterior: Probabilities, share: float) -> tuple[str, ...]:
    """Effects that are there with a probability, whatever the unknown beside them is.

    They may stand for a part of it, so they are no claim; but no model does without them.
    """
    there = [e for e in posterior.unknown if posterior.present(e) >= share]
    subsets = (keys for n in range(len(there), 0, -1) for keys in combinations(there, n))
    return next((keys for keys in subsets if tuple(sorted(keys)) in posterior.candidates), ())


def _one_of(
    posterior: Probabilities, sets: Sequence[Sequence[str]], share: float
) -> tuple[str, ...]:
    """Two or three effects of which at least one is there, if just one choice of them is sure."""
    every = dict.fromkeys(effect for effects in sets for effect in effects)
    for n in range(2, _MOST_OF_ONE + 1):
        sure = [names for names in combinations(every, n) if posterior.claim([names]) >= share]
        if sure:
            return sure[0] if len(sure) == 1 else ()
    return ()


def _with_equals(names: Sequence[str], library: Mapping[str, type[Effect]]) -> tuple[str, ...]:
    """Names, with those of the same form."""
    alike = [e for name in names for e in library[name].equivalent if e in library]
    return tuple(dict.fromkeys([*names, *alike]))


def by_probability(
    verdict: Verdict,
    claim: Claim,
    posterior: Probabilities,
    smallest_seen: Sequence[Detectable],
    library: Mapping[str, type[Effect]],
) -> Verdict:
    """A verdict that names no more than is claimed.

    Parameters
    ----------
    verdict : Verdict
        On what was found, with the claimed effects as the final model.
    claim : Claim
    posterior : Probabilities
    smallest_seen : sequence of Detectable
        Smallest effects that would have been seen, where nothing is missing.
    library : mapping of str to type of Effect
    """
    numbers = {
        "probability": claim.probability,
        "nothing": posterior.nothing,
        "unknown": posterior.none_of_these,
    }
    names = tuple(dict.fromkeys(name for names in claim.sets for name in names))
    reasons = verdict.reasons
    # Effects that leave much of the misfit on trials that were not fitted may stand for something
    # else.
    if claim.kind == "effects" and any(r.kind == "only a part" for r in reasons):
        return verdict
    reasons = tuple(r for r in reasons if r.kind != "only a part")
    if claim.kind == "effects":
        kind: Kind = "one_of"
        if all(library[name].place == "sensor" for name in names):
            kind = "measurement"
        elif all(same_form(one, library) for one in claim.sets):
            kind = "explained"
        sure = Reason("probable", names, numbers)
        return replace(verdict, kind=kind, sets=claim.sets, reasons=(sure, *reasons))
    rows = posterior.rows[:3]
    likely = tuple("+".join(row.effects or ()) for row in rows if row.effects)
    numbers |= {"+".join(row.effects): row.probability for row in rows if row.effects}
    unsure = Reason("not probable enough", likely, numbers, claim.kind)
    if claim.kind == "nothing":
        seen = tuple(sorted(smallest_seen, key=lambda d: d.key))
        return replace(
            verdict, kind="nothing_missing", sets=(), reasons=(unsure, *reasons), smallest_seen=seen
        )
    if claim.kind == "unknown" and claim.effects:
        there = {effect: posterior.present(effect) for effect in claim.effects}
        reasons = (Reason("whatever else", claim.effects, there), *reasons)
    kind = verdict.kind
    if kind in ("explained", "one_of", "nothing_missing"):
        kind = _unknown(posterior.discrepancy)
    if claim.kind == "unknown" and posterior.description is not None:
        # All of them have memory.
        kind, nearest = "unknown_memory", Reason("nearest form", (posterior.description,))
        return replace(verdict, kind=kind, sets=(), reasons=(unsure, nearest, *reasons))
    return replace(verdict, kind=kind, sets=(), reasons=(unsure, *reasons))


def _unknown(discrepancy: Discrepant | None) -> Kind:
    """Kind of a torque that nothing names: one for all trials, as far as there is one."""
    sizes = {} if discrepancy is None else dict(discrepancy.sizes)
    differs = max(sizes.pop("inconstant", 0.0), sizes.pop("unrepeatable", 0.0))
    largest = max(sizes, key=lambda kind: sizes[kind], default="static")
    return "unrepeatable" if sizes.get(largest, 0.0) < _SHARE * differs else _UNKNOWN[largest]
