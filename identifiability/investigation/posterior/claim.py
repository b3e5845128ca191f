"""What the probabilities of effect sets allow to name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.rules import Rules
from identifiability.joint.effects import Effect

_MOST_OF_ONE = 3  # effects of which one is there
# Probability above which an effect that is not claimed is a clue. What may only mend the equations
# of what is claimed has half or more, what the data do not ask for a few percent.
_LIKELY = 0.4
_WORTH_SAYING = 0.05  # probability from which an effect is said to be in the place of a clue


@dataclass(frozen=True)
class Claim:
    """What is claimed, of all that is probable.

    Attributes
    ----------
    kind : {"effects", "nothing", "unknown", "undecided", "noise"}
        Effects are there; nothing is missing, or it cannot be excluded; something is missing that
        is no known effect, or that cannot be excluded; effects are there, but no one of them is
        sure enough; most of the response is noise to the most probable model, so that nothing is
        said.
    effects : tuple of str
        Of the model that the claim is shown by: those that are claimed and, as a clue, what is
        likely there beside them; of effects that are not sure enough, or that
        something unknown is beside, the most probable, as a clue. What is unknown often keeps one
        of them from being sure, and without it there is little to see.
    present : tuple of str
        Beside something unknown, the effects that are there whatever else is.
    sets : tuple of tuple of str
        For each effect that is there all that it could be, the most probable first; empty where
        none is claimed.
    probability : float
        That the claim is right; of "noise", the share of the response's energy that is.
    instead : tuple of str
        What may be in the place of a clue beside what is claimed, where it is likely that one of
        them is there, and of no one it is.
    """

    kind: Literal["effects", "nothing", "unknown", "undecided", "noise"]
    effects: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    probability: float
    present: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()

    def names(self, effect: str) -> bool:
        """Whether an effect is claimed, alone or as one of several."""
        return any(effect in names for names in self.sets)


def claim_of(
    posterior: Probabilities,
    library: Mapping[str, type[Effect]],
    share: float,
    most_noise: float = Rules.most_noise,
) -> Claim:
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
    most_noise : float
        Share of the response's energy that may be noise: see `Rules`.
    """
    rows = posterior.credible(share)
    if any(row.effects == () for row in rows):
        return Claim("nothing", (), (), posterior.nothing)
    if posterior.noise_share > most_noise:
        return Claim("noise", (), (), posterior.noise_share)
    if any(row.effects is None for row in rows):
        there = _beside(posterior, share)
        return Claim("unknown", posterior.unknown, (), posterior.none_of_these, there)
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
    likely, instead = _likely(posterior, sets[0], tuple(slots))
    return Claim("effects", (*slots, *likely), named, posterior.claim(named), (), tuple(instead))


def _likely(
    posterior: Probabilities, best: Sequence[str], claimed: Sequence[str]
) -> tuple[list[str], list[str]]:
    """What is likely there beside what is claimed, and what else it may be.

    Each effect of the most probable set that is likely; if none is, but one of several, the most
    probable of these, and the others.
    """
    likely = [e for e in best if e not in claimed and posterior.present(e) > _LIKELY]
    larger = [row for row in posterior.rows if row.effects and set(claimed) < set(row.effects)]
    if likely or sum(row.probability for row in larger) <= _LIKELY:
        return likely, []
    every = {e for row in larger for e in row.effects or () if e not in claimed}
    beside = sorted(every, key=lambda e: (-posterior.present(e), e))
    shown = next((e for e in beside if tuple(sorted((*claimed, e))) in posterior.sets), None)
    if shown is None:
        return [], []
    others = [e for e in beside if e != shown and posterior.present(e) >= _WORTH_SAYING]
    return [shown], others[: _MOST_OF_ONE - 1]


def _beside(posterior: Probabilities, share: float) -> tuple[str, ...]:
    """Effects that are there with a probability, whatever the unknown beside them is.

    They may stand for a part of it, so they are no claim; but no model does without them.
    """
    there = [e for e in posterior.unknown if posterior.present(e) >= share]
    subsets = (keys for n in range(len(there), 0, -1) for keys in combinations(there, n))
    return next((keys for keys in subsets if tuple(sorted(keys)) in posterior.sets), ())


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


def same_form(keys: Sequence[str], library: Mapping[str, type[Effect]]) -> bool:
    """Whether all effects of a set are of one mathematical form."""
    return all(k == keys[0] or k in library[keys[0]].equivalent for k in keys)
