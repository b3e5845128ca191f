"""The steps of `integrator` and the exact response of `response`, with first derivatives.

Arrays of what depends on parameters have the value and then each derivative along the last axis. A
model comes as the address of its code, which makes of ``(parameters, angle, velocity, states, past
motions)`` the torque, the states' rates, and the derivatives of both.

Both causalities take the same steps of the state [angle, velocity, internal states]: where the
angle is imposed its first two entries are given.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from identifiability.joint.native.duals import (
    add_product,
    added,
    exponential,
    phi_functions,
    solved,
)
from identifiability.loops import compiled_loop

_NEWTON_STEPS = 22


class Machine(NamedTuple):
    """A model at one parameter vector.

    Attributes
    ----------
    address : int
        Of the code of its torque and rates.
    theta : array, shape (n_parameters,)
    inertia : int
        Which derivative is that by the inertia, from 1; 0 if none.
    rest : array, shape (1 + n_internal, 2 + n_internal, width)
        Derivatives of torque and rates at rest by angle, velocity and internal states.
    delays : array, shape (n_delays, width)
        In s.
    """

    address: int
    theta: np.ndarray
    inertia: int
    rest: np.ndarray
    delays: np.ndarray


class Imposed(NamedTuple):
    """An imposed signal, as it is within steps.

    Attributes
    ----------
    interval : float
    angle : bool
        Whether it is an angle.
    states : array, shape (n, m)
        Of what generates it, at the samples.
    signals : array, shape (2 * substeps + 1, q, m)
        What makes of them the torque, or angle, velocity and acceleration, at start and middle of
        every step of an interval, and at its end.
    generator : array, shape (m, m)
    impulses : array, shape (n,)
    """

    interval: float
    angle: bool
    states: np.ndarray
    signals: np.ndarray
    generator: np.ndarray
    impulses: np.ndarray


@compiled_loop
def _signal(imposed: Imposed, sample: int, place: int, out: np.ndarray) -> None:
    """What is imposed, shape (q,), at a place in the interval from a sample on."""
    for i in range(out.size):
        out[i] = 0.0
        for j in range(imposed.states.shape[1]):
            out[i] += imposed.signals[place, i, j] * imposed.states[sample, j]


class _Room(NamedTuple):
    """Where a model's code reads and writes: all inputs, those that move, and all outputs."""

    given: np.ndarray
    moved: np.ndarray
    raw: np.ndarray


@intrinsic
def _run(typing: Any, address: Any, given: Any, out: Any) -> Any:
    signature = types.void(types.intp, given, out)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        function = builder.inttoptr(args[0], kind.as_pointer())
        arrays = [
            context.make_array(kind_of)(context, builder, value).data
            for kind_of, value in zip(signature.args[1:], args[1:], strict=True)
        ]
        builder.call(function, arrays)
        return context.get_dummy_value()

    return signature, generate


@compiled_loop
def _react(
    machine: Machine, state: np.ndarray, past: np.ndarray, room: _Room, out: np.ndarray
) -> None:
    """Torque and rates of the internal states, shape (1 + n_internal, width)."""
    first, (n, width), n_past = machine.theta.size, state.shape, past.shape[0]
    for j in range(n):
        room.given[first + j] = state[j, 0]
        for t in range(width):
            room.moved[j, t] = state[j, t]
    for j in range(n_past):
        room.given[first + n + j] = past[j, 0]
        for t in range(width):
            room.moved[n + j, t] = past[j, t]
    _run(machine.address, room.given, room.raw)
    rows, columns = out.shape[0], width - 1 + n + n_past
    for i in range(rows):
        at = rows + i * columns
        out[i, 0] = room.raw[i]
        for t in range(1, width):
            out[i, t] = room.raw[at + t - 1]
        for j in range(n + n_past):
            slope = room.raw[at + width - 1 + j]
            if slope != 0.0:
                for t in range(1, width):
                    out[i, t] += slope * room.moved[j, t]


@compiled_loop
def _over_inertia(machine: Machine, torque: np.ndarray, size: float, out: np.ndarray) -> None:
    """``size torque / I`` into `out`, both of shape (width,)."""
    for t in range(out.size):
        out[t] = size * torque[t] / machine.theta[2]
    if machine.inertia:
        out[machine.inertia] -= out[0] / machine.theta[2]


