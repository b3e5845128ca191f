"""The parameters of a fitted model, and what is said of their widths, in words."""

from __future__ import annotations

from identifiability.investigation.models import FittedModel
from identifiability.investigation.wording.numbers import measured
from identifiability.investigation.wording.verdict import model_in_words, plain


def value_in_words(one: FittedModel, name: str, *, unit: bool = True) -> str:
    """A parameter of a model with its width, and with its unit where no head of a table has it."""
    candidate = one.candidate
    return measured(
        candidate.values[name],
        one.sds.get(name),
        candidate.model.parameters[name],
        at_bound=name in candidate.at_bound,
        unit=unit,
    )


def own_values_in_words(one: FittedModel) -> str:
    """Parameters of the effect by which a model differs from the one above it, or of all."""
    own = f"{one.added}." if one.added else ""
    return ", ".join(
        f"{plain(name.removeprefix(own))} {value_in_words(one, name)}"
        for name in one.candidate.free
        if (name.startswith(own) if own else one.role == "nearest" and "." in name)
    )


def width_in_words(verdict: str) -> str:
    """What a verdict on a width says: of the ellipse, not of the parameter."""
    return "ellipse holds" if verdict == "agrees" else verdict


def name_in_words(one: FittedModel) -> str:
    """What a model adds to the one above it, or has in an effect's place."""
    if one.role == "baseline":
        return model_in_words(one.candidate.keys)
    if one.role == "instead":
        return f"or {plain(one.added)} in its place"
    if one.role == "nearest":
        return f"nearest known: {model_in_words(one.candidate.keys)}"
    return f"+ {plain(one.added)}"
