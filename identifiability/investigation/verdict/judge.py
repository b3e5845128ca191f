"""What the findings allow to say, and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.ladder.found import Found, Missing
from identifiability.investigation.posterior.claim import Claim, same_form
from identifiability.investigation.posterior.discrepancy import Discrepant
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.smallest_seen.detectable import Detectable
from identifiability.investigation.split import Split
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.reasons import Reason
from identifiability.joint.effects import Effect

_NONE = 1e-6  # share of its usual value that is no stiffness or damping at all
_SHARE = 0.2  # of what differs between trials, from which one torque for all is spoken of
_LEAST = 1e-300  # of a probability that is divided by
_LISTED = 3  # sets whose probabilities are said

Kind = Literal[
    "explained",
    "one_of",
    "unknown_static",
    "unknown_memory",
    "measurement",
    "unrepeatable",
    "nothing_missing",
    "undecided",
]
KINDS: tuple[Kind, ...] = get_args(Kind)

# Kinds of verdict by the kind of torque that nothing names. What only looks like a filter or a
# drift of the recorder may be the joint's: it is not said to be the measurement.
_UNKNOWN: dict[str, Kind] = {
    "static": "unknown_static",
    "hysteresis": "unknown_memory",
    "memory": "unknown_memory",
    "sensor": "unknown_memory",
    "drift": "unrepeatable",
    "unrepeatable": "unrepeatable",
    "varying": "unrepeatable",
    "none": "unrepeatable",
}


@dataclass(frozen=True)
class Verdict:
    """What is missing from the baseline model.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    sets : tuple of tuple of str
        For each missing effect all that could be it, best name first; empty where none is named.
    reasons : tuple of Reason
    share : float or None
        Share of the held-out misfit beyond the noise that the final model's effects remove.
    smallest_seen : tuple of Detectable
        Where nothing is missing, the smallest effects that would have been seen.
    """

    kind: Kind
    sets: tuple[tuple[str, ...], ...]
    reasons: tuple[Reason, ...] = ()
    share: float | None = None
    smallest_seen: tuple[Detectable, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Best name for each missing effect."""
        return tuple(names[0] for names in self.sets)

    @property
    def clues(self) -> Mapping[str, float]:
        """Effects that the error is shown to fall with and that are not named: probabilities."""
        return next((r.numbers for r in self.reasons if r.kind == "clue"), {})

    @property
    def instead_of_clue(self) -> Mapping[str, float]:
        """Effects that may be in the place of the clue: probabilities."""
        return next((r.numbers for r in self.reasons if r.kind == "instead of the clue"), {})

    def names(self, effect: str) -> bool:
        """Whether an effect is named, alone or as one of several."""
        return any(effect in names for names in self.sets)


UNDECIDED = Verdict("undecided", ())
"""Where nothing could be weighed."""


def judge(
    split: Split,
    posterior: Probabilities,
    claim: Claim,
    found: Found,
    rest: Unexplained,
    smallest_seen: Sequence[Detectable],
    library: Mapping[str, type[Effect]],
    nested: Probabilities | None = None,
) -> Verdict:
    """Verdict on what is probable, and on how the errors of its model fall.

    Parameters
    ----------
    split : Split
    posterior : Probabilities
    claim : Claim
        What they allow to name.
    found : Found
        The model that the claim is shown by, effect by effect.
    rest : Unexplained
        Library-free account of what that model leaves.
    smallest_seen : sequence of Detectable
        Smallest effects that would have been seen, where nothing is missing.
    library : mapping of str to type of Effect
    nested : Probabilities, optional
        Of the sets that came near, by the trials that are not held out alone.
    """
    if claim.kind == "noise":
        noise = Reason("mostly noise", (), {"share": claim.probability})
        return Verdict("undecided", (), (noise, _errors(split, found)))
    explains = found.share is None or found.share >= split.rules.explained_share
    named = claim.kind == "effects" and explains
    reasons = [_probabilities(claim, posterior)]
    sure = tuple(key for key in claim.effects if claim.names(key))
    if claim.kind == "effects" and found.failure:
        # An effect is named for the error that falls with it, which is not known here.
        reasons.append(Reason("no error", sure, {}, found.failure))
        return Verdict("undecided", (), tuple(reasons))
    if claim.kind == "effects" and not explains:
        reasons.append(Reason("only a part", sure))
    shown = {m.key: posterior.present(m.key) for m in found.missing}
    there = {effect: shown[effect] for effect in claim.present if effect in shown}
    if there:
        reasons.append(Reason("whatever else", tuple(there), there))
    no_clue = sure if named else there
    clues = {effect: p for effect, p in shown.items() if effect not in no_clue}
    reasons += [Reason("clue", tuple(clues), clues)] if clues else []
    if clues and claim.instead:
        instead = {effect: posterior.present(effect) for effect in claim.instead}
        reasons.append(Reason("instead of the clue", tuple(instead), instead))
    if claim.kind == "unknown" and posterior.description is not None:
        reasons.append(Reason("nearest form", (posterior.description,)))
    reasons.append(_errors(split, found))
    if found.nearest is not None:
        reasons.append(_nearest(found.nearest, found.baseline, posterior))
    if nested is not None and claim.kind == "effects":
        reasons.append(_without_held_out(claim, nested, split))
    reasons += _in_turn(found)
    for missing in found.missing:
        if named and missing.key in sure:
            reasons += _about(missing, found, split, library)
    if named and (left := posterior.discrepancy) is not None and left.kind != "none":
        # No more than is left: the rest parameters and the noise's colour take back.
        share = min(left.size, posterior.noise / posterior.response)
        size = {"size": share * posterior.response, "share": share}
        reasons.append(Reason("equations not exact", (), size))
    reasons += _at_bound(found.final)
    if claim.kind == "nothing":
        seen = tuple(sorted(smallest_seen, key=lambda d: d.key))
        return Verdict("nothing_missing", (), tuple(reasons), None, seen)
    if named:
        return Verdict(_named(claim.sets, library), claim.sets, tuple(reasons), found.share)
    # By one description that has memory; otherwise by what the final model leaves.
    described = claim.kind == "unknown" and posterior.description is not None
    kind = "unknown_memory" if described else _unknown(rest, posterior.discrepancy)
    return Verdict(kind, (), tuple(reasons), found.share)