@compiled_loop
def _linear_part(machine: Machine, angle: bool) -> np.ndarray:
    """Derivatives at rest of the rates of the state by the state."""
    rows, n, width = machine.rest.shape
    out = np.zeros((n, n, width))
    for i in range(1, rows):
        for j in range(2 if angle else 0, n):
            for t in range(width):
                out[1 + i, j, t] = machine.rest[i, j, t]
    if not angle:
        out[0, 1, 0] = 1.0
        for j in range(n):
            _over_inertia(machine, machine.rest[0, j], -1.0, out[1, j])
    return out


class _Scheme(NamedTuple):
    """An exponential Runge-Kutta scheme: how stages follow from each other.

    The point that stage k leads to is ``bases[k] points[base[k]] + sum of parts[k, j] rest[j]``.
    """

    places: np.ndarray
    base: np.ndarray
    bases: np.ndarray
    parts: np.ndarray
    used: np.ndarray


@compiled_loop
def _scheme(linear: np.ndarray, step: float, order: int) -> _Scheme:
    n, width = linear.shape[0], linear.shape[2]
    whole = np.empty_like(linear)
    added(linear, step, linear, 0.0, whole)
    half, full = phi_functions(whole)
    count = 2 if order == 2 else 4
    places, base = np.zeros(count, np.int64), np.zeros(count, np.int64)
    bases = np.zeros((count, n, n, width))
    parts = np.zeros((count, count, n, n, width))
    used = np.zeros((count, count), np.int64)
    if order == 2:
        places[1], base[1] = 2, 1
        added(full[0], 1.0, full[0], 0.0, bases[0])
        for i in range(n):
            bases[1, i, i, 0] = 1.0
        added(full[1], step, full[1], 0.0, parts[0, 0])
        added(full[2], step, full[2], 0.0, parts[1, 1])
        added(full[2], -step, full[2], 0.0, parts[1, 0])
        used[0, 0] = used[1, 0] = used[1, 1] = 1
    else:
        places[1] = places[2] = 1
        places[3] = 2
        base[2] = 1
        for k in range(3):
            added(half[0], 1.0, half[0], 0.0, bases[k])
        added(full[0], 1.0, full[0], 0.0, bases[3])
        added(half[1], 0.5 * step, half[1], 0.0, parts[0, 0])
        added(half[1], 0.5 * step, half[1], 0.0, parts[1, 1])
        added(half[1], step, half[1], 0.0, parts[2, 2])
        added(half[1], -0.5 * step, half[1], 0.0, parts[2, 0])
        added(full[1], step, full[2], -3.0 * step, parts[3, 0])
        added(parts[3, 0], 1.0, full[3], 4.0 * step, parts[3, 0])
        for j in (1, 2):
            added(full[2], 2.0 * step, full[3], -4.0 * step, parts[3, j])
        added(full[3], 4.0 * step, full[2], -step, parts[3, 3])
        used[0, 0] = used[1, 1] = used[2, 2] = used[2, 0] = 1
        for j in range(4):
            used[3, j] = 1
    return _Scheme(places, base, bases, parts, used)


@compiled_loop
def _slot(place: float, ends_step: bool) -> int:
    """Number of the step that a place is in; at its start, of the step that ends there if asked."""
    if not abs(place) < 1e15:
        return -1  # of what is no place in any record
    return int(math.ceil(place - 1e-6)) - 1 if ends_step else int(math.floor(place + 1e-6))


@compiled_loop
def _hermite(
    s: float, step: float, y0: np.ndarray, d0: np.ndarray, y1: np.ndarray, d1: np.ndarray,
    out: np.ndarray,
) -> float:
    """Cubic through two values and slopes at the fraction `s` of a step; its slope in time."""
    a, b = (1.0 + 2.0 * s) * (1.0 - s) ** 2, step * s * (1.0 - s) ** 2
    c, d = s**2 * (3.0 - 2.0 * s), step * s**2 * (s - 1.0)
    for t in range(out.size):
        out[t] = a * y0[t] + b * d0[t] + c * y1[t] + d * d1[t]
    return (
        6.0 * s * (s - 1.0) * (y0[0] - y1[0]) / step
        + (1.0 - s) * (1.0 - 3.0 * s) * d0[0]
        + s * (3.0 * s - 2.0) * d1[0]
    )


