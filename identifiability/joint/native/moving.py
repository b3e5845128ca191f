"""A model at one parameter vector and what moves it, for compiled loops.

Arrays of what depends on parameters have the value and then each derivative along the last axis,
whose length is a multiple of four.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from identifiability.loops import compiled_loop


class Machine(NamedTuple):
    """A model at one parameter vector.

    Attributes
    ----------
    moving, turning : int
        Addresses of its code, see `Kernel`.
    theta : array, shape (n_parameters,)
    alone : bool
        Whether there are no derivatives.
    rest : array, shape (2 + n_internal, 2 + n_internal, width)
        Derivatives at rest of torque, acceleration and internal states' rates by angle, velocity
        and internal states.
    delays : array, shape (n_delays, width)
        In s.
    inertia : array, shape (width,)
        Of what is driven and measured [kg m²].
    """

    moving: int
    turning: int
    theta: np.ndarray
    alone: bool
    rest: np.ndarray
    delays: np.ndarray
    inertia: np.ndarray


class Imposed(NamedTuple):
    """An imposed signal, as it is within steps.

    Attributes
    ----------
    interval : float
    angle : bool
        Whether it is an angle.
    given : array, shape (n, q)
        The torque, or angle, velocity and acceleration, at the samples.
    states : array, shape (n, m)
        Of what generates it, at the samples.
    signals : array, shape (2 * substeps + 1, q, m)
        What makes of them what is `given`, at start and middle of every step of an interval, and
        at its end.
    generator : array, shape (m, m)
    impulses : array, shape (n,)
    """

    interval: float
    angle: bool
    given: np.ndarray
    states: np.ndarray
    signals: np.ndarray
    generator: np.ndarray
    impulses: np.ndarray


@compiled_loop
def signal(imposed: Imposed, sample: int, place: int, out: np.ndarray) -> None:
    """What is imposed, shape (q,), at a place in the interval from a sample on."""
    every, states = imposed.signals, imposed.states
    if out.size == 3:
        # Side by side: each sum waits for itself.
        angle = velocity = acceleration = 0.0
        for j in range(states.shape[1]):
            size = states[sample, j]
            angle += every[place, 0, j] * size
            velocity += every[place, 1, j] * size
            acceleration += every[place, 2, j] * size
        out[0], out[1], out[2] = angle, velocity, acceleration
        return
    for i in range(out.size):
        total = 0.0
        for j in range(states.shape[1]):
            total += every[place, i, j] * states[sample, j]
        out[i] = total


@compiled_loop
def over_inertia(machine: Machine, torque: float, out: np.ndarray) -> None:
    """Add the acceleration by a torque [Nm], with its derivative."""
    moved = torque / machine.inertia[0]
    out[0] += moved
    for t in range(1, out.size):
        out[t] -= moved * machine.inertia[t] / machine.inertia[0]


@compiled_loop
def add_inertial(machine: Machine, acceleration: float, out: np.ndarray) -> None:
    """Add the torque that an acceleration takes, with its derivatives."""
    for t in range(out.size):
        out[t] += machine.inertia[t] * acceleration


@compiled_loop
def linear_part(machine: Machine, angle: bool) -> np.ndarray:
    """Derivatives at rest of the rates of the state by the state."""
    n, width = machine.rest.shape[1:]
    out = np.zeros((n, n, width))
    first = 2 if angle else 0
    for i in range(max(first, 1), n):
        for j in range(first, n):
            for t in range(width):
                out[i, j, t] = machine.rest[i, j, t]
    if not angle:
        out[0, 1, 0] = 1.0
    return out
