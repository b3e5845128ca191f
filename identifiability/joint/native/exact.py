"""The exact response of a linear model, see `response`, with first derivatives, see `moving`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from identifiability.joint.native.calls import add_forced, copy_row, set_product
from identifiability.joint.native.duals import (
    exponential,
    exponential_of_values,
    halvings,
    list_entries,
    solved,
)
from identifiability.joint.native.moving import (
    Imposed,
    Machine,
    add_inertial,
    linear_part,
    over_inertia,
)
from identifiability.loops import compiled_loop


class Propagator(NamedTuple):
    """From one sample to the next.

    Attributes
    ----------
    onward : array, shape (n, n)
        Of the state.
    slopes : array, shape (n, n, width)
        Its derivatives; 0 in the place of the value.
    entries : array of int, shape (n, n, 3)
        Which there are, see `duals.list_entries`.
    forced : array, shape (n, m, width)
        What it becomes by what generates the imposed signal.
    """

    onward: np.ndarray
    slopes: np.ndarray
    entries: np.ndarray
    forced: np.ndarray


@compiled_loop
def propagator_of(machine: Machine, imposed: Imposed) -> Propagator:
    """How a model and what drives it go from one sample to the next."""
    n, m, width = machine.rest.shape[1], imposed.states.shape[1], machine.rest.shape[2]
    wide = 1 if machine.alone else width
    linear = linear_part(machine, imposed.angle)
    joined = np.zeros((n + m, n + m, wide))
    for i in range(n):
        for j in range(n):
            for t in range(wide):
                joined[i, j, t] = imposed.interval * linear[i, j, t]
    push = np.zeros(width)
    for j in range(m):
        for i in range(m):
            joined[n + i, n + j, 0] = imposed.interval * imposed.generator[i, j]
        if not imposed.angle:
            for t in range(width):
                push[t] = 0.0
            over_inertia(machine, imposed.interval * imposed.signals[0, 0, j], push)
            for t in range(wide):
                joined[1, n + j, t] += push[t]
        else:
            for i in range(2, n):
                for s in range(2):
                    for t in range(wide):
                        joined[i, n + j, t] += (
                            imposed.interval * machine.rest[i, s, t] * imposed.signals[0, s, j]
                        )
    moved = exponential(joined)
    onward, slopes, forced = np.zeros((n, n)), np.zeros((n, n, width)), np.zeros((n, m, width))
    for i in range(n):
        for j in range(n):
            onward[i, j] = moved[i, j, 0]
            for t in range(1, wide):
                slopes[i, j, t] = moved[i, j, t]
        for j in range(m):
            for t in range(wide):
                forced[i, j, t] = moved[i, n + j, t]
    entries = np.empty((n, n, 3), np.int64)
    list_entries(onward, slopes, entries)
    return Propagator(onward, slopes, entries, forced)


@compiled_loop
def _settled(machine: Machine, angle: float, state: np.ndarray) -> None:
    """Internal states in equilibrium at an angle, into a state."""
    n, width = machine.rest.shape[1], machine.rest.shape[2]
    system, right = np.zeros((n - 2, n - 2)), np.zeros((n - 2, width))
    for turn in range(2):
        for i in range(n - 2):
            for j in range(n - 2):
                system[i, j] = machine.rest[2 + i, 2 + j, 0]
            for t in range(width):
                right[i, t] = -machine.rest[2 + i, 0, t] * angle
                if t and turn:
                    for j in range(n - 2):
                        right[i, t] -= machine.rest[2 + i, 2 + j, t] * state[2 + j, 0]
        solved(system, right)
        for i in range(n - 2):
            for t in range(width):
                state[2 + i, t] = right[i, t]


@compiled_loop
def exact(machine: Machine, imposed: Imposed, by: Propagator, out: np.ndarray) -> None:
    """Exact response of a linear model, into `out`, shape (n, width)."""
    if machine.alone:
        _values(machine, imposed, by, out)
        return
    n, width, rest = machine.rest.shape[1], out.shape[1], machine.rest
    state, moved = np.zeros((n, width)), np.zeros((n, width))
    first = 2 if imposed.angle else 0
    if imposed.angle and n > 2:
        _settled(machine, imposed.given[0, 0], state)
    for k in range(out.shape[0]):
        if imposed.angle:
            angle, velocity = imposed.given[k, 0], imposed.given[k, 1]
            acceleration = imposed.given[k, 2]
            for t in range(width):
                out[k, t] = rest[0, 0, t] * angle + rest[0, 1, t] * velocity
                for j in range(2, n):
                    out[k, t] += rest[0, j, 0] * state[j, t]
                    if t:
                        out[k, t] += rest[0, j, t] * state[j, 0]
            add_inertial(machine, acceleration, out[k])
        else:
            if imposed.impulses[k] != 0.0:
                over_inertia(machine, imposed.impulses[k], state[1])
            copy_row(state, 0, out, k)
        set_product(by.onward, by.slopes, by.entries, 0, state, moved, 0, first)
        add_forced(by.forced, imposed.states[k], moved, first)
        state, moved = moved, state


@compiled_loop
def _values(machine: Machine, imposed: Imposed, by: Propagator, out: np.ndarray) -> None:
    """The same without derivatives."""
    n, m, rest = machine.rest.shape[1], imposed.states.shape[1], machine.rest
    state, moved = np.zeros(n), np.zeros(n)
    first = 2 if imposed.angle else 0
    if imposed.angle and n > 2:
        begin = np.zeros((n, rest.shape[2]))
        _settled(machine, imposed.given[0, 0], begin)
        for i in range(2, n):
            state[i] = begin[i, 0]
    for k in range(out.shape[0]):
        if imposed.angle:
            value = rest[0, 0, 0] * imposed.given[k, 0] + rest[0, 1, 0] * imposed.given[k, 1]
            for j in range(2, n):
                value += rest[0, j, 0] * state[j]
            out[k, 0] = value + machine.inertia[0] * imposed.given[k, 2]
        else:
            if imposed.impulses[k] != 0.0:
                state[1] += imposed.impulses[k] / machine.inertia[0]
            out[k, 0] = state[0]
        for i in range(first, n):
            value = 0.0
            for j in range(first, n):
                value += by.onward[i, j] * state[j]
            for j in range(m):
                value += by.forced[i, j, 0] * imposed.states[k, j]
            moved[i] = value
        state, moved = moved, state


@compiled_loop
def of_two(machine: Machine, imposed: Imposed, out: np.ndarray) -> None:
    """Values of a joint without internal states that a torque moves: most of what studies ask for.

    Nothing is made but one matrix and room for it: what is made takes longer than what is computed.
    """
    m, interval, mobility = imposed.states.shape[1], imposed.interval, 1.0 / machine.inertia[0]
    stiff, damped = interval * machine.rest[1, 0, 0], interval * machine.rest[1, 1, 0]
    if m == 0 or (m == 1 and imposed.generator[0, 0] == 0.0):
        push = interval * mobility * imposed.signals[0, 0, 0] if m else 0.0
        a, b, c, d, e, f = _held(interval, stiff, damped, push)
        angle = velocity = 0.0
        for k in range(out.shape[0]):
            out[k, 0] = angle
            torque, pushed = imposed.states[k, 0] if m else 0.0, mobility * imposed.impulses[k]
            # What does not wait for the sample before comes first.
            angle, velocity = (
                a * angle + (b * velocity + (b * pushed + e * torque)),
                c * angle + (d * velocity + (d * pushed + f * torque)),
            )
        return
    joined = np.zeros((2 + m, 2 + m))
    joined[0, 1], joined[1, 0], joined[1, 1] = interval, stiff, damped
    for j in range(m):
        joined[1, 2 + j] = interval * mobility * imposed.signals[0, 0, j]
        for i in range(m):
            joined[2 + i, 2 + j] = interval * imposed.generator[i, j]
    by = exponential_of_values(joined)
    a, b, c, d = by[0, 0], by[0, 1], by[1, 0], by[1, 1]
    angle = velocity = 0.0
    for k in range(out.shape[0]):
        velocity += imposed.impulses[k] * mobility
        out[k, 0] = angle
        angle, velocity = a * angle + b * velocity, c * angle + d * velocity
        for j in range(m):
            angle += by[0, 2 + j] * imposed.states[k, j]
            velocity += by[1, 2 + j] * imposed.states[k, j]


@compiled_loop
def _held(
    interval: float, stiff: float, damped: float, push: float
) -> tuple[float, float, float, float, float, float]:
    """From one sample to the next, under no torque or one that is held.

    The upper rows of the exponential of ``[[0, interval, 0], [stiff, damped, push], [0, 0, 0]]``,
    by the same series as any other, without arrays.
    """
    count, terms = halvings(max(abs(stiff), interval + abs(damped), abs(push)))
    scale = 2.0**-count
    q, r, s, u = scale * interval, scale * stiff, scale * damped, scale * push
    a, b, c, d, e, f = 1.0, 0.0, 0.0, 1.0, 0.0, 0.0
    for k in range(terms):
        share = 1.0 / (terms - k)
        a, b, c, d, e, f = (
            share * (q * c) + 1.0,
            share * (q * d),
            share * (r * a + s * c),
            share * (r * b + s * d) + 1.0,
            share * (q * f),
            share * (r * e + s * f + u),
        )
    for _ in range(count):
        a, b, c, d, e, f = (
            a * a + b * c,
            a * b + b * d,
            c * a + d * c,
            c * b + d * d,
            a * e + b * f + e,
            c * e + d * f + f,
        )
    return a, b, c, d, e, f
