"""Descriptions of no mechanism, in the place of effects that may stand for one that is unknown.

A torque without a name is tried beside every set that comes near, but it is a kernel of few numbers
seen through a Gaussian process. Relaxation at many paces, hysteresis that stiffens on reversal and
play are known forms of which the library names no mechanism: where one does better than the effects
that resemble it, these are none of what is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from identifiability.inference.starts import refined_values, starting_values
from identifiability.investigation.posterior.evidence import Evaluated
from identifiability.joint.effects import DESCRIPTIONS, Effect
from identifiability.joint.model import Model


@dataclass(frozen=True, eq=False)
class Description:
    """A model in which a description stands for some effects.

    Attributes
    ----------
    rest : tuple of str
        Known effects beside it.
    key : str
        Of the description.
    model : Model
    starts : list of dict
        Values of all its parameters to start from.
    refined : tuple of str
    """

    rest: tuple[str, ...]
    key: str
    model: Model
    starts: list[dict[str, float]]
    refined: tuple[str, ...]


def descriptions_of(
    found: Evaluated, base: Collection[str], library: Collection[str]
) -> list[Description]:
    """Descriptions in the place of effects of one model.

    Parameters
    ----------
    found : Evaluated
    base : collection of str
        Effects that are no findings.
    library : collection of str
        Effects that are tried. What a description is a richer form of has to be among them: else
        it would stand for that.
    """
    own = [key for key in found.model.effect_keys if key not in base]
    out = []
    for key, kind, replaced in _places(own):
        if not all(k in library for k in kind.refines):
            continue
        model = found.model
        for k in replaced:
            model = model.without(k)
        model = model + kind()
        rest = tuple(sorted(k for k in own if k not in replaced))
        refined = model.refinable(k for k in found.refined if k in rest)
        starts = starting_values(model, _shared(found, model), wide=True)
        if any(p.plain is not None for p in kind.parameters):
            plain = renamed(found, replaced[0], key, model) or starts[0]
            free = [name for name, p in model.parameters.items() if p.plain is None]
            starts = [*refined_values(model, plain, free), *starts]
            refined = (*refined, key)
        out.append(Description(rest, key, model, starts, refined))
    return out


def _places(own: Sequence[str]) -> Iterator[tuple[str, type[Effect], list[str]]]:
    """Each description and the effects in whose place it is tried: all that resemble it, or one."""
    for key, kind in DESCRIPTIONS.items():
        alike = [k for k in own if k in kind.confused_with]
        if alike:
            yield key, kind, alike
        for one in alike if len(alike) > 1 else ():
            yield key, kind, [one]


def _shared(found: Evaluated, model: Model) -> dict[str, float]:
    names = model.parameter_names
    return {name: value for name, value in found.values.items() if name in names}


def renamed(found: Evaluated, replaced: str, key: str, model: Model) -> dict[str, float] | None:
    """Values of a model in which one effect is another's richer or plainer form.

    Parameters
    ----------
    found : Evaluated
    replaced, key : str
        The effect in it, and the one in its place.
    model : Model
        With that one.

    Returns
    -------
    dict or None
        None where the other has a parameter that this one says nothing of.
    """
    values = _shared(found, model)
    own: Mapping[str, float] = {
        name.split(".")[1]: value
        for name, value in found.values.items()
        if name.startswith(f"{replaced}.")
    }
    for name, p in model.parameters.items():
        if not name.startswith(f"{key}."):
            continue
        value = own.get(name.split(".")[1], p.plain)
        if value is None:
            return None
        values[name] = min(max(value, p.lower), p.upper)
    return values
