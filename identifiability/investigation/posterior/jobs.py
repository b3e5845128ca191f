"""Models that are weighed next: one effect more, or the same effects in richer form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from identifiability.inference.starts import refined_values, starting_values
from identifiability.investigation.posterior.evidence import Evaluated
from identifiability.investigation.posterior.weighing import Job
from identifiability.joint.effects import Effect
from identifiability.joint.model import Model

STARTS_BESIDE = 12
"""Shapes that are tried as starts beside other effects."""


def enlarged(current: Evaluated, effect: Effect, alone: Mapping[str, float]) -> Job:
    """A model with one effect more, from its own values and those of the effect alone.

    Parameters
    ----------
    current : Evaluated
    effect : Effect
    alone : mapping of str to float
        Values of the model with this effect alone, empty where that was not weighed.
    """
    model, values = current.model + effect, current.values
    if not current.model.effect_keys:
        starts = starting_values(model, values, wide=True)
    else:
        starts = _starts_beside(model, values, effect, alone)
    return Job(model, starts, current.refined, nested=current)


def exchanged(current: Evaluated, key: str, effect: Effect, alone: Mapping[str, float]) -> Job:
    """A model with another effect in the place of one; the rest keep their forms.

    Parameters
    ----------
    current : Evaluated
    key : str
        Of the effect that is left out.
    effect : Effect
        That comes in its place.
    alone : mapping of str to float
        See `enlarged`.
    """
    model = current.model.without(key) + effect
    values = {name: v for name, v in current.values.items() if name in model.parameters}
    starts = _starts_beside(model, values, effect, alone)
    return Job(model, starts, model.refinable(current.refined), noise=current.weights)


def _starts_beside(
    model: Model, values: Mapping[str, float], effect: Effect, alone: Mapping[str, float]
) -> list[dict[str, float]]:
    """Starts of a model from values of all its effects but one."""
    starts = starting_values(model, values, most=STARTS_BESIDE, wide=True)
    shape = {
        name: value
        for name, value in alone.items()
        if name.startswith(f"{effect.key}.") and model.parameters[name].null is None
    }
    if shape:
        # A shape that served once may serve again.
        starts += starting_values(model, {**values, **shape}, most=1)
    # With a second effect the first one may have to take another shape.
    joint = {name: values[name] for name in ("K", "B", "I")}
    return starts + starting_values(model, joint, most=STARTS_BESIDE, wide=True)


def richer(plain: Evaluated, keys: Iterable[str]) -> list[Job]:
    """A model with each of some of its effects in richer form."""
    free = [
        name
        for name, parameter in plain.model.parameters.items()
        if parameter.plain is None or name.split(".")[0] in plain.refined
    ]
    starts = refined_values(plain.model, plain.values, free)
    return [
        Job(plain.model, starts, (*plain.refined, key), nested=plain)
        for key in plain.model.refinable(tuple(keys))
        if key not in plain.refined
    ]
