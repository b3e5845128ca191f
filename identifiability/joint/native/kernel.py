"""The code of a model: its torque and rates, and what it is about rest."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from threading import Lock
from typing import Any

import jax
import numpy as np

from identifiability.joint.effects.base import Motion
from identifiability.joint.model import Model
from identifiability.joint.native.expressions import Graph
from identifiability.joint.native.machine import LANES, Code, Row
from identifiability.joint.native.tracing import Untraceable, expressions_of

_MOST = 60_000  # expressions, beyond which compiling them takes longer than JAX's loops

_MOST_KEPT = 1000  # kernels, of some 100 kB each

_kept: dict[Hashable, Kernel | None] = {}  # the last that was asked for at the end
_locks: dict[Hashable, Lock] = {}
_guard = Lock()


@dataclass(frozen=True, eq=False)
class Kernel:
    """Code of a model with derivatives by some of its parameters.

    Attributes
    ----------
    model : Model
    free : tuple of int
        Parameters by which there are derivatives.
    n_delays : int
        Effects that see the motion that was a delay ago.
    moving : Code
        Of parameters, angle, velocity, internal states, past motions and applied torque the
        torque, the acceleration and the rates of the internal states.
    turning : Code
        Of the same the derivatives of the internal states' rates by these states.
    still : Code
        Of the parameters the derivatives at rest of what is moving, the delays, and the inertia
        that is driven.
    """

    model: Model
    free: tuple[int, ...]
    n_delays: int
    moving: Code
    turning: Code
    still: Code

    @property
    def width(self) -> int:
        """Room for the value and derivatives of what depends on the parameters."""
        return _wide(self.free)


def kernel_of(model: Model, free: tuple[int, ...]) -> Kernel | None:
    """Code of a model, made once and kept; none of a model that JAX has to compute.

    Parameters
    ----------
    model : Model
    free : tuple of int
        Parameters by which derivatives are wanted.
    """
    key = (model, free)
    with _guard:
        lock = _locks.setdefault(key, Lock())
    with lock:
        if key in _kept:
            found = _kept[key]
        else:
            try:
                found = _made(model, free)
            except Untraceable:
                found = None
    with _guard:
        _kept.pop(key, None)
        _kept[key] = found
        while len(_kept) > _MOST_KEPT:
            oldest = next(iter(_kept))
            del _kept[oldest]
            _locks.pop(oldest, None)
    return found


def _wide(free: tuple[int, ...]) -> int:
    return LANES * -(-(1 + len(free)) // LANES)


def _made(model: Model, free: tuple[int, ...]) -> Kernel:
    n, k = model.n_internal, len(model.parameter_names)
    delayed = [i for i, delay in enumerate(model.delays(model.nominal)) if delay is not None]

    def react(theta: Any, moving: Any, past: Any) -> Any:
        motion = Motion(moving[0], moving[1])
        seen = [motion] * len(model.effects)
        for i, place in enumerate(delayed):
            seen[place] = Motion(past[2 * i], past[2 * i + 1])
        reaction = model.react(theta, motion, moving[2:], seen)
        delays = [d for d in model.delays(theta) if d is not None]
        return reaction.torque, reaction.rates, delays, model.inertia(theta)

    n_past = 2 * len(delayed)
    traced = jax.make_jaxpr(react)(np.zeros(k), np.zeros(2 + n), np.zeros(n_past))
    graph, width = Graph(), _wide(free)
    inputs = np.array([graph.input(i) for i in range(k + 2 + n + n_past)], object)
    given = np.split(inputs, [k, k + 2 + n])
    torque, rates, *delays, inertia = expressions_of(graph, traced, given)
    applied = graph.input(len(inputs))
    acceleration = graph.of("div", graph.of("sub", applied, torque.item()), inertia.item())
    outputs = [torque.item(), acceleration, *rates.tolist()]
    moved = list(range(k, k + 2 + n + n_past))
    slopes = graph.derivatives(outputs, [*free, *moved])
    by_motion = [row[len(free) :] for row in slopes]
    # Where nothing has derivatives, nor does what it depends on.
    moving = [
        Row(value, row[: len(free)], by[: 2 + n], by[2 + n :]) if free else Row(value, ())
        for value, row, by in zip(outputs, slopes, by_motion, strict=True)
    ]
    turning = [Row(one, ()) for row in by_motion[2:] for one in row[2 : 2 + n]]
    by_state = [one for row in by_motion for one in row[: 2 + n]]
    resting = graph.substituted(by_state, dict.fromkeys([*moved, len(inputs)], 0.0))
    resting += [delay.item() for delay in delays] + [inertia.item()]
    bends = graph.derivatives(resting, free)
    still = [Row(value, row) for value, row in zip(resting, bends, strict=True)]
    if len(graph.nodes) > _MOST:
        raise Untraceable(f"{len(graph.nodes)} expressions")
    return Kernel(
        model,
        free,
        len(delayed),
        Code(graph, moving, width),
        Code(graph, turning, LANES),
        Code(graph, still, width),
    )
