"""Starts for the fits of candidate models, such that they do not get stuck."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from identifiability.joint.model import Model

_FACTORS = (0.4, 1.0, 2.5)
_MOST_STARTS = 6


def starting_values(
    model: Model, known: Mapping[str, float], *, most: int = _MOST_STARTS
) -> list[dict[str, float]]:
    """Starts for a model some of whose parameters are known from a smaller one.

    A new effect starts near its null, where the best size is found at once, at several values of
    its shape parameters; an effect that vanishes with infinite stiffness starts at several
    stiffnesses, with K and B raised to make up for it.

    Parameters
    ----------
    model : Model
    known : mapping of str to float
        K, B, I and the parameters of the effects that were there before.
    most : int
        Number of starts.
    """
    grids: list[list[float]] = []
    names = model.parameter_names
    for name, p in model.parameters.items():
        if name in known:
            grids.append([known[name]])
        elif p.plain is not None:
            grids.append([p.plain])
        elif p.null is not None and np.isfinite(p.null):
            grids.append([p.null + 0.01 * (p.nominal - p.null)])
        elif p.null is not None:
            grids.append([3 * known["K"] + 1.0, 10 * known["K"] + 1.0])
        elif p.lower > 0 and p.upper / p.lower > 10:
            grids.append([float(np.clip(f * p.nominal, p.lower, p.upper)) for f in _FACTORS])
        else:
            grids.append([p.lower + s * (p.upper - p.lower) for s in (0.5, 0.25, 0.75)])
    every = list(itertools.product(*grids))
    # Spread over the grid; the middle one, of nominal shape, comes first.
    chosen = np.unique(np.linspace(0, len(every) - 1, most).astype(int))
    starts = [dict(zip(names, every[i], strict=True)) for i in chosen]
    for start in starts:
        for name, p in model.parameters.items():
            if name not in known and p.null is not None and not np.isfinite(p.null):
                softened = 1 + start["K"] / start[name]
                start["K"] *= softened
                start["B"] *= softened**2
    return starts
