"""What the findings allow to say, and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import effective_samples
from identifiability.investigation.search.equivalence import same_form
from identifiability.investigation.search.found import Found, Missing
from identifiability.investigation.search.gate import Ranked
from identifiability.investigation.search.smallest_seen import Detectable
from identifiability.investigation.split import Split
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.reasons import Reason
from identifiability.joint.effects import Effect

_NONE = 1e-6  # share of its usual value that is no stiffness or damping at all

Kind = Literal[
    "explained",
    "one_of",
    "unknown_static",
    "unknown_memory",
    "measurement",
    "unrepeatable",
    "nothing_missing",
]
KINDS: tuple[Kind, ...] = get_args(Kind)

# Effects of the measurement that a library-free kind speaks for, where none of them fits.
_SENSORS = {"drift": ("sensor_drift",), "sensor": ("sensor_delay", "sensor_lowpass")}

_UNKNOWN: dict[str, Kind] = {
    "static": "unknown_static",
    "hysteresis": "unknown_memory",
    "memory": "unknown_memory",
    "sensor": "measurement",
    "drift": "measurement",
    "unrepeatable": "unrepeatable",
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
        Share of the held-out misfit beyond the noise that the effects that were found remove.
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


def judge(
    split: Split,
    found: Found,
    rest: Unexplained,
    smallest_seen: Sequence[Detectable],
    library: Mapping[str, type[Effect]],
) -> Verdict:
    """Verdict on what a search found and what it left.

    Parameters
    ----------
    split : Split
    found : Found
    rest : Unexplained
        Library-free account of what the final model leaves.
    smallest_seen : sequence of Detectable
        Smallest effects that would have been seen beside the final model.
    library : mapping of str to type of Effect
    """
    reasons = [_errors(split, found), *_in_turn(found)]
    for missing in found.missing:
        reasons += _about(missing, found, split, library)
    reasons += [*_clue(found, split), *_at_bound(found.final)]
    quiet = _quiet(split, found.final, rest)
    if found.description is not None:
        reasons.append(_described(found, found.description))
        return Verdict("unknown_memory", (), tuple(reasons), found.share)
    if not found.missing:
        return _nothing_named(split, rest, quiet, reasons, smallest_seen)
    sets = tuple(m.could_be for m in found.missing)
    measured = all(library[k].place == "sensor" for names in sets for k in names)
    if not quiet and not _enough(split, found, measured):
        reasons.append(Reason("only a part"))
        named = found.share is not None and found.share >= split.rules.named_share
        return Verdict(_unknown(split, rest), sets if named else (), tuple(reasons), found.share)
    if not quiet:
        reasons.append(Reason("equations not exact"))
    kind: Kind = "one_of"
    if measured:
        kind = "measurement"
    elif all(same_form(names, library) for names in sets):
        kind = "explained"
    return Verdict(kind, sets, tuple(reasons), found.share)


def _nothing_named(
    split: Split,
    rest: Unexplained,
    quiet: bool,
    reasons: list[Reason],
    smallest_seen: Sequence[Detectable],
) -> Verdict:
    if quiet:
        seen = tuple(sorted(smallest_seen, key=lambda d: d.key))
        return Verdict("nothing_missing", (), tuple(reasons), None, seen)
    kind = _unknown(split, rest)
    if kind == "measurement":
        alike = _SENSORS[rest.best.kind]
        reasons.append(Reason("form of no sensor", alike))
        return Verdict(kind, (alike,), tuple(reasons))
    return Verdict(kind, (), tuple(reasons))


def _enough(split: Split, found: Found, measured: bool) -> bool:
    """Whether the effects remove enough of the misfit to be called the explanation."""
    rules, enough = split.rules, split.rules.named_share
    if split.has_noise:
        linear = found.final.model.linear and not measured
        enough = rules.linear_share if linear else rules.explained_share
    return found.share is None or found.share >= enough


def _quiet(split: Split, final: Candidate, rest: Unexplained) -> bool:
    """Whether the model leaves nothing that a library-free torque could explain."""
    floor = split.noise_floor()
    if floor is not None:
        chance = np.sqrt(2 / effective_samples(final.fitted))
        slack = 1 + 3 * max(split.floor_uncertainty(), chance)
        if final.fitted.error <= floor * slack and rest.share < split.rules.quiet_share:
            return True
    return rest.best.kind == "none"


def _unknown(split: Split, rest: Unexplained) -> Kind:
    """Kind of verdict where no effect that is known explains the misfit."""
    kind = rest.best.kind
    if kind in ("sensor", "drift") and (rest.noise_ratio or 1.0) > split.rules.enough_noise:
        # A filter of the recording leaves only noise; one that leaves more stands for something.
        kind = next((f.kind for f in rest.families if f.kind not in ("sensor", "drift")), kind)
    return _UNKNOWN[kind]


def _errors(split: Split, found: Found) -> Reason:
    numbers = {"before": found.baseline.fitted.error, "after": found.final.fitted.error}
    if found.baseline.held_out.by_trial:
        numbers["held_out_before"] = found.baseline.held_out.error
        numbers["held_out_after"] = found.final.held_out.error
    floor = split.noise_floor()
    if floor is not None:
        numbers["floor"] = floor
    return Reason("errors", (), numbers)


def _in_turn(found: Found) -> list[Reason]:
    """What each of several effects removes, in the order of the error ladder."""
    shares = {m.key: m.share for m in found.missing if m.share is not None}
    if len(found.missing) < 2 or len(shares) < len(found.missing):
        return []
    return [Reason("removes in turn", tuple(shares), shares)]


def _about(
    missing: Missing, found: Found, split: Split, library: Mapping[str, type[Effect]]
) -> list[Reason]:
    """Why an effect is named, and others are or are not named with it."""
    name, decisive = missing.name, split.rules.decisive
    out = []
    rivals = sorted(
        (
            r
            for r in missing.rivals
            if r.key not in missing.could_be and np.isfinite(r.evidence) and not r.caveat
        ),
        key=lambda r: -r.evidence,
    )
    if rivals and rivals[0].evidence > -decisive and name in library[rivals[0].key].refines:
        out.append(Reason("richer form not needed", (rivals.pop(0).key, name)))
    if rivals:
        worse = {"evidence": -rivals[0].evidence}
        out.append(Reason("next best", (rivals[0].key, name), worse))
    out += [_caveat(r, name) for r in missing.rivals if r.caveat and r.evidence > -decisive]
    if split.driven == "torque" and (doubt := missing.effect.doubt(found.final.values)):
        out.append(Reason("doubt", (missing.key,), {}, doubt))
    better = [r.key for r in missing.equals if r.evidence > decisive]
    if better and not split.has_noise:
        out.append(Reason("more parameters", (better[0], name)))
    same = tuple(k for k in missing.could_be[1:] if k in library[name].equivalent)
    if same:
        out.append(Reason("same form", (name, *same)))
    later = [r.key for r in missing.equals if r.refitted is not None and r.key not in missing.near]
    if later:
        out.append(Reason("only prediction worse", (name, *later)))
    near = [
        r.key
        for r in missing.equals
        if r.key in missing.near and abs(r.evidence) > decisive and r.key not in same
    ]
    if near and split.has_noise:
        out.append(Reason("equations hide", (name, *near), {"form": split.rules.form}))
    return out


def _caveat(rival: Ranked, instead_of: str) -> Reason:
    kind: Literal["objection", "doubt"] = "objection" if rival.objection else "doubt"
    numbers = {"evidence": rival.evidence}
    return Reason(kind, (rival.key, instead_of), numbers, rival.caveat)


def _clue(found: Found, split: Split) -> list[Reason]:
    """What would lower the error a little more, and is not named."""
    last = found.rankings[-1] if found.rankings else None
    if last is None or last.before is not found.final:
        return []
    for r in last.ranked:
        unmoved = r.refusal == "disagrees" and abs(r.held_out_gain) < split.rules.unmoved
        if unmoved or r.refusal in ("only mends", "too little", "objection"):
            numbers = {"error": r.candidate.fitted.error, **r.own_values}
            if r.candidate.held_out.by_trial:
                numbers["held_out"] = r.candidate.held_out.error
            why = r.objection if r.refusal == "objection" else r.refusal
            return [Reason("clue", (r.key,), numbers, why)]
    return []


def _at_bound(final: Candidate) -> list[Reason]:
    """Which of K, B and I lies at a bound; that it may be none at all is no bound."""
    return [
        Reason("edge of bounds", (), {"value": final.values[name]}, name)
        for name in ("K", "B", "I")
        if name in final.at_bound
        and final.values[name] > _NONE * final.model.parameters[name].nominal
    ]


def _described(found: Found, description: Ranked) -> Reason:
    replaced = [m.key for m in found.replaced_by(description)]
    rival = description.candidate
    numbers = {"error": rival.fitted.error, "evidence": description.evidence}
    if rival.held_out.by_trial:
        numbers["held_out"] = rival.held_out.error
    return Reason("description", (description.key, *replaced), numbers)
