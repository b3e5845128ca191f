"""Sets of effects that leave least, whatever the colour of what they leave.

Noise may have the colour of the response itself. What several effects do together then passes for
noise until all of them are there, and no one of them seems to be missing. Where even the most
probable set leaves more than an instrument would, and before something unknown is said to be
missing, effects are added by least squares as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.evidence import Begun, Evaluated, Evaluator
from identifiability.investigation.posterior.signatures import strongest
from identifiability.joint.effects import Effect
from identifiability.joint.model import Model
from identifiability.progress import Progress, silent

_BEGUN, _FITTED = 8, 3  # effects of the strongest signatures; those that leave least when begun
_STARTS = 12  # shapes that are tried as starts
_FAILURES = (InputError, ArithmeticError, np.linalg.LinAlgError)


@dataclass(frozen=True, eq=False)
class Step:
    """A set of effects on the way.

    Attributes
    ----------
    model : Model
    values : dict of str to float
        That leave least.
    """

    model: Model
    values: dict[str, float]


def stepwise(
    evaluator: Evaluator,
    base: Evaluated,
    library: Mapping[str, type[Effect]],
    most: int,
    progress: Progress = silent,
) -> Iterator[Step]:
    """Add one effect after another by least squares; at last, leave each of them out.

    Parameters
    ----------
    evaluator : Evaluator
    base : Evaluated
        The model to start from.
    library : mapping of str to type of Effect
    most : int
        Most effects to add.
    progress : callable
        Told ``(what, done, total)``.

    Yields
    ------
    Step
        What leaves least with so many effects, then the last set without one of its effects.
    """
    current = evaluator.by_least_squares(evaluator.begun(base.model, [base.values]))
    added: list[str] = []
    for _ in range(most):
        more = {k: e for k, e in library.items() if current.model.takes(e)}
        seen = strongest(evaluator, current, more, {}, _BEGUN, plainly=True)
        begun: dict[str, Begun] = {}
        for i, key in enumerate(seen):
            progress("adding what leaves least", i, len(seen))
            model = current.model + more[key]()
            joint = {name: current.values[name] for name in ("K", "B", "I")}
            starts = [
                start
                for values in (current.values, joint)
                for start in starting_values(model, values, most=_STARTS, wide=True)
            ]
            with suppress(*_FAILURES):  # one that cannot be fitted is no step
                begun[key] = evaluator.begun(model, starts)
        tried = []
        for key in sorted(begun, key=lambda key: begun[key].left)[:_FITTED]:
            with suppress(*_FAILURES):
                tried.append((key, evaluator.by_least_squares(begun[key])))
        if not tried:
            break
        key, current = min(tried, key=lambda one: _left(one[1]))
        added.append(key)
        yield Step(current.model, current.values)
    for keys in combinations(added, len(added) - 1) if len(added) > 2 else ():
        (gone,) = set(added) - set(keys)
        model = base.model
        for key in keys:
            model = model + library[key]()
        kept = {n: v for n, v in current.values.items() if n.split(".")[0] != gone}
        yield Step(model, kept)


def _left(found: Evaluated) -> float:
    """Sum of squares."""
    return float(found.white @ found.white)
