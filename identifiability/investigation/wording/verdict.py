"""The verdict and its reasons in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identifiability.investigation.findings import Findings
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.verdict.reasons import Reason
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.joint.effects import DESCRIPTIONS, Effect
from identifiability.joint.parameters import with_unit

TITLES = {
    "explained": "Explained",
    "one_of": "One of several effects",
    "unknown_static": "An unknown effect of the present state",
    "unknown_memory": "An unknown effect with memory",
    "measurement": "The measurement",
    "unrepeatable": "Not repeatable",
    "nothing_missing": "Nothing missing",
}
"""Kinds of verdict as headings."""

REFUSALS = {
    "": "",
    "no fit": "no fit",
    "no evidence": "no decisive evidence",
    "disagrees": "the held-out trials do not agree",
    "too little": "removes too little of what is left",
    "only mends": "may only mend the equations of the effects before it",
    "objection": "its values cannot be those of a joint",
}
"""Why a candidate is not admitted."""


def plain(key: str) -> str:
    """An effect's key as words."""
    return key.replace("_", " ")


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence."""
    if len(words) < 2:
        return "".join(words)
    return ", ".join(words[:-1]) + " and " + words[-1]


def verdict_sentence(findings: Findings) -> str:
    """The verdict in one or two sentences."""
    verdict, found, library = findings.verdict, findings.found, findings.library
    rest = unexplained_sentence(findings.unexplained_after)
    unsure = next((r for r in verdict.reasons if r.kind == "not probable enough"), None)
    if verdict.kind == "nothing_missing" and unsure is not None:
        return _nothing(unsure)
    if found.description is not None:
        return _described(findings)
    if verdict.kind == "nothing_missing":
        return "Nothing is missing that these data could show: the model leaves only noise."
    beside = next((r for r in verdict.reasons if r.kind == "whatever else"), None)
    if beside is not None:
        there = listed([library[key].title for key in beside.effects])
        return (
            f"Beside {there}, something is missing that no effect known here is sure to be. {rest}"
        )
    if unsure is not None:
        return f"Something is missing, and no effect known here is sure to be it. {rest}"
    if not found.missing and verdict.kind == "measurement":
        return f"It is the measurement, not the joint. {rest}"
    if not found.missing:
        return f"Something is missing, and it is none of the effects known here. {rest}"
    if any(r.kind == "only a part" for r in verdict.reasons):
        best = listed([library[m.name].title for m in found.missing])
        share = 100 * (found.share or 0.0)
        return (
            f"None of the effects known here explains the misfit: the best, {best}, removes "
            f"{share:.0f} % of it on trials that were not fitted. {rest}"
        )
    if verdict.kind == "measurement":
        titles = listed([library[key].title for key in verdict.effects])
        return f"It is the measurement, not the joint: {titles}."
    if verdict.kind == "explained":
        return f"The model misses {listed([_with_equals(s, library) for s in verdict.sets])}."
    words = f"The model misses {listed([_either(s, library) for s in verdict.sets])}."
    if any(library[key].place == "sensor" for names in verdict.sets for key in names):
        words += (
            " Joint and instruments cannot be told apart here: record a known inertia alone; what"
            " then remains is the instruments."
        )
    return words


def _nothing(unsure: Reason) -> str:
    """Verdict where nothing is missing, or that cannot be excluded."""
    nothing = unsure.numbers["nothing"]
    if nothing >= 0.5 or not unsure.effects:
        return "Nothing is missing that these data could show: the model leaves only noise."
    likely = likely_set(unsure.effects[0])
    return (
        f"These data do not decide whether anything is missing: most likely {likely} is, but that "
        f"nothing is missing cannot be excluded ({percent(nothing)})."
    )


def likely_set(keys: str) -> str:
    """A set of effects, its keys joined by "+", in words."""
    return " with ".join(plain(key) for key in keys.split("+"))


def set_in_words(effects: Sequence[str] | None) -> str:
    """What a row of a posterior says is missing."""
    if effects is None:
        return "something unknown"
    return likely_set("+".join(effects)) if effects else "nothing"


def probability_sentences(found: Probabilities, least: float = 0.005) -> tuple[str, ...]:
    """What may be missing, a sentence each, the most probable first.

    Parameters
    ----------
    found : Probabilities
    least : float
        Probability from which a set is named.
    """
    rows = [row for row in found.rows if row.probability >= least] or found.rows[:1]
    return tuple(
        f"That {set_in_words(row.effects)} is missing has a probability of "
        f"{percent(row.probability)}."
        for row in rows
    )


def percent(probability: float) -> str:
    """A probability in words that do not pretend to certainty."""
    if probability > 0.999:
        return "more than 99.9 %"
    if probability < 0.001:
        return "less than 0.1 %"
    digits = 1 if probability > 0.99 or probability < 0.01 else 0
    return f"{100 * probability:.{digits}f} %"


def _probable(reason: Reason) -> str:
    e = reason.numbers
    return (
        f"The probability of this is {percent(e['probability'])}; that nothing is missing, "
        f"{percent(e['nothing'])}; that it is something unknown, {percent(e['unknown'])}."
    )


def _not_probable(reason: Reason) -> str:
    e = reason.numbers
    parts = [f"nothing is missing, {percent(e['nothing'])}"]
    parts += [f"{likely_set(keys)}, {percent(e[keys])}" for keys in reason.effects]
    parts += [f"something unknown, {percent(e['unknown'])}"]
    return f"Probabilities: {'; '.join(parts)}."


def because(findings: Findings) -> list[str]:
    """The reasons of the verdict, a sentence each."""
    out = [_reason(reason, findings) for reason in findings.verdict.reasons]
    if findings.verdict.smallest_seen:
        seen = "; ".join(f"{plain(d.key)}: {d.sentence}" for d in findings.verdict.smallest_seen)
        out.append(f"Smallest effects that would have been seen: {seen}.")
    return out


def values_in_words(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Parameters of one effect, by their full names, with units."""
    return ", ".join(
        f"{plain(name.split('.')[1])} " + with_unit(f"{value:.3g}", units[name])
        for name, value in values.items()
    )


