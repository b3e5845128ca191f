"""What the evidence allows to say, and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import effective_samples
from identifiability.investigation.search.equivalence import comes_near, equivalence_set, same_form
from identifiability.investigation.search.gate import (
    DECISIVE,
    DISAGREE,
    FORM,
    ONLY_MENDS,
    TOO_LITTLE,
    Ranked,
    does_as_well,
)
from identifiability.investigation.search.search import Search
from identifiability.investigation.search.smallest_seen import Detectable
from identifiability.investigation.split import Split
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.joint.effects.base import Effect

EXPLAINED_SHARE = 0.8
"""Share of the held-out misfit beyond the noise that named effects must remove to be called the
explanation: a convention. Equations are never exact, so the floor itself is not asked for."""
LINEAR_SHARE = 0.95
"""The same where all of them are linear effects of the joint: a linear relation has a scale and a
pace, but no shape that differs from muscle to muscle. Right to a fifth, it leaves 4 %."""
NAMED_SHARE = 0.5
"""The same where the noise is unknown, and with it the misfit beyond the noise; and the share from
which an effect that does not explain all is named at all."""
_TRACE = 0.01  # share of what is left, below which an account of it explains nothing
_UNMOVED = 0.05  # change of the logarithm of a held-out error that says nothing either way
_NONE = 1e-6  # share of its usual value that is no stiffness or damping at all
_ENOUGH_NOISE = 1.5  # times the quiet samples' noise, beyond which an explanation is not complete

KINDS = (
    "explained",
    "one_of",
    "unknown_static",
    "unknown_memory",
    "measurement",
    "unrepeatable",
    "nothing_missing",
)

# Effects of the measurement that a library-free kind speaks for, where none of them fits.
_SENSORS = {"drift": ("sensor_drift",), "sensor": ("sensor_delay", "sensor_lowpass")}


@dataclass(frozen=True)
class Verdict:
    """What is missing from the baseline model.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    effects : tuple of str
        Best name for each missing effect; empty where none is known.
    equivalence_sets : tuple of tuple of str
        For each missing effect all that could be it.
    sentence : str
    because : tuple of str
        The evidence, a sentence each.
    share : float or None
        Share of the held-out misfit beyond the noise that the named effects remove.
    smallest_seen : tuple of Detectable
        Where nothing is missing, the smallest effects that would have been seen.
    """

    kind: str
    effects: tuple[str, ...]
    equivalence_sets: tuple[tuple[str, ...], ...]
    sentence: str
    because: tuple[str, ...] = ()
    share: float | None = None
    smallest_seen: tuple[Detectable, ...] = field(default=())


def judge(
    split: Split,
    search: Search,
    rest: Unexplained,
    smallest_seen: Sequence[Detectable],
    library: Mapping[str, type[Effect]],
) -> Verdict:
    """Verdict on what a search found and what it left.

    Parameters
    ----------
    split : Split
    search : Search
    rest : Unexplained
        Library-free account of what the final model leaves.
    smallest_seen : sequence of Detectable
        Smallest effects that would have been seen beside the final model.
    library : mapping of str to type of Effect
    """
    baseline, final = search.baseline, search.final
    sets = tuple(tuple(equivalence_set(key, search, library)) for key in search.alternatives)
    names = tuple(s[0] for s in sets)
    share = _share(split, baseline, final)
    because = [_errors(split, baseline, final), *_one_by_one(split, search)]
    quiet = _quiet(split, final, rest)
    because += [*_reasons(split, search, sets, library), *_clue(search), *_at_bound(final)]
    if search.description is not None:
        return _described(search.description, search, share, because)
    if not names:
        return _nothing_named(rest, quiet, because, smallest_seen)
    measured = all(library[k].place == "sensor" for s in sets for k in s)
    enough = EXPLAINED_SHARE if split.has_noise else NAMED_SHARE
    if split.has_noise and final.model.linear and not measured:
        enough = LINEAR_SHARE
    if not quiet and share is not None and share < enough:
        return _partly(rest, names, sets, share, because, library)
    if not quiet:
        because.append(
            f"The equations are not exact: {unexplained_sentence(rest)}"
            if rest.share > _TRACE
            else "The equations are not exact, and what they leave is of no form known here."
        )
    if measured:
        words = _list([library[k].title for k in names])
        sentence = f"It is the measurement, not the joint: {words}."
        return Verdict("measurement", names, sets, sentence, tuple(because), share)
    if all(same_form(s, library) for s in sets):
        sentence = f"The model misses {_list([_with_equals(s, library) for s in sets])}."
        return Verdict("explained", names, sets, sentence, tuple(because), share)
    sentence = f"The model misses {_list([_either(s, library) for s in sets])}."
    if any(library[k].place == "sensor" for s in sets for k in s):
        sentence += (
            " Joint and instruments cannot be told apart here: record a known inertia alone; what"
            " then remains is the instruments."
        )
    return Verdict("one_of", names, sets, sentence, tuple(because), share)


def _nothing_named(
    rest: Unexplained,
    quiet: bool,
    because: list[str],
    smallest_seen: Sequence[Detectable],
) -> Verdict:
    if quiet:
        seen = sorted(smallest_seen, key=lambda d: d.key)
        sentence = "Nothing is missing that these data could show: the model leaves only noise."
        because.append(
            "Smallest effects that would have been seen: "
            + "; ".join(f"{d.key.replace('_', ' ')}: {d.sentence}" for d in seen)
            + "."
        )
        return Verdict("nothing_missing", (), (), sentence, tuple(because), None, tuple(seen))
    because.append(unexplained_sentence(rest))
    kind = _unknown_kind(rest)
    if kind == "measurement":
        alike = _SENSORS[rest.best.kind]
        known = _list([_plain(k) for k in alike])
        because.append(f"Its form is not that of {known} as known here.")
        sentence = f"It is the measurement, not the joint. {unexplained_sentence(rest)}"
        return Verdict(kind, alike[:1], (alike,), sentence, tuple(because))
    left = unexplained_sentence(rest)
    sentence = f"Something is missing, and it is none of the effects known here. {left}"
    return Verdict(kind, (), (), sentence, tuple(because))


def _partly(
    rest: Unexplained,
    names: tuple[str, ...],
    sets: tuple[tuple[str, ...], ...],
    share: float,
    because: list[str],
    library: Mapping[str, type[Effect]],
) -> Verdict:
    because.append(unexplained_sentence(rest))
    sentence = (
        f"None of the effects known here explains the misfit: the best, "
        f"{_list([library[k].title for k in names])}, removes {100 * share:.0f} % of it on trials "
        f"that were not fitted. {unexplained_sentence(rest)}"
    )
    because.append(
        "Named effects that remove only a part may stand for something else: treat them as a clue."
    )
    if share < NAMED_SHARE:
        names, sets = (), ()
    return Verdict(_unknown_kind(rest), names, sets, sentence, tuple(because), share)


def _described(
    description: Ranked, search: Search, share: float | None, because: list[str]
) -> Verdict:
    """Verdict where a description stands for effects that were found."""
    rival = description.candidate
    replaced = search.replaced_by(description)
    beside = [_plain(key) for key in search.alternatives if key not in replaced]
    instead_of = _list([_plain(key) for key in replaced])
    held = f" and {rival.held_out.error:.3g} on those held out" if rival.held_out.by_trial else ""
    because.append(
        f"With {_plain(description.key)} in the place of {instead_of}, E is "
        f"{rival.fitted.error:.3g} on the fitted trials{held}."
    )
    does = "better than" if description.evidence > DECISIVE else "as well as"
    sentence = (
        "Something with memory is missing, and it need be none of the effects known here: "
        f"{description.effect.title} does {does} {instead_of}."
    )
    if beside:
        sentence += f" Beside it the model misses {_list(beside)}."
    return Verdict("unknown_memory", (), (), sentence, tuple(because), share)


def _unknown_kind(rest: Unexplained) -> str:
    """Kind of verdict where no effect that is known explains the misfit."""
    kind = rest.best.kind
    if kind in ("sensor", "drift") and (rest.noise_ratio or 1.0) > _ENOUGH_NOISE:
        # A filter of the recording leaves only noise; one that leaves more stands for something.
        kind = next((f.kind for f in rest.families if f.kind not in ("sensor", "drift")), kind)
    return {
        "static": "unknown_static",
        "hysteresis": "unknown_memory",
        "memory": "unknown_memory",
        "sensor": "measurement",
        "drift": "measurement",
        "unrepeatable": "unrepeatable",
        "none": "unrepeatable",
    }[kind]


def _share(split: Split, baseline: Candidate, final: Candidate) -> float | None:
    """Share of the misfit beyond the noise that is gone, on held-out trials where there are any."""
    held = bool(split.held_out)
    before, after = ((c.held_out if held else c.fitted).error for c in (baseline, final))
    floor = split.noise_floor(split.held_out if held else split.fitted) or 0.0
    if before <= floor:
        return None
    return float((before - max(after, floor)) / (before - floor))


def _quiet(split: Split, final: Candidate, rest: Unexplained) -> bool:
    """Whether the model leaves nothing that a library-free torque could explain."""
    floor = split.noise_floor()
    if floor is not None:
        slack = 1 + max(
            3 * split.floor_uncertainty(), 3 * np.sqrt(2 / effective_samples(final.fitted))
        )
        if final.fitted.error <= floor * slack and rest.share < 0.1:
            return True
    return rest.best.kind == "none"


def _errors(split: Split, baseline: Candidate, final: Candidate) -> str:
    floor = split.noise_floor()
    noise = f"; the noise alone leaves {floor:.2g}" if floor is not None else ""
    if final is baseline or not final.keys:
        return (
            f"The model's error E is {baseline.fitted.error:.3g} on the fitted and "
            f"{baseline.held_out.error:.3g} on the held-out trials{noise}."
        )
    return (
        f"E falls from {baseline.fitted.error:.3g} to {final.fitted.error:.3g} on the fitted "
        f"trials and from {baseline.held_out.error:.3g} to {final.held_out.error:.3g} on those "
        f"held out{noise}."
    )


def _one_by_one(split: Split, search: Search) -> list[str]:
    """What each of several effects removes, in the order of the error ladder."""
    if len(search.ladder) < 2:
        return []
    rungs = [(key, _share(split, search.baseline, model)) for key, model in search.ladder]
    removed, said = 0.0, []
    for key, share in rungs:
        if share is None:
            return []
        said.append(f"{_plain(key)} {100 * (share - removed):.1f} %")
        removed = share
    trials = "held-out" if split.held_out else "fitted"
    noise = " beyond the noise" if split.has_noise else ""
    return [
        f"Of the misfit of the {trials} trials{noise}, each removes in turn: {'; '.join(said)}."
    ]


def _reasons(
    split: Split,
    search: Search,
    sets: Sequence[Sequence[str]],
    library: Mapping[str, type[Effect]],
) -> list[str]:
    out = []
    for chosen, members in zip(search.alternatives, sets, strict=True):
        rivals = [
            r
            for r in search.alternatives[chosen]
            if r.key not in members and np.isfinite(r.evidence) and not r.caveat
        ]
        rivals.sort(key=lambda r: -r.evidence)
        if (
            rivals
            and rivals[0].evidence > -DECISIVE
            and members[0] in library[rivals[0].key].refines
        ):
            richer = rivals.pop(0)
            out.append(
                f"A {_plain(richer.key)}, a richer form of the {_plain(members[0])}, does no "
                "better: the data do not ask for it."
            )
        if rivals:
            out.append(
                f"In the place of {_plain(members[0])} the next best is {_plain(rivals[0].key)}, "
                f"worse by {-rivals[0].evidence:.0f} (more than {DECISIVE:.0f} is decisive)."
            )
        out += [
            f"With {_plain(r.key)} in the place of {_plain(members[0])}, {r.caveat}."
            for r in search.alternatives[chosen]
            if r.caveat and r.evidence > -DECISIVE
        ]
        own = search.final.model.effect(chosen)
        if split.driven == "torque" and (doubt := own.doubt(search.final.values)):
            out.append(f"Of the {_plain(chosen)}, {doubt}: it may stand for something quicker.")
        alike = [r for r in search.alternatives[chosen] if r.key in members]
        better = [r for r in alike if r.evidence > DECISIVE]
        if better and not split.has_noise:
            out.append(
                f"With more parameters, {_plain(better[0].key)} leaves less still, but what the "
                f"{_plain(members[0])} leaves may be error of measurement."
            )
        same = [k for k in members[1:] if k in library[members[0]].equivalent]
        if same:
            out.append(
                f"{_plain(members[0]).capitalize()} and {_plain(same[0])} are of one form: torque "
                "and angle can never tell them apart."
            )
        later = [
            _plain(r.key) for r in alike if r.refitted is not None and does_as_well(r, search.final)
        ]
        if later:
            out.append(
                f"With {' or '.join(later)} in the place of {_plain(members[0])} the held-out "
                "trials are predicted worse, but fitted as well when all trials are: such a "
                "prediction rests on parameters that the other trials leave open."
            )
        near = [
            r.key
            for r in alike
            if comes_near(chosen, r, search) and abs(r.evidence) > DECISIVE and r.key not in same
        ]
        if near and split.has_noise:
            out.append(
                f"In the place of {_plain(members[0])} there may be "
                f"{_list([_plain(k) for k in near])}: what is left is the same but for "
                f"{100 * FORM:.0f} % of what it removes, and equations that are right to a tenth "
                "do not tell them apart."
            )
    return out


def _clue(search: Search) -> list[str]:
    """What would lower the error a little more, and is not named."""
    ranking = next((s.ranking for s in search.steps[-1:] if s.before is search.final), ())
    for r in ranking:
        lower = f"With {_plain(r.key)} too, E would fall to {r.candidate.fitted.error:.3g}"
        if r.reason == ONLY_MENDS:
            return [
                f"{lower}; but equations that are right to a tenth leave as much, so that this is "
                "at most a clue."
            ]
        values, held = ", ".join(r.values_in_words()), r.candidate.held_out
        if r.reason == TOO_LITTLE:
            there = f" and to {held.error:.3g} on the held-out trials" if held.by_trial else ""
            return [
                f"{lower}{there} ({values}); that is too little of what is left to be more than a "
                "clue."
            ]
        if r.reason == DISAGREE and abs(r.held_out_gain) < _UNMOVED:
            return [
                f"{lower} ({values}); but the held-out trials are predicted neither better nor "
                f"worse ({held.error:.3g}), so that this is at most a clue."
            ]
        if r.objection and r.reason == r.objection:
            return [f"{lower}; but {r.objection}, so that it would stand for something else."]
    return []


def _at_bound(final: Candidate) -> list[str]:
    """Which of K, B and I lies at a bound; that it may be none at all is no bound."""
    out = []
    for name in ("K", "B", "I"):
        parameter, value = final.model.parameters[name], final.values[name]
        if name in final.at_bound and value > _NONE * parameter.nominal:
            out.append(
                f"{name} lies at the edge of the values that it was allowed, {value:.3g} "
                f"{parameter.unit}, and the rest bends to that: if others are possible, allow them "
                f"with --bounds {name}=LOW:HIGH."
            )
    return out


def _plain(key: str) -> str:
    return key.replace("_", " ")


def _with_equals(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    first = library[members[0]].title
    others = [library[k].title for k in members[1:]]
    return first + (f" (of the same form: {_list(others)})" if others else "")


def _either(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    titles = [library[k].title for k in members]
    return titles[0] if len(titles) == 1 else f"one of: {', '.join(titles)}"


def _list(words: Sequence[str]) -> str:
    if len(words) < 2:
        return "".join(words)
    return ", ".join(words[:-1]) + " and " + words[-1]
