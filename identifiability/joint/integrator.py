"""Fixed-step exponential Runge-Kutta integration of any joint model, with delayed motion.

The model's rates are split into their linearisation at rest, which is propagated exactly, and the
rest, which is integrated: by the fourth-order scheme of Cox & Matthews 2002 (J Comput Phys 176:
430-455) or by the second-order one. Stiff linear parts (a stiff tendon, a fast sensor) then need no
small steps, and a linear model under a torque that is linear between samples is solved exactly.

The past motion is kept at every step and read between steps by Hermite interpolation, so a
derivative with respect to a delay is right too. The one exception is an ideal torque impulse under
delayed velocity feedback: the velocity jumps, and what moves with the delay is then a jump inside a
step, which no derivative of the steps can see.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Motion
from identifiability.joint.exponentials import matrix_exponential, phi_functions
from identifiability.joint.instruments import DriveArrays, recorded
from identifiability.joint.model import Model

Rates = Callable[[Array, int], Array]
"""Rates of a state at a place in the step: 0 (start), 1 (middle), 2 (end)."""


class _Carry(NamedTuple):
    """State at the end of a step, what drives it, the angles so far, and the past that it needs."""

    state: Array
    drive: Array
    angles: Array
    history: Array
    row: Array
    past: list[Motion]


def integrate(
    model: Model,
    theta: ArrayLike,
    arrays: DriveArrays,
    substeps: int | Array,
    order: int = 4,
    room: int | None = None,
    readings: int = 1,
) -> Array:
    """Response of any model by exponential Runge-Kutta steps.

    Parameters
    ----------
    model : Model
    theta : array, shape (n_parameters,)
    arrays : tuple
        From ``response.drive_arrays``.
    substeps : int
        Steps per sampling interval, or from one reading of the instruments to the next. It is data:
        one compiled program serves any number of steps.
    order : {4, 2}
        Power of the step with which the error falls, except where a delayed jump of the torque
        falls inside a step. The second-order scheme takes half the time; with delays it expects a
        torque without impulses.
    room : int, optional
        Most substeps whose motion can be kept, for a model with delays; `substeps` by default,
        which must then be known when the program is compiled.
    readings : int
        How often in a sampling interval instruments see the response, from `readings_of`.

    Returns
    -------
    array, shape (n,)
        Angle [rad] if the drive is a torque, torque [Nm] if it is an angle.
    """

    def respond(arrays: DriveArrays) -> Array:
        interval, generator, readout, states, impulses = (jnp.asarray(a) for a in arrays)
        steps = jnp.asarray(substeps)
        drive = _Drive(interval / substeps, interval, steps, generator, readout, states)
        if readout.shape[0] > 1:
            return _angle_driven(model, theta, drive, order)
        rows = 0
        if model.delayed:
            rows = (states.shape[0] - 1) * (int(substeps) if room is None else room)
        return _torque_driven(model, theta, drive, impulses, rows, order)

    return recorded(model, theta, arrays, readings, respond)


class _Drive:
    """The imposed signals, as they are within the steps."""

    def __init__(
        self,
        step: Array,
        interval: Array,
        substeps: Array,
        generator: Array,
        readout: Array,
        states: Array,
    ) -> None:
        self.step, self.interval, self.substeps = step, interval, substeps
        self.readout, self.states = readout, states
        self.n_samples = states.shape[0]
        self.n_steps = (self.n_samples - 1) * substeps
        self._half = _exponential(generator * (0.5 * step))
        self._whole = _exponential(generator * interval)

    def within(self, index: Array, before: Array) -> tuple[Array, Array, Array, Array]:
        """Sample that a step belongs to, whether it begins there, signals, and where they end.

        The signals, shape (3, q), are those at start, middle and end of step `index`. A jump at a
        sample comes first.
        """
        sample = index // self.substeps
        begins = index == sample * self.substeps
        start = jnp.where(begins, _row(self.states, sample), before)
        middle = _times(self._half, start)
        end = _times(self._half, middle)
        signals = _times(self.readout, jnp.stack([start, middle, end])[:, None, :])
        return sample, begins, signals, end

    @property
    def ends(self) -> Array:
        """Signals at the end of each interval, before the jump there, shape (n - 1, q)."""
        return self.states[:-1] @ (self.readout @ self._whole).T


def _exponential(generator: Array) -> Array:
    # Impulses alone need no generator.
    return matrix_exponential(generator) if generator.size else generator


def _row(rows: Array, index: Array) -> Array:
    return jax.lax.dynamic_index_in_dim(rows, index, keepdims=False)


def _times(matrix: Array, vector: Array) -> Array:
    """Their product, as a sum that the compiler fuses: quicker for a batch of tiny matrices."""
    return jnp.sum(matrix * vector, axis=-1)


class _Steps:
    """Steps of an exponential Runge-Kutta scheme about a fixed linear part."""

    def __init__(self, linear: Array, step: Array, order: int) -> None:
        half, full = phi_functions(linear * step)
        self.linear, self.step, self.order = linear, step, order
        self.full = full
        self.half, self.to_half = half.phi0, 0.5 * step * half.phi1
        self.weights = (
            full.phi1 - 3 * full.phi2 + 4 * full.phi3,
            2 * full.phi2 - 4 * full.phi3,
            4 * full.phi3 - full.phi2,
        )

    def advance(self, rates: Rates, state: Array, first: Array) -> tuple[Array, Array]:
        """State after a step, and the rates at its end as the scheme knows them.

        `first` are the rates at the start of the step.
        """
        linear, step = self.linear, self.step

        def rest(at: Array, place: int) -> Array:
            return rates(at, place) - _times(linear, at)

        start = first - _times(linear, state)
        if self.order == 2:
            guess = _times(self.full.phi0, state) + step * _times(self.full.phi1, start)
            last = rates(guess, 2)
            end = last - _times(linear, guess)
            arrived = guess + step * _times(self.full.phi2, end - start)
            return arrived, last + _times(linear, arrived - guess)
        a = _times(self.half, state) + _times(self.to_half, start)
        rest_a = rest(a, 1)
        b = _times(self.half, state) + _times(self.to_half, rest_a)
        rest_b = rest(b, 1)
        c = _times(self.half, a) + _times(self.to_half, 2 * rest_b - start)
        rest_c = rest(c, 2)
        at_start, at_middle, at_end = self.weights
        arrived = _times(self.full.phi0, state) + step * (
            _times(at_start, start) + _times(at_middle, rest_a + rest_b) + _times(at_end, rest_c)
        )
        return arrived, rates(arrived, 2)


def _torque_driven(
    model: Model, theta: ArrayLike, drive: _Drive, impulses: Array, rows: int, order: int
) -> Array:
    delays = model.delays(theta)
    inertia, step = model.inertia(theta), drive.step

    def rates(state: Array, applied: ArrayLike, past: list[Motion]) -> Array:
        motion = Motion(state[0], state[1])
        reaction = model.react(theta, motion, state[2:], past)
        acceleration = (applied - reaction.torque) / inertia
        return jnp.concatenate([jnp.stack([state[1], acceleration]), reaction.rates])

    origin = jnp.zeros(2 + model.n_internal)
    still = Motion(jnp.zeros(()), jnp.zeros(()))
    rest = [still] * len(model.effects)
    scheme = _Steps(jax.jacfwd(lambda state: rates(state, 0.0, rest))(origin), step, order)

    def advance(index: Array, carry: _Carry) -> _Carry:
        sample, begins, applied, end = drive.within(index, carry.drive)
        kick = jnp.where(begins, _row(impulses, sample), 0.0) / inertia
        state = carry.state.at[1].add(kick)
        now = index * step
        history = carry.history
        if rows:
            # Written before it is read: the compiler then needs no copy of the whole history.
            history = history.at[jnp.maximum(index - 1, 0)].set(carry.row)

        def recall(place: int) -> list[Motion]:
            time = now + 0.5 * place * step
            return [
                still if d is None else _recall(history, index, step, time - d, state, place == 2)
                for d in delays
            ]

        # Reading the past is what costs most. The two-stage scheme reads it once a step: where no
        # impulse made the motion jump, the end of one step is the start of the next.
        ends = recall(2)
        recalled = {0: carry.past, 2: ends} if order == 2 else {0: recall(0), 1: recall(1), 2: ends}

        def rates_at(state: Array, place: int) -> Array:
            here = Motion(state[0], state[1])
            past = [here if d is None else p for d, p in zip(delays, recalled[place], strict=True)]
            return rates(state, applied[place, 0], past)

        first = rates_at(state, 0)
        arrived, last = scheme.advance(rates_at, state, first)
        row = jnp.stack([*state[:2], first[1], *arrived[:2], last[1]])
        angles = carry.angles.at[sample + 1].set(arrived[0])
        return _Carry(arrived, end, angles, history, row, ends)

    start = _Carry(
        origin,
        drive.states[0],
        jnp.zeros(drive.n_samples),
        jnp.zeros((rows, 6)),
        jnp.zeros(6),
        rest,
    )
    # A start that depends on data and parameters in form, as its successors do in fact, spares the
    # tracer a second pass through the loop.
    formal = 0.0 * (jnp.sum(drive.states[0]) + jnp.asarray(theta)[0])
    start = jax.tree.map(lambda array: array + formal, start)
    return jax.lax.fori_loop(0, drive.n_steps, advance, start).angles


def _recall(
    history: Array, index: Array, step: Array, time: Array, state: Array, ends_step: bool
) -> Motion:
    """Motion at `time`, before or within step `index`, which starts in `state`; rest before 0.

    Where `time` is that of a jump, the end of a step sees the motion before it, other stages the
    motion after it.
    """
    slot = _slot(time / step, ends_step)
    known = jnp.clip(slot, 0, jnp.maximum(index - 1, 0))
    angle0, velocity0, acceleration0, angle1, velocity1, acceleration1 = history[known]
    s = time / step - known
    angle = _hermite(s, step, angle0, velocity0, angle1, velocity1)
    velocity = _hermite(s, step, velocity0, acceleration0, velocity1, acceleration1)
    # A delay shorter than a step reaches into the step being taken: expand from its start.
    ahead = time - index * step
    acceleration = jnp.where(index > 0, acceleration1, 0.0)
    present = Motion(
        state[0] + ahead * state[1] + 0.5 * ahead**2 * acceleration,
        state[1] + ahead * acceleration,
    )
    within = slot >= index
    return Motion(
        jnp.where(slot < 0, 0.0, jnp.where(within, present.angle, angle)),
        jnp.where(slot < 0, 0.0, jnp.where(within, present.velocity, velocity)),
    )


def _slot(place: Array, ends_step: bool) -> Array:
    """Number of the step that a place is in; at its start, of the step that ends there if asked."""
    place = jax.lax.stop_gradient(place)
    slot = jnp.ceil(place - 1e-6) - 1 if ends_step else jnp.floor(place + 1e-6)
    return slot.astype(int)


def _hermite(s: Array, step: Array, y0: Array, d0: Array, y1: Array, d1: Array) -> Array:
    """Cubic through two values and slopes, at the fraction `s` of a step."""
    return (
        y0 * (1 + 2 * s) * (1 - s) ** 2
        + step * d0 * s * (1 - s) ** 2
        + y1 * s**2 * (3 - 2 * s)
        + step * d1 * s**2 * (s - 1)
    )


def _quintic(s: Array, step: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Value and slope of the quintic through two angles, velocities and accelerations."""
    (y0, d0, a0), (y1, d1, a1) = start, end
    rise, d0, d1, a0, a1 = y1 - y0, step * d0, step * d1, step**2 * a0, step**2 * a1
    coefficients = (
        y0,
        d0,
        a0 / 2,
        10 * rise - 6 * d0 - 4 * d1 - 1.5 * a0 + 0.5 * a1,
        -15 * rise + 8 * d0 + 7 * d1 + 1.5 * a0 - a1,
        6 * rise - 3 * d0 - 3 * d1 - 0.5 * a0 + 0.5 * a1,
    )
    value = sum((c * s**k for k, c in enumerate(coefficients)), start=jnp.zeros(()))
    slope = sum(
        (k * c * s ** (k - 1) for k, c in enumerate(coefficients) if k), start=jnp.zeros(())
    )
    return value, slope / step


