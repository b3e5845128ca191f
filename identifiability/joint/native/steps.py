"""The steps of `integrator` and the exact response of `response`, with first derivatives.

Arrays of what depends on parameters have the value and then each derivative along the last axis,
whose length is a multiple of four. A model comes as the addresses of its code, see `Kernel`.

Both causalities take the same steps of the state [angle, velocity, internal states]: where the
angle is imposed its first two entries are given.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from identifiability.joint.native.duals import (
    added,
    exponential,
    multiplied,
    phi_functions,
    solved,
)
from identifiability.joint.native.machine import LANES, spread, together
from identifiability.loops import compiled_loop

_POINTER = ir.DoubleType().as_pointer()
_NEWTON_STEPS = 22


class Machine(NamedTuple):
    """A model at one parameter vector.

    Attributes
    ----------
    moving, turning : int
        Addresses of its code, see `Kernel`.
    theta : array, shape (n_parameters,)
    inertia : int
        Which derivative is that by the inertia, from 1; 0 if none.
    rest : array, shape (2 + n_internal, 2 + n_internal, width)
        Derivatives at rest of torque, acceleration and internal states' rates by angle, velocity
        and internal states.
    delays : array, shape (n_delays, width)
        In s.
    """

    moving: int
    turning: int
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
    """Where a model's code reads all inputs, and the derivatives of those that move."""

    given: np.ndarray
    moved: np.ndarray


@cast(Callable[..., Any], intrinsic)
def _run(typing: Any, address: Any, given: Any, moved: Any, out: Any) -> Any:
    """Call the code at an address."""
    signature = types.void(types.intp, given, moved, out)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [_POINTER] * 3)
        function = builder.inttoptr(args[0], kind.as_pointer())
        builder.call(function, _places(context, builder, signature.args[1:], args[1:]))
        return context.get_dummy_value()

    return signature, generate


@cast(Callable[..., Any], intrinsic)
def _add_product(typing: Any, matrix: Any, slopes: Any, vector: Any, out: Any, first: Any) -> Any:
    """Add the product of a matrix and a vector to a vector, from an entry on.

    ``out[i, t] += matrix[i, k] vector[k, t] + slopes[i, k, t] vector[k, 0]``, contiguous arrays,
    several t by one instruction: what the compiler would make of loops takes five times as long.
    """
    signature = types.void(matrix, slopes, vector, out, types.intp)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        size = ir.IntType(64)
        shape = context.make_array(signature.args[2])(context, builder, args[2]).shape
        n, width = (builder.extract_value(shape, i) for i in range(2))
        a, da, x, y = _places(context, builder, signature.args[:4], args[:4])
        lanes, one = ir.Constant(size, LANES), ir.Constant(size, 1)

        def at(pointer: Any, place: Any) -> Any:
            return builder.gep(pointer, [place])

        def read(pointer: Any, place: Any) -> Any:
            return builder.load(together(builder, at(pointer, place)), align=8)

        def add(total: Any, one: Any, other: Any) -> Any:
            term = builder.fmul(one, other, flags=["contract"])
            return builder.fadd(total, term, flags=["contract"])

        total = cgutils.alloca_once(builder, ir.VectorType(ir.DoubleType(), LANES))
        ends = (args[4], n, one)
        blocks = (ir.Constant(size, 0), width, lanes)
        with (
            cgutils.for_range_slice(builder, *ends) as (i, _),
            cgutils.for_range_slice(builder, *blocks) as (t, _),
        ):
            target = builder.add(builder.mul(i, width), t)
            builder.store(read(y, target), total)
            with cgutils.for_range_slice(builder, *ends) as (k, _):
                entry, row = builder.add(builder.mul(i, n), k), builder.mul(k, width)
                value, first = builder.load(at(a, entry)), builder.load(at(x, row))
                known = builder.load(total)
                known = add(known, spread(builder, value), read(x, builder.add(row, t)))
                slope = read(da, builder.add(builder.mul(entry, width), t))
                builder.store(add(known, slope, spread(builder, first)), total)
            known = builder.load(total)
            builder.store(known, together(builder, at(y, target)), align=8)
        return context.get_dummy_value()

    return signature, generate


def _places(context: Any, builder: Any, kinds: Any, arrays: Any) -> list[Any]:
    """Where the data of arrays begin."""
    return [
        context.make_array(kind)(context, builder, array).data
        for kind, array in zip(kinds, arrays, strict=True)
    ]


@compiled_loop
def _react(
    machine: Machine,
    state: np.ndarray,
    past: np.ndarray,
    applied: float,
    room: _Room,
    out: np.ndarray,
) -> None:
    """Torque, acceleration and rates of the internal states, shape (2 + n_internal, width)."""
    first, (n, width), n_past = machine.theta.size, state.shape, past.shape[0]
    for j in range(n):
        room.given[first + j] = state[j, 0]
        for t in range(1, width):
            room.moved[j, t] = state[j, t]
    for j in range(n_past):
        room.given[first + n + j] = past[j, 0]
        for t in range(1, width):
            room.moved[n + j, t] = past[j, t]
    room.given[first + n + n_past] = applied
    _run(machine.moving, room.given, room.moved, out)


