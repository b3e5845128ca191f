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
from identifiability.joint.native.machine import Code
from identifiability.joint.native.steps import Machine
from identifiability.joint.native.tracing import Untraceable, expressions_of

_MOST = 60_000  # expressions, beyond which compiling them takes longer than JAX's loops

_kept: dict[Hashable, Kernel | None] = {}
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
    moving, still : Code
        Torque, rates and their derivatives; derivatives at rest, and delays.
    """

    model: Model
    free: tuple[int, ...]
    n_delays: int
    moving: Code
    still: Code

    @property
    def width(self) -> int:
        """Number of values and derivatives of what depends on the parameters."""
        return 1 + len(self.free)

    def at(self, theta: np.ndarray) -> Machine:
        """The model at one parameter vector."""
        theta = np.ascontiguousarray(theta, float)
        n = self.model.n_internal
        size = (1 + n) * (2 + n)
        flat = self.still(theta, (size + self.n_delays) * self.width).reshape(-1, self.width)
        return Machine(
            self.moving.address,
            theta,
            1 + self.free.index(2) if 2 in self.free else 0,
            np.ascontiguousarray(flat[:size].reshape(1 + n, 2 + n, self.width)),
            np.ascontiguousarray(flat[size:]),
        )


def kernel_of(model: Model, free: tuple[int, ...]) -> Kernel | None:
    """Code of a model, made once; none of a model that JAX has to compute.

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
        if key not in _kept:
            try:
                _kept[key] = _made(model, free)
            except Untraceable:
                _kept[key] = None
    return _kept[key]


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
        return reaction.torque, reaction.rates, delays

    n_past = 2 * len(delayed)
    traced = jax.make_jaxpr(react)(np.zeros(k), np.zeros(2 + n), np.zeros(n_past))
    graph = Graph()
    inputs = np.array([graph.input(i) for i in range(k + 2 + n + n_past)], object)
    given = np.split(inputs, [k, k + 2 + n])
    torque, rates, *delays = expressions_of(graph, traced, given)
    outputs = [torque.item(), *rates.tolist()]
    moved = list(range(k, k + 2 + n + n_past))
    slopes = graph.derivatives(outputs, [*free, *moved])
    moving = [*outputs, *(one for row in slopes for one in row)]
    by_motion = [one for row in slopes for one in row[len(free) : len(free) + 2 + n]]
    resting = graph.substituted(by_motion, dict.fromkeys(moved, 0.0))
    resting += [delay.item() for delay in delays]
    bends = graph.derivatives(resting, free)
    still = [v for one, row in zip(resting, bends, strict=True) for v in (one, *row)]
    if len(graph.nodes) > _MOST:
        raise Untraceable(f"{len(graph.nodes)} expressions")
    return Kernel(model, free, len(delayed), Code(graph, moving), Code(graph, still))
