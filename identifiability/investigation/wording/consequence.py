"""What a verdict means for K, B and I, in one sentence."""

from __future__ import annotations

from dataclasses import replace

from identifiability.investigation.findings import Findings
from identifiability.investigation.models import FittedModel, fitted_models
from identifiability.investigation.wording.numbers import error_text
from identifiability.investigation.wording.values import value_in_words
from identifiability.joint.parameters import with_unit
from identifiability.numerals import number, range_text

_JOINT = ("K", "B", "I")
_FACTOR = 4.0  # by which an error falls that is given as a factor
_APART = 2.0  # standard deviations from which models say other things


def consequence_sentence(findings: Findings) -> str:
    """What K, B and I become, and what happens to the error; or why they cannot be quoted."""
    models = fitted_models(findings)
    base = models[0]
    after = next((one for one in models if one.role == "final"), base)
    held_out = bool(findings.split.held_out)
    errors = [
        (one.candidate.held_out if held_out else one.candidate.fitted).error
        for one in (base, after)
    ]
    trials = "trials that were not fitted" if held_out else "the fitted trials"
    if findings.verdict.kind == "nothing_missing":
        return f"{_values(base)} stand, with E = {error_text(errors[0])} on {trials}."
    if after is base:
        return (
            f"Do not quote {_values(base)}: they leave E = {error_text(errors[0])} on {trials}, "
            "and their widths do not hold what is missing."
        )
    plain = replace(base, sds={})
    before = ", ".join(value_in_words(plain, name, unit=False) for name in _JOINT)
    falls = f"the error on {trials} goes from {error_text(errors[0])} to {error_text(errors[1])}"
    if errors[1] < errors[0]:
        falls = falls.replace("goes", "falls") + f", {_times(errors[0] / errors[1])}"
    clue = findings.verdict.kind.startswith("unknown") or findings.verdict.kind == "unrepeatable"
    with_it = "With what is named as a clue" if clue else "With it"
    if not clue and findings.verdict.clues:
        with_it = "With all of that"
    rivals = [one for one in models if one.role == "instead"]
    if rivals:
        with_it = "Depending on which it is"
    return f"{with_it}, {_values(after, *rivals)} (by K, B and I alone {before}), and {falls}."


def _values(*models: FittedModel) -> str:
    """K, B and I of a model, or the range over several that are not told apart."""
    one = models[0]
    parameters = one.candidate.model.parameters
    said = []
    for name in _JOINT:
        values = [other.candidate.values[name] for other in models]
        apart = max(values) - min(values)
        if apart > _APART * max(other.sds.get(name, 0.0) for other in models):
            found = with_unit(range_text(min(values), max(values)), parameters[name].unit)
        else:
            found = value_in_words(one, name)
        said.append(f"{name} = {found}")
    return ", ".join(said)


def _times(ratio: float) -> str:
    if ratio >= _FACTOR:
        return f"by a factor of {number(ratio, 2)}"
    return f"by {100 * (1 - 1 / ratio):.0f} %"
