"""The verdict and its reasons in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from identifiability.investigation.findings import Findings
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.verdict.reasons import Reason
from identifiability.investigation.wording.numbers import error_text, times
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.joint.effects import DESCRIPTIONS, Effect
from identifiability.joint.parameters import with_unit
from identifiability.numerals import number

TITLES = {
    "explained": "Explained",
    "one_of": "One of several effects",
    "unknown_static": "An unknown effect of the present state",
    "unknown_memory": "An unknown effect with memory",
    "measurement": "The measurement",
    "unrepeatable": "Not of the motion alone",
    "nothing_missing": "Nothing missing",
    "undecided": "Not decided",
}
"""Kinds of verdict as headings."""


def plain(key: str) -> str:
    """The key of an effect, or the name of a parameter, as words."""
    return key.replace("_", " ").replace(".", ": ")


def model_in_words(keys: Iterable[str]) -> str:
    """K, B, I and some effects, such as "K, B, I + series tendon"."""
    return " + ".join(["K, B, I", *map(plain, keys)])


def listed(words: Sequence[str], joined: Literal["and", "or"] = "and") -> str:
    """Words as a list in a sentence."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {joined} {words[-1]}"


def verdict_sentence(findings: Findings) -> str:
    """The verdict in one or two sentences."""
    clues = findings.verdict.clues
    if not clues or not findings.verdict.sets:
        return _verdict(findings)
    instead = findings.verdict.instead_of_clue
    each = {**clues, **instead}
    also = [f"{findings.library[key].title} ({percent(p)})" for key, p in each.items()]
    either = listed(also, "or" if instead else "and")
    return f"{_verdict(findings)} It may well miss {either} besides."


def _verdict(findings: Findings) -> str:
    """What is claimed, or why nothing is."""
    verdict, found, library = findings.verdict, findings.found, findings.library
    reasons = {r.kind: r for r in verdict.reasons}
    rest = unexplained_sentence(findings.unexplained_after)
    if "no error" in reasons:
        best = listed([library[key].title for key in reasons["no error"].effects])
        return (
            f"Most probable is {best}, but whether the error falls with it could not be computed: "
            f"{reasons['no error'].remark}. {rest}"
        )
    if "mostly noise" in reasons:
        return f"What may be missing cannot be told from these data. {rest}"
    if verdict.kind == "undecided":
        why = findings.failures["probabilities"]
        return f"What may be missing could not be weighed: {why}. {rest}"
    if verdict.kind == "nothing_missing":
        return _nothing(reasons["not probable enough"])
    if "only a part" in reasons:
        best = listed([library[key].title for key in reasons["only a part"].effects])
        share = 100 * (found.share or 0.0)
        return (
            f"None of the effects known here explains the misfit: the most probable, {best}, "
            f"removes {share:.0f} % of it on trials that were not fitted. {rest}"
        )
    if "whatever else" in reasons:
        there = listed([library[key].title for key in reasons["whatever else"].effects])
        return (
            f"Beside {there}, or what behaves like it, something is missing that no effect known "
            f"here is sure to be. {rest}"
        )
    if not verdict.sets:
        return f"Something is missing, and no effect known here is sure to be it. {rest}"
    if verdict.kind == "measurement":
        titles = listed([_either(names, library) for names in verdict.sets])
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


def _probable(reason: Reason, findings: Findings) -> str:
    e = reason.numbers
    return (
        f"The probability of this is {percent(e['probability'])}; that nothing is missing, "
        f"{percent(e['nothing'])}; that it is something unknown, {percent(e['unknown'])}."
    )


def _not_probable(reason: Reason, findings: Findings) -> str:
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
        f"{plain(name.split('.')[1])} " + with_unit(number(value), units[name])
        for name, value in values.items()
    )


def _reason(reason: Reason, findings: Findings) -> str:
    return {
        "probable": _probable,
        "not probable enough": _not_probable,
        "no error": _no_error,
        "mostly noise": _mostly_noise,
        "only a part": _only_a_part,
        "whatever else": _whatever_else,
        "clue": _clue,
        "instead of the clue": _instead_of_clue,
        "nearest form": _nearest_form,
        "nearest known": _nearest_known,
        "errors": _errors,
        "chosen alike": _chosen_alike,
        "chosen with": _chosen_with,
        "removes in turn": _in_turn,
        "next best": _next_best,
        "doubt": _doubt,
        "same form": _same_form,
        "equations not exact": _not_exact,
        "edge of bounds": _edge,
    }[reason.kind](reason, findings)


def _no_error(reason: Reason, findings: Findings) -> str:
    return (
        "Effects are named for the error that falls with them on trials that were not fitted; that "
        "of the most probable model is not known."
    )


def _mostly_noise(reason: Reason, findings: Findings) -> str:
    """Why nothing is said, and what would help."""
    imposed = findings.split.driven
    followed = "angle" if imposed == "torque" else "torque"
    return (
        f"To the most probable model {percent(reason.numbers['share'])} of the {followed} is "
        "noise, which may well be what the joint does: where one slow movement comes again and "
        f"again, noise that varies slowly looks like it. If the {imposed} rather followed the "
        f"{followed}, say --driven {followed}; if not, move the joint at more frequencies."
    )