@compiled_loop
def _over_inertia(machine: Machine, torque: float, out: np.ndarray) -> None:
    """Add the acceleration by a torque [Nm], with its derivative."""
    out[0] += torque / machine.theta[2]
    if machine.inertia:
        out[machine.inertia] -= torque / machine.theta[2] ** 2


@compiled_loop
def _linear_part(machine: Machine, angle: bool) -> np.ndarray:
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


class _Scheme(NamedTuple):
    """An exponential Runge-Kutta scheme: how stages follow from each other.

    With f the rates at the points so far and p how far these are from the start, the next point is
    from the start ``sum of parts[k, j] f[j] + sum of parts[k, count + j] p[j]``: that of the usual
    form, in which the linear part is taken off the rates, put together.

    Attributes
    ----------
    places : array of int, shape (count,)
        Place in the step of each stage: 0 (start), 1 (middle), 2 (end).
    parts : array, shape (count, 2 * count, n, n)
    slopes : array, shape (count, 2 * count, n, n, width)
        Their derivatives; 0 in the place of the value.
    used : array of int, shape (count, 2 * count)
    """

    places: np.ndarray
    parts: np.ndarray
    slopes: np.ndarray
    used: np.ndarray


@compiled_loop
def _set(scheme: _Scheme, stage: int, of: int, matrix: np.ndarray, size: float) -> None:
    n, width = matrix.shape[0], matrix.shape[2]
    scheme.used[stage, of] = 1
    for i in range(n):
        for j in range(n):
            scheme.parts[stage, of, i, j] += size * matrix[i, j, 0]
            for t in range(1, width):
                scheme.slopes[stage, of, i, j, t] += size * matrix[i, j, t]


@compiled_loop
def _scheme(linear: np.ndarray, step: float, order: int) -> _Scheme:
    n, width = linear.shape[0], linear.shape[2]
    whole, product = np.empty_like(linear), np.empty_like(linear)
    added(linear, step, linear, 0.0, whole)
    half, full = phi_functions(whole)
    count = 2 if order == 2 else 4
    scheme = _Scheme(
        np.zeros(count, np.int64),
        np.zeros((count, 2 * count, n, n)),
        np.zeros((count, 2 * count, n, n, width)),
        np.zeros((count, 2 * count), np.int64),
    )
    if order == 2:
        scheme.places[1] = 2
        _set(scheme, 0, 0, full[1], step)
        multiplied(full[2], full[0], product)
        _set(scheme, 1, 0, full[1], step)
        _set(scheme, 1, 0, product, -step)
        _set(scheme, 1, 1, full[2], step)
        return scheme
    scheme.places[1] = scheme.places[2] = 1
    scheme.places[3] = 2
    for k in range(3):
        _set(scheme, k, k, half[1], step if k == 2 else 0.5 * step)
    for i in range(n):
        half[0, i, i, 0] -= 1.0
    _set(scheme, 1, 5, half[0], -1.0)
    _set(scheme, 2, 5, half[0], 1.0)
    _set(scheme, 2, 6, half[0], -2.0)
    # The weights of the stages, and what they make of the linear part.
    for j in range(4):
        added(full[2], (-3.0, 2.0, 2.0, -1.0)[j], full[3], (4.0, -4.0, -4.0, 4.0)[j], product)
        if j == 0:
            added(product, 1.0, full[1], 1.0, product)
        _set(scheme, 3, j, product, step)
        if j:
            multiplied(product, linear, whole)
            _set(scheme, 3, 4 + j, whole, -step)
    return scheme


@compiled_loop
def _slot(place: float, ends_step: bool) -> int:
    """Number of the step that a place is in; at its start, of the step that ends there if asked."""
    if not abs(place) < 1e15:
        return -1  # of what is no place in any record
    return math.ceil(place - 1e-6) - 1 if ends_step else math.floor(place + 1e-6)