def _described(findings: Findings) -> str:
    """Verdict where a description stands for effects that were found."""
    found, description = findings.found, findings.found.description
    assert description is not None
    replaced = [m.key for m in found.replaced_by(description)]
    beside = [plain(m.key) for m in found.missing if m.key not in replaced]
    does = "better than" if description.evidence > findings.split.rules.decisive else "as well as"
    words = (
        "Something with memory is missing, and it need be none of the effects known here: "
        f"{description.effect.title} does {does} {listed([plain(key) for key in replaced])}."
    )
    return words + (f" Beside it the model misses {listed(beside)}." if beside else "")


def _reason(reason: Reason, findings: Findings) -> str:
    if reason.kind == "only a part":
        return (
            "Named effects that remove only a part may stand for something else: treat them as a "
            "clue."
        )
    if reason.kind == "errors":
        return _errors(reason, findings)
    if reason.kind == "probable":
        return _probable(reason)
    if reason.kind == "not probable enough":
        return _not_probable(reason)
    if reason.kind == "whatever else":
        each = [f"{plain(key)} {percent(p)}" for key, p in reason.numbers.items()]
        return (
            f"Whatever else is missing, these are there: {listed(each)}. They may stand for a part"
            " of what is unknown: treat them as a clue."
        )
    if reason.kind == "nearest form":
        nearest = DESCRIPTIONS[reason.effects[0]].title
        return f"In form it comes nearest to {nearest}, which names no mechanism."
    if reason.kind == "removes in turn":
        return _in_turn(reason, findings)
    if reason.kind == "clue":
        return _clue(reason, findings)
    if reason.kind == "equations not exact":
        rest = findings.unexplained_after
        if rest.share > findings.split.rules.trace_share:
            return f"The equations are not exact: {unexplained_sentence(rest)}"
        return "The equations are not exact, and what they leave is of no form known here."
    if reason.kind == "edge of bounds":
        name, unit = reason.remark, findings.found.final.model.parameters[reason.remark].unit
        value = with_unit(f"{reason.numbers['value']:.3g}", unit)
        return (
            f"{name} lies at the edge of the values that it was allowed, {value}, and the rest "
            f"bends to that: if others are possible, allow them with --bounds {name}=LOW:HIGH."
        )
    first, *others = [plain(key) for key in reason.effects]
    return {
        "richer form not needed": _richer,
        "next best": _next_best,
        "objection": _caveat,
        "doubt": _caveat,
        "more parameters": _more_parameters,
        "same form": _same_form,
        "only prediction worse": _only_prediction,
        "equations hide": _equations_hide,
        "form of no sensor": _no_sensor,
        "description": _description,
    }[reason.kind](reason, first, others, findings)