def _chosen_alike(reason: Reason, findings: Findings) -> str:
    return (
        "Held-out trials had no say in this: the others alone choose the same, with a probability "
        f"of {percent(reason.numbers['probability'])}."
    )


def _chosen_with(reason: Reason, findings: Findings) -> str:
    return (
        "Held-out trials had a say in this, which makes their errors smaller: by the others alone "
        f"its probability is {percent(reason.numbers['probability'])}."
    )


def _only_a_part(reason: Reason, findings: Findings) -> str:
    return "Effects that remove only a part may stand for something else: treat them as a clue."


def _whatever_else(reason: Reason, findings: Findings) -> str:
    each = [f"{plain(key)} {percent(p)}" for key, p in reason.numbers.items()]
    return (
        f"Whatever else is missing, no model does without {listed(each)}. They may stand for a "
        "part of what is unknown: treat them as a clue."
    )


def _clue(reason: Reason, findings: Findings) -> str:
    each = [f"{plain(key)} {percent(p)}" for key, p in reason.numbers.items()]
    return (
        f"The error is shown with the most probable effects, of which these are not sure: "
        f"{listed(each)}. Treat them as a clue."
    )


def _instead_of_clue(reason: Reason, findings: Findings) -> str:
    each = [f"{plain(key)} {percent(p)}" for key, p in reason.numbers.items()]
    return f"In the place of that clue there may be {listed(each, 'or')}."


def _nearest_form(reason: Reason, findings: Findings) -> str:
    nearest = DESCRIPTIONS[reason.effects[0]].title
    return f"In form it comes nearest to {nearest}, which names no mechanism."


def _nearest_known(reason: Reason, findings: Findings) -> str:
    e, held = reason.numbers, ""
    names = listed([plain(key) for key in reason.effects])
    come, it = ("comes", "it") if len(reason.effects) == 1 else ("come", "them")
    if "held_out_after" in e:
        held = f" and {error_text(e['held_out_after'])} on the held-out trials"
    return (
        f"Of what is known {names} {come} nearest: with {it} E is {error_text(e['after'])} on the "
        f"fitted{held}. A torque of any form makes the trials {times(e['behind'])} times more "
        "probable, so that nothing is named."
    )


def _not_exact(reason: Reason, findings: Findings) -> str:
    e, unit = reason.numbers, "rad" if findings.split.driven == "torque" else "Nm"
    size = with_unit(number(e["size"], 2), unit)
    return (
        f"The equations are not exact: beside them there is {size} that nothing names, "
        f"{percent(e['share'])} of the response, no more than equations right to a tenth leave."
    )


def _edge(reason: Reason, findings: Findings) -> str:
    name, unit = reason.remark, findings.found.final.model.parameters[reason.remark].unit
    value = with_unit(number(reason.numbers["value"]), unit)
    return (
        f"{name} lies at the edge of the values that it was allowed, {value}, and the rest "
        f"bends to that: if others are possible, allow them with --bounds {name}=LOW:HIGH."
    )


def _errors(reason: Reason, findings: Findings) -> str:
    e = {name: error_text(error) for name, error in reason.numbers.items()}
    noise = f"; the noise alone leaves {number(reason.numbers['floor'], 2)}" if "floor" in e else ""
    held = "held_out_before" in e
    if not findings.found.missing:
        also = f" and {e['held_out_before']} on the held-out trials" if held else ""
        return f"The model's error E is {e['before']} on the fitted{also}{noise}."
    also = ""
    if held:
        also = f" and from {e['held_out_before']} to {e['held_out_after']} on those held out"
    return f"E falls from {e['before']} to {e['after']} on the fitted trials{also}{noise}."


def _in_turn(reason: Reason, findings: Findings) -> str:
    said = [f"{plain(key)} {100 * share:.1f} %" for key, share in reason.numbers.items()]
    trials = "held-out" if findings.split.held_out else "fitted"
    noise = " beyond the noise" if findings.split.has_noise else ""
    return f"Of the misfit of the {trials} trials{noise}, each removes in turn: {'; '.join(said)}."


def _next_best(reason: Reason, findings: Findings) -> str:
    first, name = map(plain, reason.effects)
    e = reason.numbers
    less = "less" if e["evidence"] > 0 else "more"
    return (
        f"In the place of {name} the next best is {first}: with it the trials are "
        f"{times(abs(e['evidence']))} times {less} probable, and its probability is "
        f"{percent(e['probability'])}."
    )


def _doubt(reason: Reason, findings: Findings) -> str:
    return (
        f"Of the {plain(reason.effects[0])}, {reason.remark}: it may stand for something quicker."
    )


def _same_form(reason: Reason, findings: Findings) -> str:
    first, *others = map(plain, reason.effects)
    return (
        f"{first.capitalize()} and {listed(others)} are of one form: torque and angle can never "
        "tell them apart."
    )


def _with_equals(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    first = library[members[0]].title
    others = [library[key].title for key in members[1:]]
    return first + (f" (of the same form: {listed(others)})" if others else "")


def _either(members: Sequence[str], library: Mapping[str, type[Effect]]) -> str:
    titles = [library[key].title for key in members]
    return titles[0] if len(titles) == 1 else f"one of: {', '.join(titles)}"