def _named(sets: Sequence[Sequence[str]], library: Mapping[str, type[Effect]]) -> Kind:
    """Kind of verdict that names effects."""
    if all(library[name].place == "sensor" for names in sets for name in names):
        return "measurement"
    return "explained" if all(same_form(names, library) for names in sets) else "one_of"


def _unknown(rest: Unexplained, discrepancy: Discrepant | None) -> Kind:
    """Kind of a torque that nothing names: one for all trials, as far as there is one."""
    if rest.best.kind != "none" or discrepancy is None:
        return _UNKNOWN[rest.best.kind]
    sizes = dict(discrepancy.sizes)
    differs = max(sizes.pop("inconstant", 0.0), sizes.pop("unrepeatable", 0.0))
    largest = max(sizes, key=lambda kind: sizes[kind], default="static")
    return "unrepeatable" if sizes.get(largest, 0.0) < _SHARE * differs else _UNKNOWN[largest]


def _probabilities(claim: Claim, posterior: Probabilities) -> Reason:
    """How probable what is said is; where nothing is named, also the most probable sets."""
    numbers = {
        "probability": claim.probability,
        "nothing": posterior.nothing,
        "unknown": posterior.none_of_these,
    }
    if claim.kind == "effects":
        names = dict.fromkeys(name for names in claim.sets for name in names)
        return Reason("probable", tuple(names), numbers)
    likely = {"+".join(row.effects): row for row in posterior.rows[:_LISTED] if row.effects}
    numbers |= {keys: row.probability for keys, row in likely.items()}
    return Reason("not probable enough", tuple(likely), numbers, claim.kind)


def _errors(split: Split, found: Found) -> Reason:
    numbers = {"before": found.baseline.fitted.error, "after": found.final.fitted.error}
    if found.baseline.held_out.by_trial:
        numbers["held_out_before"] = found.baseline.held_out.error
        numbers["held_out_after"] = found.final.held_out.error
    floor = split.noise_floor()
    if floor is not None:
        numbers["floor"] = floor
    return Reason("errors", (), numbers)


def _nearest(nearest: Candidate, baseline: Candidate, posterior: Probabilities) -> Reason:
    """How near known effects come to something unknown."""
    keys = tuple(sorted(set(nearest.keys) - set(baseline.keys)))
    odds = posterior.none_of_these / max(posterior.of(keys), _LEAST)
    numbers = {"behind": float(np.log(odds)), "after": nearest.fitted.error}
    if nearest.held_out.by_trial:
        numbers["held_out_after"] = nearest.held_out.error
    return Reason("nearest known", keys, numbers)


def _without_held_out(claim: Claim, nested: Probabilities, split: Split) -> Reason:
    """How probable what is claimed is by the trials that are not held out."""
    probability = nested.claim(claim.sets)
    alike = probability >= split.rules.claimed
    return Reason("chosen alike" if alike else "chosen with", (), {"probability": probability})


def _in_turn(found: Found) -> list[Reason]:
    """What each of several effects removes, in the order of the error ladder."""
    shares = {m.key: m.share for m in found.missing if m.share is not None}
    if len(found.missing) < 2 or len(shares) < len(found.missing):
        return []
    return [Reason("removes in turn", tuple(shares), shares)]


def _about(
    missing: Missing, found: Found, split: Split, library: Mapping[str, type[Effect]]
) -> list[Reason]:
    """What is next best to an effect, what is of its form, and what its values say against it."""
    name, out = missing.name, []
    others = [r for r in missing.rivals if r.key not in missing.could_be]
    if others:
        numbers = {"evidence": -others[0].evidence, "probability": others[0].probability}
        out.append(Reason("next best", (others[0].key, name), numbers))
    if split.driven == "torque" and (doubt := missing.effect.doubt(found.final.values)):
        out.append(Reason("doubt", (missing.key,), {}, doubt))
    same = tuple(k for k in missing.could_be[1:] if k in library[name].equivalent)
    if same:
        out.append(Reason("same form", (name, *same)))
    return out


def _at_bound(final: Candidate) -> list[Reason]:
    """Which of K, B and I lies at a bound; that it may be none at all is no bound."""
    return [
        Reason("edge of bounds", (), {"value": final.values[name]}, name)
        for name in ("K", "B", "I")
        if name in final.at_bound
        and final.values[name] > _NONE * final.model.parameters[name].nominal
    ]
