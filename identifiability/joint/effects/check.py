"""What a class of effects must declare, looked at where it is made."""

from __future__ import annotations

import math

from identifiability.errors import InputError
from identifiability.joint.parameters import Parameter

PLACES = ("joint", "muscle", "series", "coupling", "sensor")
TAKEN = ("K", "B", "I")
"""Names of the joint's own parameters."""


def check_effect(kind: type) -> None:
    """Look at the class attributes of an effect.

    Raises
    ------
    InputError
        Where one is missing, or cannot be right.
    """
    found = {name: getattr(kind, name, None) for name in ("key", "title", "place", "linear")}
    key, title, place, linear = found.values()
    if not (isinstance(key, str) and key.isidentifier()) or key in TAKEN:
        raise InputError(
            f"found the key {key!r} of {kind.__name__}, expected a name like 'my_effect' that is "
            f"none of {list(TAKEN)}; it begins the names of the effect's parameters"
        )
    if not (isinstance(title, str) and title.strip()):
        raise InputError(
            f"found the title {title!r} of {kind.__name__}, expected what the effect is in a "
            "sentence, such as 'a second spring'"
        )
    if place not in PLACES:
        raise InputError(
            f"found the place {place!r} of {kind.__name__}, expected one of {list(PLACES)}"
        )
    if not isinstance(linear, bool):
        raise InputError(
            f"found linear = {linear!r} in {kind.__name__}, expected True or False: whether its "
            "torque and rates are linear in motion and states"
        )
    states = getattr(kind, "n_states", 0)
    between = place in ("series", "coupling")
    if not isinstance(states, int) or states < 0 or (between and states):
        raise InputError(
            f"found {states!r} states of {kind.__name__}, expected a number from 0 on, and none in "
            "series or of a coupling"
        )
    _check_parameters(kind)


def _check_parameters(kind: type) -> None:
    parameters = getattr(kind, "parameters", ())
    if not isinstance(parameters, tuple) or not all(isinstance(p, Parameter) for p in parameters):
        raise InputError(
            f"found {parameters!r} as parameters of {kind.__name__}, expected a tuple of Parameter"
        )
    names = [p.name for p in parameters]
    if not names or len(set(names)) < len(names) or not all(n.isidentifier() for n in names):
        raise InputError(
            f"found parameters named {names} in {kind.__name__}, expected at least one, each with "
            "a name of its own like 'time_constant'"
        )
    if all(p.null is None or p.null == p.nominal for p in parameters):
        raise InputError(
            f"found no parameter of {kind.__name__} with a null other than its nominal value, "
            "expected the value at which the effect vanishes, such as null=0.0"
        )
    for p in parameters:
        inside = p.null is None or p.lower <= p.null <= p.upper or p.null == math.inf
        if not inside:
            raise InputError(
                f"found the null {p.null} of {p.name} in {kind.__name__}, expected a value between "
                f"{p.lower} and {p.upper}, or infinity"
            )
        if p.plain is not None and not p.lower <= p.plain <= p.upper:
            raise InputError(
                f"found the plain value {p.plain} of {p.name} in {kind.__name__}, expected one "
                f"between {p.lower} and {p.upper}"
            )