def _angle_driven(model: Model, theta: ArrayLike, drive: _Drive, order: int) -> Array:
    delays = model.delays(theta)
    inertia, step = model.inertia(theta), drive.step
    n_intervals = drive.n_samples - 1
    starts, ends = drive.states @ drive.readout.T, drive.ends

    def motion_at(time: Array, ends_step: bool) -> Motion:
        """Imposed motion at any time: its quintic within the interval, rest before it."""
        slot = _slot(time / drive.interval, ends_step)
        known = jnp.clip(slot, 0, n_intervals - 1)
        place = time / drive.interval - known
        angle, velocity = _quintic(place, drive.interval, starts[known], ends[known])
        return Motion(jnp.where(slot < 0, starts[0, 0], angle), jnp.where(slot < 0, 0.0, velocity))

    def react(
        time: Array, imposed: Array, internal: Array, ends_step: bool = False
    ) -> tuple[Array, Array]:
        motion = Motion(imposed[0], imposed[1])
        past = [motion if d is None else motion_at(time - d, ends_step) for d in delays]
        reaction = model.react(theta, motion, internal, past)
        return reaction.rates, reaction.torque

    def torque(internals: Array) -> Array:
        times = drive.interval * jnp.arange(drive.n_samples)
        return jax.vmap(lambda *at: react(*at)[1])(times, starts, internals)

    internals = jnp.zeros((drive.n_samples, model.n_internal))
    if model.n_internal:
        origin, still = jnp.zeros(model.n_internal), Motion(jnp.zeros(()), jnp.zeros(()))
        scheme = _Steps(_slopes(model, theta, still, origin), step, order)

        def advance(index: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            internal, before, internals = carry
            sample, _, imposed, end = drive.within(index, before)

            def rates_at(state: Array, place: int) -> Array:
                return react((index + 0.5 * place) * step, imposed[place], state, place == 2)[0]

            internal = scheme.advance(rates_at, internal, rates_at(internal, 0))[0]
            return internal, end, internals.at[sample + 1].set(internal)

        first = _rest(model, theta, starts[0, 0])
        begin = first, drive.states[0], internals.at[0].set(first)
        internals = jax.lax.fori_loop(0, drive.n_steps, advance, begin)[2]
    return torque(internals) + inertia * starts[:, 2]


def _slopes(model: Model, theta: ArrayLike, held: Motion, internal: Array) -> Array:
    """Derivatives of the internal states' rates with respect to these states."""

    def rates(states: Array) -> Array:
        return model.react(theta, held, states, [held] * len(model.effects)).rates

    return jax.jacfwd(rates)(internal)


def _rest(model: Model, theta: ArrayLike, angle: Array) -> Array:
    """Internal states in equilibrium at a held angle, by Newton's method from 0.

    The last two steps are differentiated, so that first and second derivatives are those of the
    equilibrium.
    """
    held, theta = Motion(angle, jnp.zeros(())), jnp.asarray(theta)
    # The tiny slope keeps at 0 a state that any value would leave at rest.
    tiny = 1e-12 * jnp.eye(model.n_internal)

    def closer(theta: Array, states: Array) -> Array:
        rates = model.react(theta, held, states, [held] * len(model.effects)).rates
        return states - jnp.linalg.solve(_slopes(model, theta, held, states) - tiny, rates)

    fixed = jax.lax.stop_gradient(theta)
    near = jax.lax.fori_loop(0, 20, lambda _, x: closer(fixed, x), jnp.zeros(model.n_internal))
    return closer(theta, closer(theta, jax.lax.stop_gradient(near)))
