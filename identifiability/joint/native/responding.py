"""The responses of a model to imposed signals, as one compiled function.

It is called at its address, from Python and from other compiled loops alike, so that it is
compiled once. What it needs is put into a row of numbers, the plan.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import carray

from identifiability.joint.native.calls import place, run
from identifiability.joint.native.exact import exact, of_two, propagator_of
from identifiability.joint.native.instruments import record
from identifiability.joint.native.moving import Imposed, Machine, linear_part
from identifiability.joint.native.steps import integrated, scheme_of
from identifiability.loops import compiled_address, compiled_loop

NUMBERS = (
    "moving",
    "turning",
    "still",
    "alone",
    "angle",
    "alike",
    "n_parameters",
    "n_states",
    "n_delays",
    "width",
    "substeps",
    "order",
    "readings",
    "n_sensors",
    "n_drives",
    "n_read",
    "n_generating",
)
"""What the plan begins with.

Addresses of a model's code (see `Kernel`); whether there are no derivatives, an angle is imposed,
and all drives are alike but for what generates them; sizes; steps between readings, 0 for the
exact response, and their order; readings a sample.
"""

ARRAYS = (
    "lanes",
    "sensors",
    "starts",
    "intervals",
    "given",
    "states",
    "signals",
    "generators",
    "impulses",
)
"""Arrays whose addresses come next; those of `Imposed` for all drives, one after the other.

For each sensor there are the number of its loops and of its first parameter; for each drive, and
one more, where its readings start.
"""


_LANES, _SENSORS, _STARTS, _INTERVALS, _GIVEN, _STATES, _SIGNALS, _GENERATORS, _IMPULSES = range(
    len(NUMBERS), len(NUMBERS) + len(ARRAYS)
)
_LENGTH = len(NUMBERS) + len(ARRAYS)


class _Sizes(NamedTuple):
    moving: int
    turning: int
    still: int
    alone: int
    angle: int
    alike: int
    n_parameters: int
    n_states: int
    n_delays: int
    width: int
    substeps: int
    order: int
    readings: int
    n_sensors: int
    n_drives: int
    n_read: int
    n_generating: int


@compiled_loop
def _machine(sizes: _Sizes, theta: np.ndarray) -> Machine:
    n = sizes.n_states
    rest = np.zeros((n * n + sizes.n_delays + 1, sizes.width))
    run(sizes.still, theta, rest, 0, rest, 0, rest, 0)
    return Machine(
        sizes.moving,
        sizes.turning,
        theta,
        sizes.alone != 0,
        rest[: n * n].reshape(n, n, sizes.width),
        rest[n * n : -1],
        rest[-1],
    )


class _Instruments(NamedTuple):
    """Instruments: the numbers of their loops and first parameters, and all parameters' lanes."""

    every: np.ndarray
    lanes: np.ndarray


@compiled_loop
def _recorded(
    instruments: _Instruments, theta: np.ndarray, interval: float, response: np.ndarray
) -> np.ndarray:
    for s in range(instruments.every.shape[0]):
        kind, own = instruments.every[s, 0], instruments.every[s, 1]
        response = record(kind, theta[own:], instruments.lanes[own:], interval, response)
    return response


@compiled_loop
def _into(response: np.ndarray, readings: int, out: np.ndarray, first: int) -> int:
    """Write every so many samples of a response from a row on; the row after them."""
    for k in range(0, response.shape[0], readings):
        for t in range(response.shape[1]):
            out[first, t] = response[k, t]
        first += 1
    return first


@compiled_loop
def _respond(
    sizes: _Sizes,
    machine: Machine,
    instruments: _Instruments,
    starts: np.ndarray,
    intervals: np.ndarray,
    every: Imposed,
    signals: np.ndarray,
    generators: np.ndarray,
    out: np.ndarray,
) -> None:
    done, angle, theta = 0, every.angle, machine.theta
    plain = sizes.substeps == 0 and machine.alone and sizes.n_states == 2 and not angle
    plain = plain and sizes.readings == 1 and sizes.n_sensors == 0
    if sizes.substeps == 0 and not plain:
        by = propagator_of(machine, every)
    elif sizes.substeps:
        linear = linear_part(machine, angle)
        scheme = scheme_of(linear, every.interval / sizes.substeps, sizes.order)
    for i in range(sizes.n_drives):
        a, b = starts[i], starts[i + 1]
        imposed = Imposed(
            intervals[i],
            angle,
            every.given[a:b],
            every.states[a:b],
            signals[i],
            generators[i],
            every.impulses[a:b],
        )
        if plain:
            of_two(machine, imposed, out[a:b])
            continue
        found = np.zeros((b - a, sizes.width))
        if sizes.substeps == 0:
            if i and not sizes.alike:
                by = propagator_of(machine, imposed)
            exact(machine, imposed, by, found)
        else:
            if i and not sizes.alike:
                scheme = scheme_of(linear, intervals[i] / sizes.substeps, sizes.order)
            integrated(machine, imposed, linear, scheme, sizes.substeps, found)
        found = _recorded(instruments, theta, intervals[i], found)
        done = _into(found, sizes.readings, out, done)


@compiled_address(4)
def respond(plan: Any, theta: Any, out: Any, _: Any) -> None:
    """Responses at a parameter vector, to all drives in turn.

    Parameters
    ----------
    plan, theta, out
        Where the data of these arrays begin: `NUMBERS` and addresses of `ARRAYS`, shape
        (n_parameters,), and shape (n, width), in whose rows are the responses and their
        derivatives.
    """
    numbers = carray(plan, _LENGTH, np.int64)
    sizes = _Sizes(
        numbers[0],
        numbers[1],
        numbers[2],
        numbers[3],
        numbers[4],
        numbers[5],
        numbers[6],
        numbers[7],
        numbers[8],
        numbers[9],
        numbers[10],
        numbers[11],
        numbers[12],
        numbers[13],
        numbers[14],
        numbers[15],
        numbers[16],
    )
    k, m, drives = sizes.n_parameters, sizes.n_generating, sizes.n_drives
    places = 2 * max(sizes.substeps, 1) + 1
    starts = carray(place(numbers[_STARTS]), drives + 1, np.int64)
    n = starts[drives]
    lanes = carray(place(numbers[_LANES]), k, np.int64)
    sensors = carray(place(numbers[_SENSORS]), (sizes.n_sensors, 2), np.int64)
    intervals = carray(place(numbers[_INTERVALS]), drives, np.float64)
    signals = carray(place(numbers[_SIGNALS]), (drives, places, sizes.n_read, m), np.float64)
    generators = carray(place(numbers[_GENERATORS]), (drives, m, m), np.float64)
    every = Imposed(
        intervals[0],
        sizes.angle != 0,
        carray(place(numbers[_GIVEN]), (n, sizes.n_read), np.float64),
        carray(place(numbers[_STATES]), (n, m), np.float64),
        signals[0],
        generators[0],
        carray(place(numbers[_IMPULSES]), n, np.float64),
    )
    _respond(
        sizes,
        _machine(sizes, carray(theta, k, np.float64)),
        _Instruments(sensors, lanes),
        starts,
        intervals,
        every,
        signals,
        generators,
        carray(out, (n // sizes.readings, sizes.width), np.float64),
    )
