"""The steps of `integrator`, with first derivatives, see `moving`.

Both causalities take the same steps of the state [angle, velocity, internal states]: where the
angle is imposed its first two entries are given.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from identifiability.joint.native.calls import add_rows, add_scaled, copy_row, run, set_product
from identifiability.joint.native.duals import (
    added,
    list_entries,
    multiplied,
    phi_functions,
    solved,
)
from identifiability.joint.native.machine import LANES
from identifiability.joint.native.moving import (
    Imposed,
    Machine,
    add_inertial,
    over_inertia,
    signal,
)
from identifiability.loops import compiled_loop

_NEWTON_STEPS = 22

# Parts of a scheme, by stage and what multiplies them, of two stages and from the start of four.
# (Written into the calls, each pair would be compiled by itself.)
_OF_TWO = np.array([(0, 0), (1, 0), (1, 0), (1, 1)])
_FROM_START = np.array([(1, 5), (2, 5), (2, 6)])


@compiled_loop
def _react(
    machine: Machine,
    states: np.ndarray,
    i: int,
    pasts: np.ndarray,
    j: int,
    applied: float,
    given: np.ndarray,
    outs: np.ndarray,
    k: int,
) -> None:
    """Torque, acceleration and rates of the internal states, shape (2 + n_internal, width).

    Of the state `i` and past motions `j`, into the matrix `k` of `outs`.
    """
    first, n, n_past = machine.theta.size, states.shape[1], pasts.shape[1]
    for s in range(n):
        given[first + s] = states[i, s, 0]
    for s in range(n_past):
        given[first + n + s] = pasts[j, s, 0]
    given[first + n + n_past] = applied
    run(machine.moving, given, states, i, pasts, j, outs, k)


class Scheme(NamedTuple):
    """An exponential Runge-Kutta scheme: how stages follow from each other.

    The next point is as far from the start as ``parts[k]`` makes of the rates f at the points so
    far and of how far, p, these are from the start: that of the usual form, in which the linear
    part is taken off the rates, put together.

    Attributes
    ----------
    places : array of int, shape (count,)
        Place in the step of each stage: 0 (start), 1 (middle), 2 (end).
    parts : array, shape (count, n, 2 * count * n)
        By stage; of all f and p, one below the other.
    slopes : array, shape (count, n, 2 * count * n, width)
        Their derivatives; 0 in the place of the value.
    entries : array of int, shape (count, n, 2 * count * n, 3)
        Which there are of each stage, see `duals.list_entries`.
    """

    places: np.ndarray
    parts: np.ndarray
    slopes: np.ndarray
    entries: np.ndarray


@compiled_loop
def _add(scheme: Scheme, stage: int, of: int, matrix: np.ndarray, size: float) -> None:
    n, width = matrix.shape[0], matrix.shape[2]
    for i in range(n):
        for j in range(n):
            scheme.parts[stage, i, of * n + j] += size * matrix[i, j, 0]
            for t in range(1, width):
                scheme.slopes[stage, i, of * n + j, t] += size * matrix[i, j, t]


@compiled_loop
def _listed(scheme: Scheme) -> Scheme:
    for k in range(scheme.places.size):
        list_entries(scheme.parts[k], scheme.slopes[k], scheme.entries[k])
    return scheme


@compiled_loop
def scheme_of(linear: np.ndarray, step: float, order: int) -> Scheme:
    """The scheme for a linear part, shape (n, n, width), and a step [s]."""
    n, width = linear.shape[0], linear.shape[2]
    whole, product = np.empty_like(linear), np.empty_like(linear)
    added(linear, step, linear, 0.0, whole)
    half, full = phi_functions(whole)
    count = 2 if order == 2 else 4
    scheme = Scheme(
        np.zeros(count, np.int64),
        np.zeros((count, n, 2 * count * n)),
        np.zeros((count, n, 2 * count * n, width)),
        np.zeros((count, n, 2 * count * n, 3), np.int64),
    )
    if order == 2:
        scheme.places[1] = 2
        multiplied(full[2], full[0], product)
        for k in range(4):
            stage, of = _OF_TWO[k]
            matrix = (full[1], full[1], product, full[2])[k]
            _add(scheme, stage, of, matrix, -step if k == 2 else step)
        return _listed(scheme)
    scheme.places[1] = scheme.places[2] = 1
    scheme.places[3] = 2
    for k in range(3):
        _add(scheme, k, k, half[1], step if k == 2 else 0.5 * step)
    for i in range(n):
        half[0, i, i, 0] -= 1.0
    for k in range(3):
        stage, of = _FROM_START[k]
        _add(scheme, stage, of, half[0], (-1.0, 1.0, -2.0)[k])
    # The weights of the stages, and what they make of the linear part.
    for j in range(4):
        added(full[2], (-3.0, 2.0, 2.0, -1.0)[j], full[3], (4.0, -4.0, -4.0, 4.0)[j], product)
        if j == 0:
            added(product, 1.0, full[1], 1.0, product)
        _add(scheme, count - 1, j, product, step)
        if j:
            multiplied(product, linear, whole)
            _add(scheme, count - 1, count + j, whole, -step)
    return _listed(scheme)


@compiled_loop
def _slot(place: float, ends_step: bool) -> int:
    """Number of the step that a place is in; at its start, of the step that ends there if asked."""
    if not abs(place) < 1e15:
        return -1  # of what is no place in any record
    return math.ceil(place - 1e-6) - 1 if ends_step else math.floor(place + 1e-6)


@compiled_loop
def _hermite(
    s: float, step: float, history: np.ndarray, slot: int, of: int, out: np.ndarray, into: int
) -> float:
    """Cubic through what a step began and ended with, to a row of 0; its slope in time.

    At the fraction `s` of the step, through the entry `of` of its history and the one after, the
    slope, and through the third and fourth from there.
    """
    first = slot * history.shape[1] + of
    add_scaled(history, first, (1.0 + 2.0 * s) * (1.0 - s) ** 2, out, into)
    add_scaled(history, first + 1, step * s * (1.0 - s) ** 2, out, into)
    add_scaled(history, first + 3, s**2 * (3.0 - 2.0 * s), out, into)
    add_scaled(history, first + 4, step * s**2 * (s - 1.0), out, into)
    return (
        6.0 * s * (s - 1.0) * (history[slot, of, 0] - history[slot, of + 3, 0]) / step
        + (1.0 - s) * (1.0 - 3.0 * s) * history[slot, of + 1, 0]
        + s * (3.0 * s - 2.0) * history[slot, of + 4, 0]
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
    states: np.ndarray,
    room: np.ndarray,
    pasts: np.ndarray,
) -> None:
    """Motions a delay ago, shape (2 n_delays, width), of a place: see `integrator._recall`.

    With `room` for three motions, which is not taken anew at every step.
    """
    n_past, width = pasts.shape[1], states.shape[2]
    start, end, motion = room[0], room[1], room[2]
    for k in range(machine.delays.shape[0]):
        time = (index + 0.5 * place) * step - machine.delays[k, 0]
        angle, velocity = place * n_past + 2 * k, place * n_past + 2 * k + 1
        for t in range(width):
            pasts[place, 2 * k, t] = pasts[place, 2 * k + 1, t] = 0.0
        slope = bend = 0.0
        slot = _slot(time / (imposed.interval if imposed.angle else step), place == 2)
        if imposed.angle:
            known = max(0, min(slot, imposed.states.shape[0] - 2))
            signal(imposed, known, 0, start)
            if slot < 0:
                pasts[place, 2 * k, 0] = start[0]
            else:
                signal(imposed, known, imposed.signals.shape[0] - 1, end)
                _quintic(time / imposed.interval - known, imposed.interval, start, end, motion)
                slope, bend = motion[1], motion[2]
                pasts[place, 2 * k, 0], pasts[place, 2 * k + 1, 0] = motion[0], motion[1]
        elif slot >= index:
            # A delay shorter than a step reaches into the step being taken.
            ahead = time - index * step
            add_scaled(states, 0, 1.0, pasts, angle)
            add_scaled(states, 1, ahead, pasts, angle)
            add_scaled(states, 1, 1.0, pasts, velocity)
            if index > 0:
                last = (index - 1) * history.shape[1] + 5
                add_scaled(history, last, 0.5 * ahead**2, pasts, angle)
                add_scaled(history, last, ahead, pasts, velocity)
                bend = history[index - 1, 5, 0]
            slope = states[0, 1, 0] + ahead * bend
        elif slot >= 0:
            s = time / step - slot
            slope = _hermite(s, step, history, slot, 0, pasts, angle)
            bend = _hermite(s, step, history, slot, 1, pasts, velocity)
        for t in range(1, width):
            pasts[place, 2 * k, t] -= machine.delays[k, t] * slope
            pasts[place, 2 * k + 1, t] -= machine.delays[k, t] * bend


@compiled_loop
def _equilibrium(
    machine: Machine, states: np.ndarray, pasts: np.ndarray, given: np.ndarray
) -> None:
    """Internal states in equilibrium at the angle of the first state, by Newton's method from 0."""
    n, width, state, past = machine.rest.shape[0] - 2, states.shape[2], states[0], pasts[0]
    slopes, right, raw = np.zeros((n, n)), np.zeros((n, width)), np.zeros((n * n, LANES))
    reaction = np.zeros((1, 2 + n, width))
    for k in range(past.shape[0] // 2):
        past[2 * k, 0] = state[0, 0]
    for _ in range(_NEWTON_STEPS):
        for i in range(n):
            for t in range(1, width):
                state[2 + i, t] = 0.0
        _react(machine, states, 0, pasts, 0, 0.0, given, reaction, 0)
        run(machine.turning, given, states, 0, pasts, 0, raw, 0)
        for i in range(n):
            for j in range(n):
                slopes[i, j] = raw[i * n + j, 0]
            # Keeps at 0 a state that any value would leave at rest.
            slopes[i, i] -= 1e-12
            for t in range(width):
                right[i, t] = reaction[0, 2 + i, t]
        solved(slopes, right)
        for i in range(n):
            for t in range(width):
                state[2 + i, t] -= right[i, t]


@compiled_loop
def integrated(
    machine: Machine,
    imposed: Imposed,
    linear: np.ndarray,
    scheme: Scheme,
    substeps: int,
    out: np.ndarray,
) -> None:
    """Response in steps, into `out`, shape (n, width)."""
    n, width, n_samples = machine.rest.shape[0], out.shape[1], out.shape[0]
    n_past = 2 * machine.delays.shape[0]
    step = imposed.interval / substeps
    n_steps = (n_samples - 1) * substeps
    n_stages = scheme.places.size
    order = 2 if n_stages == 2 else 4
    # Those of an imposed angle need no steps where there are no states.
    idle = imposed.angle and n == 2
    first = 2 if imposed.angle else 0
    history = np.zeros((n_steps if n_past and not imposed.angle else 0, 6, width))
    pasts, before = np.zeros((3, n_past, width)), np.zeros((n_past, width))
    given = np.zeros(machine.theta.size + n + n_past + 1)
    for j in range(machine.theta.size):
        given[j] = machine.theta[j]
    points = np.zeros((n_stages + 1, n, width))
    # What stages follow from, in one array: rates, how far points are from the start, the rates
    # where the step ends, and nothing. (Views, and a choice of arrays, are counted at every step.)
    away, ends, nothing = n_stages, 2 * n_stages + 1, 2 * n_stages + 2
    known = np.zeros((2 * n_stages + 3, n, width))
    applied, room = np.zeros(imposed.signals.shape[1]), np.zeros((3, 3))
    if imposed.angle:
        signal(imposed, 0, 0, applied)
        points[0, 0, 0] = applied[0]
        _equilibrium(machine, points, pasts, given)
    for index in range(n_steps + 1):
        sample, within = index // substeps, 2 * (index % substeps)
        if index == n_steps and not imposed.angle:
            break
        if not within and not imposed.angle and imposed.impulses[sample] != 0.0:
            over_inertia(machine, imposed.impulses[sample], points[0, 1])
        # The two-stage scheme takes the end of one step for the start of the next, where no impulse
        # made the motion jump.
        carried = order == 2 and not imposed.angle
        for place in range(2 if carried else 0, 3):
            if n_past and (place != 1 or order == 4):
                _recall(machine, imposed, history, index, step, place, points, room, pasts)
        if carried:
            for j in range(n_past):
                for t in range(width):
                    pasts[0, j, t], before[j, t] = before[j, t], pasts[2, j, t]
        # One more than there are stages: the rates where the step ends, for the history.
        for k in range(n_stages + 1):
            place = scheme.places[k] if k < n_stages else 2
            if k == n_stages and (order == 2 or not n_past or imposed.angle):
                break
            signal(imposed, sample, within + place, applied)
            if imposed.angle:
                points[k, 0, 0], points[k, 1, 0] = applied[0], applied[1]
            rates = k if k < n_stages else ends
            _react(machine, points, k, pasts, place, applied[0], given, known, rates)
            if imposed.angle and k == 0 and not within:
                copy_row(known, rates * n, out, sample)
                add_inertial(machine, applied[2], out[sample])
                if idle or index == n_steps:
                    break
            copy_row(points, k * n + 1, known, rates * n)
            if k == n_stages:
                break
            moved = away + k + 1
            set_product(scheme.parts, scheme.slopes, scheme.entries, k, known, known, moved, first)
            add_rows(points, 0, known, moved, points, k + 1, first)
        if idle or index == n_steps:
            continue
        if history.shape[0]:
            if order == 2:
                # As the scheme knows them: those of its guess, and linearly on.
                for t in range(width):
                    known[ends, 1, t] = known[1, 1, t]
                for j in range(n):
                    change = points[n_stages, j, 0] - points[1, j, 0]
                    known[ends, 1, 0] += linear[1, j, 0] * change
                    for t in range(1, width):
                        more = points[n_stages, j, t] - points[1, j, t]
                        known[ends, 1, t] += linear[1, j, 0] * more + linear[1, j, t] * change
            into = history.shape[1] * index
            for i in range(2):
                copy_row(points, i, history, into + i)
                copy_row(points, n_stages * n + i, history, into + 3 + i)
            copy_row(known, 1, history, into + 2)
            copy_row(known, ends * n + 1, history, into + 5)
        add_rows(known, nothing, points, n_stages, points, 0, 0)
        if not imposed.angle:
            copy_row(points, n_stages * n, out, sample + 1)