@compiled_loop
def _hermite(
    s: float,
    step: float,
    y0: np.ndarray,
    d0: np.ndarray,
    y1: np.ndarray,
    d1: np.ndarray,
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
    n, width = machine.rest.shape[0] - 2, state.shape[1]
    slopes, right, raw = np.zeros((n, n)), np.zeros((n, width)), np.zeros((n * n, LANES))
    for k in range(past.shape[0] // 2):
        past[2 * k, 0] = state[0, 0]
    for _ in range(_NEWTON_STEPS):
        for i in range(n):
            for t in range(1, width):
                state[2 + i, t] = 0.0
        _react(machine, state, past, 0.0, room, reaction)
        _run(machine.turning, room.given, room.moved, raw)
        for i in range(n):
            for j in range(n):
                slopes[i, j] = raw[i * n + j, 0]
            # Keeps at 0 a state that any value would leave at rest.
            slopes[i, i] -= 1e-12
            for t in range(width):
                right[i, t] = reaction[2 + i, t]
        solved(slopes, right)
        for i in range(n):
            for t in range(width):
                state[2 + i, t] -= right[i, t]


@compiled_loop
def integrated(
    machine: Machine, imposed: Imposed, substeps: int, order: int, out: np.ndarray
) -> None:
    """Response in steps, into `out`, shape (n, width)."""
    n, width, n_samples = machine.rest.shape[0], out.shape[1], out.shape[0]
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
    room = _Room(np.zeros(machine.theta.size + n + n_past + 1), np.zeros((n + n_past, width)))
    for j in range(machine.theta.size):
        room.given[j] = machine.theta[j]
    reaction = np.zeros((n, width))
    points, away = np.zeros((n_stages + 1, n, width)), np.zeros((n_stages + 1, n, width))
    every = np.zeros((n_stages + 1, n, width))
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
            _over_inertia(machine, imposed.impulses[sample], points[0, 1])
        # The two-stage scheme takes the end of one step for the start of the next, where no impulse
        # made the motion jump.
        carried = order == 2 and not imposed.angle
        for place in range(2 if carried else 0, 3):
            if n_past and (place != 1 or order == 4):
                _recall(machine, imposed, history, index, step, place, points[0], pasts[place])
        if carried:
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
            rates = every[k]
            _react(machine, point, pasts[place], applied[0], room, rates)
            if imposed.angle and k == 0 and not within:
                for t in range(width):
                    out[sample, t] = rates[0, t]
                out[sample, 0] += machine.theta[2] * applied[2]
                if machine.inertia:
                    out[sample, machine.inertia] += applied[2]
                if idle or index == n_steps:
                    break
            for t in range(width):
                rates[0, t] = point[1, t]
            if k == n_stages:
                break
            for i in range(first, n):
                for t in range(width):
                    away[k + 1, i, t] = 0.0
            for j in range(2 * n_stages):
                if scheme.used[k, j]:
                    source = every[j] if j < n_stages else away[j - n_stages]
                    _add_product(
                        scheme.parts[k, j], scheme.slopes[k, j], source, away[k + 1], first
                    )
            for i in range(first, n):
                for t in range(width):
                    points[k + 1, i, t] = points[0, i, t] + away[k + 1, i, t]
        if idle or index == n_steps:
            continue
        arrived = points[n_stages]
        if history.shape[0]:
            if order == 2:
                # As the scheme knows them: those of its guess, and linearly on.
                last = every[n_stages]
                for t in range(width):
                    last[1, t] = every[1, 1, t]
                for j in range(n):
                    moved = arrived[j, 0] - points[1, j, 0]
                    last[1, 0] += linear[1, j, 0] * moved
                    for t in range(1, width):
                        last[1, t] += linear[1, j, 0] * (arrived[j, t] - points[1, j, t])
                        last[1, t] += linear[1, j, t] * moved
            for t in range(width):
                for i in range(2):
                    history[index, i, t] = points[0, i, t]
                    history[index, 3 + i, t] = arrived[i, t]
                history[index, 2, t] = every[0, 1, t]
                history[index, 5, t] = every[n_stages, 1, t]
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
    for i in range(n):
        for j in range(n):
            for t in range(width):
                joined[i, j, t] = imposed.interval * linear[i, j, t]
    for j in range(m):
        for i in range(m):
            joined[n + i, n + j, 0] = imposed.interval * imposed.generator[i, j]
        if not imposed.angle:
            _over_inertia(machine, imposed.interval * imposed.signals[0, 0, j], joined[1, n + j])
        else:
            for i in range(2, n):
                for s in range(2):
                    for t in range(width):
                        joined[i, n + j, t] += (
                            imposed.interval * machine.rest[i, s, t] * imposed.signals[0, s, j]
                        )
    propagator = exponential(joined)
    onward, slopes = np.zeros((n + m, n + m)), np.zeros((n + m, n + m, width))
    for i in range(n + m):
        for j in range(n + m):
            onward[i, j] = propagator[i, j, 0]
            for t in range(1, width):
                slopes[i, j, t] = propagator[i, j, t]
    state, moved = np.zeros((n + m, width)), np.zeros((n + m, width))
    signals = np.zeros(imposed.signals.shape[1])
    if imposed.angle and n > 2:
        # In equilibrium at the first angle.
        _signal(imposed, 0, 0, signals)
        angle = signals[0]
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
                _over_inertia(machine, imposed.impulses[k], state[1])
            for t in range(width):
                out[k, t] = state[0, t]
        for i in range(n + m):
            for t in range(width):
                moved[i, t] = 0.0
        _add_product(onward, slopes, state, moved, 2 if imposed.angle else 0)
        for i in range(n):
            for t in range(width):
                state[i, t] = moved[i, t]