@compiled_loop
def _quintic(s: float, step: float, start: np.ndarray, end: np.ndarray, out: np.ndarray) -> None:
    """Value, slope and second derivative of the quintic through two motions."""
    rise, d0, d1 = end[0] - start[0], step * start[1], step * end[1]
    a0, a1 = step**2 * start[2], step**2 * end[2]
    c2 = a0 / 2.0
    c3 = 10.0 * rise - 6.0 * d0 - 4.0 * d1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * rise + 8.0 * d0 + 7.0 * d1 + 1.5 * a0 - a1
    c5 = 6.0 * rise - 3.0 * d0 - 3.0 * d1 - 0.5 * a0 + 0.5 * a1
    out[0] = start[0] + s * (d0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
    out[1] = (d0 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))) / step
    out[2] = (2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))) / step**2


@compiled_loop
def _recall(
    machine: Machine,
    imposed: Imposed,
    history: np.ndarray,
    index: int,
    step: float,
    place: int,
    state: np.ndarray,
    out: np.ndarray,
) -> None:
    """Motions a delay ago, shape (2 n_delays, width): see `integrator._recall`."""
    width = state.shape[1]
    start, end, motion = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(machine.delays.shape[0]):
        time = (index + 0.5 * place) * step - machine.delays[k, 0]
        angle, velocity = out[2 * k], out[2 * k + 1]
        for t in range(width):
            angle[t] = velocity[t] = 0.0
        slope = bend = 0.0
        slot = _slot(time / (imposed.interval if imposed.angle else step), place == 2)
        if imposed.angle:
            known = max(0, min(slot, imposed.states.shape[0] - 2))
            _signal(imposed, known, 0, start)
            if slot < 0:
                angle[0] = start[0]
            else:
                _signal(imposed, known, imposed.signals.shape[0] - 1, end)
                _quintic(time / imposed.interval - known, imposed.interval, start, end, motion)
                angle[0], velocity[0], slope, bend = motion[0], motion[1], motion[1], motion[2]
        elif slot >= index:
            # A delay shorter than a step reaches into the step being taken.
            ahead = time - index * step
            for t in range(width):
                last = history[index - 1, 5, t] if index > 0 else 0.0
                angle[t] = state[0, t] + ahead * state[1, t] + 0.5 * ahead**2 * last
                velocity[t] = state[1, t] + ahead * last
            bend = history[index - 1, 5, 0] if index > 0 else 0.0
            slope = state[1, 0] + ahead * bend
        elif slot >= 0:
            s, row = time / step - slot, history[slot]
            slope = _hermite(s, step, row[0], row[1], row[3], row[4], angle)
            bend = _hermite(s, step, row[1], row[2], row[4], row[5], velocity)
        for t in range(1, width):
            angle[t] -= machine.delays[k, t] * slope
            velocity[t] -= machine.delays[k, t] * bend