def _errors(reason: Reason, findings: Findings) -> str:
    e = reason.numbers
    noise = f"; the noise alone leaves {e['floor']:.2g}" if "floor" in e else ""
    held = "held_out_before" in e
    if not findings.found.missing:
        also = f" and {e['held_out_before']:.3g} on the held-out trials" if held else ""
        return f"The model's error E is {e['before']:.3g} on the fitted{also}{noise}."
    also = ""
    if held:
        also = (
            f" and from {e['held_out_before']:.3g} to {e['held_out_after']:.3g} on those held out"
        )
    return f"E falls from {e['before']:.3g} to {e['after']:.3g} on the fitted trials{also}{noise}."


def _in_turn(reason: Reason, findings: Findings) -> str:
    said = [f"{plain(key)} {100 * share:.1f} %" for key, share in reason.numbers.items()]
    trials = "held-out" if findings.split.held_out else "fitted"
    noise = " beyond the noise" if findings.split.has_noise else ""
    return f"Of the misfit of the {trials} trials{noise}, each removes in turn: {'; '.join(said)}."


def _clue(reason: Reason, findings: Findings) -> str:
    """What would lower the error a little more, and is not named."""
    (key,), e = reason.effects, reason.numbers
    effect = findings.library[key]
    units = {f"{key}.{p.name}": p.unit for p in effect.parameters}
    values = values_in_words({n: v for n, v in e.items() if n in units}, units)
    held = f"{e['held_out']:.3g}" if "held_out" in e else "unknown"
    lower = f"With {plain(key)} too, E would fall to {e['error']:.3g}"
    if reason.remark == "only mends":
        return (
            f"{lower}; but equations that are right to a tenth leave as much, so that this is at "
            "most a clue."
        )
    if reason.remark == "too little":
        there = f" and to {held} on the held-out trials" if "held_out" in e else ""
        return (
            f"{lower}{there} ({values}); that is too little of what is left to be more than a clue."
        )
    if reason.remark == "disagrees":
        return (
            f"{lower} ({values}); but the held-out trials are predicted neither better nor worse "
            f"({held}), so that this is at most a clue."
        )
    return f"{lower}; but {reason.remark}, so that it would stand for something else."


def _richer(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"A {first}, a richer form of the {others[0]}, does no better: the data do not ask for it."
    )


def _next_best(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"In the place of {others[0]} the next best is {first}, worse by "
        f"{reason.numbers['evidence']:.0f} (more than {findings.split.rules.decisive:.0f} is "
        "decisive)."
    )


def _caveat(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    if others:
        return f"With {first} in the place of {others[0]}, {reason.remark}."
    return f"Of the {first}, {reason.remark}: it may stand for something quicker."


def _more_parameters(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"With more parameters, {first} leaves less still, but what the {others[0]} leaves may be "
        "error of measurement."
    )


def _same_form(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"{first.capitalize()} and {listed(others)} are of one form: torque and angle can never "
        "tell them apart."
    )


def _only_prediction(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"With {' or '.join(others)} in the place of {first} the held-out trials are predicted "
        "worse, but fitted as well when all trials are: such a prediction rests on parameters that "
        "the other trials leave open."
    )


def _equations_hide(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return (
        f"In the place of {first} there may be {listed(others)}: what is left is the same but for "
        f"{100 * reason.numbers['form']:.0f} % of what it removes, and equations that are right to "
        "a tenth do not tell them apart."
    )


def _no_sensor(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    return f"Its form is not that of {listed([first, *others])} as known here."


def _description(reason: Reason, first: str, others: Sequence[str], findings: Findings) -> str:
    held = ""
    if "held_out" in reason.numbers:
        held = f" and {reason.numbers['held_out']:.3g} on those held out"
    return (
        f"With {first} in the place of {listed(others)}, E is {reason.numbers['error']:.3g} on the "
        f"fitted trials{held}."
    )


def _with_equals(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    first = library[members[0]].title
    others = [library[key].title for key in members[1:]]
    return first + (f" (of the same form: {listed(others)})" if others else "")


def _either(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    titles = [library[key].title for key in members]
    return titles[0] if len(titles) == 1 else f"one of: {', '.join(titles)}"