@compiled_loop
def _equilibrium(
    machine: Machine, state: np.ndarray, past: np.ndarray, room: _Room, reaction: np.ndarray
) -> None:
    """Internal states in equilibrium at the angle of a state, by Newton's method from 0."""
    n, width = machine.rest.shape[0] - 1, state.shape[1]
    columns = width - 1 + 2 + n + past.shape[0]
    slopes, right = np.zeros((n, n)), np.zeros((n, width))
    for k in range(past.shape[0] // 2):
        past[2 * k, 0] = state[0, 0]
    for _ in range(_NEWTON_STEPS):
        for i in range(n):
            for t in range(1, width):
                state[2 + i, t] = 0.0
        _react(machine, state, past, room, reaction)
        for i in range(n):
            for j in range(n):
                slopes[i, j] = room.raw[n + 1 + (i + 1) * columns + width - 1 + 2 + j]
            # Keeps at 0 a state that any value would leave at rest.
            slopes[i, i] -= 1e-12
            for t in range(width):
                right[i, t] = reaction[i + 1, t]
        solved(slopes, right)
        for i in range(n):
            for t in range(width):
                state[2 + i, t] -= right[i, t]


@compiled_loop
def integrated(
    machine: Machine, imposed: Imposed, substeps: int, order: int, out: np.ndarray
) -> None:
    """Response in steps, into `out`, shape (n, width)."""
    (rows, n), width, n_samples = machine.rest.shape[:2], out.shape[1], out.shape[0]
    n_past = 2 * machine.delays.shape[0]
    step = imposed.interval / substeps
    n_steps = (n_samples - 1) * substeps
    linear = _linear_part(machine, imposed.angle)
    scheme = _scheme(linear, step, order)
    n_stages = scheme.places.size
    # Those of an imposed angle need no steps where there are no states.
    idle = imposed.angle and n == 2
    first = 2 if imposed.angle else 0
    history = np.zeros((n_steps if n_past and not imposed.angle else 0, 6, width))
    pasts, before = np.zeros((3, n_past, width)), np.zeros((n_past, width))
    room = _Room(
        np.zeros(machine.theta.size + n + n_past),
        np.zeros((n + n_past, width)),
        np.zeros(rows * (width + n + n_past)),
    )
    for j in range(machine.theta.size):
        room.given[j] = machine.theta[j]
    reaction = np.zeros((rows, width))
    points, rest = np.zeros((n_stages + 1, n, width)), np.zeros((n_stages, n, width))
    rates, kick = np.zeros((n, width)), np.zeros(width)
    applied = np.zeros(imposed.signals.shape[1])
    if imposed.angle:
        _signal(imposed, 0, 0, applied)
        points[0, 0, 0] = applied[0]
        _equilibrium(machine, points[0], pasts[0], room, reaction)
    for index in range(n_steps + 1):
        sample, within = index // substeps, 2 * (index % substeps)
        if index == n_steps and not imposed.angle:
            break
        if not within and not imposed.angle and imposed.impulses[sample] != 0.0:
            for t in range(width):
                kick[t] = 0.0
            kick[0] = 1.0
            _over_inertia(machine, kick, imposed.impulses[sample], rates[0])
            for t in range(width):
                points[0, 1, t] += rates[0, t]
        # The two-stage scheme takes the end of one step for the start of the next, where no impulse
        # made the motion jump.
        for place in range(3):
            if n_past and (place != 1 or order == 4):
                _recall(
                    machine, imposed, history, index, step, place, points[0], pasts[place]
                )
        if order == 2 and not imposed.angle:
            for j in range(n_past):
                for t in range(width):
                    pasts[0, j, t], before[j, t] = before[j, t], pasts[2, j, t]
        # One more than there are stages: the rates where the step ends, for the history.
        for k in range(n_stages + 1):
            place = scheme.places[k] if k < n_stages else 2
            if k == n_stages and (order == 2 or not n_past or imposed.angle):
                break
            point = points[k]
            _signal(imposed, sample, within + place, applied)
            if imposed.angle:
                for i in range(2):
                    for t in range(width):
                        point[i, t] = 0.0
                    point[i, 0] = applied[i]
            _react(machine, point, pasts[place], room, reaction)
            if imposed.angle and k == 0 and not within:
                for t in range(width):
                    out[sample, t] = reaction[0, t]
                out[sample, 0] += machine.theta[2] * applied[2]
                if machine.inertia:
                    out[sample, machine.inertia] += applied[2]
                if idle or index == n_steps:
                    break
            for i in range(1, rows):
                for t in range(width):
                    rates[1 + i, t] = reaction[i, t]
            if not imposed.angle:
                reaction[0, 0] -= applied[0]
                _over_inertia(machine, reaction[0], -1.0, rates[1])
                for t in range(width):
                    rates[0, t] = point[1, t]
            if n_past and not imposed.angle and (k == 0 or k == n_stages):
                at = 2 if k == 0 else 5
                for t in range(width):
                    history[index, at, t] = rates[1, t]
            if k == n_stages:
                break
            for i in range(n):
                for t in range(width):
                    rest[k, i, t] = 0.0
            add_product(linear, point, rest[k], first)
            for i in range(n):
                for t in range(width):
                    rest[k, i, t] = rates[i, t] - rest[k, i, t]
            target = points[k + 1]
            for i in range(n):
                for t in range(width):
                    target[i, t] = 0.0
            add_product(scheme.bases[k], points[scheme.base[k]], target, first)
            for j in range(k + 1):
                if scheme.used[k, j]:
                    add_product(scheme.parts[k, j], rest[j], target, first)
        if idle or index == n_steps:
            continue
        arrived = points[n_stages]
        if history.shape[0]:
            if order == 2:
                for t in range(width):
                    history[index, 5, t] = rest[1, 1, t]
                for j in range(n):
                    a, b = linear[1, j, 0], arrived[j, 0]
                    history[index, 5, 0] += a * b
                    for t in range(1, width):
                        history[index, 5, t] += a * arrived[j, t] + linear[1, j, t] * b
            for i in range(2):
                for t in range(width):
                    history[index, i, t] = points[0, i, t]
                    history[index, 3 + i, t] = arrived[i, t]
        for i in range(n):
            for t in range(width):
                points[0, i, t] = arrived[i, t]
        if not imposed.angle:
            for t in range(width):
                out[sample + 1, t] = arrived[0, t]


@compiled_loop
def exact(machine: Machine, imposed: Imposed, out: np.ndarray) -> None:
    """Exact response of a linear model, into `out`, shape (n, width)."""
    n, m, width = machine.rest.shape[1], imposed.states.shape[1], out.shape[1]
    linear = _linear_part(machine, imposed.angle)
    joined = np.zeros((n + m, n + m, width))
    unit = np.zeros(width)
    for i in range(n):
        for j in range(n):
            for t in range(width):
                joined[i, j, t] = imposed.interval * linear[i, j, t]
    for j in range(m):
        for i in range(m):
            joined[n + i, n + j, 0] = imposed.interval * imposed.generator[i, j]
        if not imposed.angle:
            unit[0] = imposed.interval * imposed.signals[0, 0, j]
            _over_inertia(machine, unit, 1.0, joined[1, n + j])
        else:
            for i in range(2, n):
                for s in range(2):
                    for t in range(width):
                        joined[i, n + j, t] += (
                            imposed.interval
                            * machine.rest[i - 1, s, t]
                            * imposed.signals[0, s, j]
                        )
    onward = exponential(joined)
    state, moved, kick = np.zeros((n + m, width)), np.zeros((n + m, width)), np.zeros(width)
    signals = np.zeros(imposed.signals.shape[1])
    if imposed.angle and n > 2:
        # In equilibrium at the first angle.
        _signal(imposed, 0, 0, signals)
        angle = signals[0]
        system, right = np.zeros((n - 2, n - 2)), np.zeros((n - 2, width))
        for turn in range(2):
            for i in range(n - 2):
                for j in range(n - 2):
                    system[i, j] = machine.rest[1 + i, 2 + j, 0]
                for t in range(width):
                    right[i, t] = -machine.rest[1 + i, 0, t] * angle
                    if t and turn:
                        for j in range(n - 2):
                            right[i, t] -= machine.rest[1 + i, 2 + j, t] * state[2 + j, 0]
            solved(system, right)
            for i in range(n - 2):
                for t in range(width):
                    state[2 + i, t] = right[i, t]
    for k in range(out.shape[0]):
        for j in range(m):
            state[n + j, 0] = imposed.states[k, j]
        if imposed.angle:
            _signal(imposed, k, 0, signals)
            for t in range(width):
                out[k, t] = machine.rest[0, 0, t] * signals[0] + machine.rest[0, 1, t] * signals[1]
                for j in range(2, n):
                    out[k, t] += machine.rest[0, j, 0] * state[j, t]
                    if t:
                        out[k, t] += machine.rest[0, j, t] * state[j, 0]
            out[k, 0] += machine.theta[2] * signals[2]
            if machine.inertia:
                out[k, machine.inertia] += signals[2]
        else:
            if imposed.impulses[k] != 0.0:
                unit[0] = imposed.impulses[k]
                _over_inertia(machine, unit, 1.0, kick)
                for t in range(width):
                    state[1, t] += kick[t]
            for t in range(width):
                out[k, t] = state[0, t]
        for i in range(n):
            for t in range(width):
                moved[i, t] = 0.0
        add_product(onward, state, moved, 2 if imposed.angle else 0)
        for i in range(n):
            for t in range(width):
                state[i, t] = moved[i, t]
