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
from identifiability.joint.exponentials import phi_functions
from identifiability.joint.model import Model

Rates = Callable[[Array, int], Array]
"""Rates of a state at a place in the step: 0 (start), 1 (middle), 2 (end)."""


class _Carry(NamedTuple):
    state: Array
    history: Array
    row: Array
    past: list[Motion]


def integrate(
    model: Model,
    theta: ArrayLike,
    arrays: tuple[ArrayLike, ...],
    fine: ArrayLike,
    substeps: int,
    order: int = 4,
) -> Array:
    """Response of any model by exponential Runge-Kutta steps.

    Parameters
    ----------
    model : Model
    theta : array, shape (n_parameters,)
    arrays : tuple
        From ``response.drive_arrays``.
    fine : array, shape (n - 1, 2 * substeps + 1, q)
        The imposed signals within each interval, from ``Drive.refined(substeps)``.
    substeps : int
        Steps per sampling interval.
    order : {4, 2}
        Power of the step with which the error falls, except where a delayed jump of the torque
        falls inside a step. The second-order scheme takes half the time; with delays it expects a
        torque without impulses.

    Returns
    -------
    array, shape (n,)
        Angle [rad] if the drive is a torque, torque [Nm] if it is an angle.
    """
    interval, _, readout, states, impulses = (jnp.asarray(a) for a in arrays)
    step = interval / substeps
    fine = jnp.asarray(fine)
    if readout.shape[0] == 1:
        response = _torque_driven(model, theta, step, fine[..., 0], impulses, substeps, order)
    else:
        response = _angle_driven(model, theta, step, fine, states @ readout.T, substeps, order)
    return model.record(theta, response, interval)


def _times(matrix: Array, vector: Array) -> Array:
    """Their product, as a sum that the compiler fuses: quicker for a batch of tiny matrices."""
    return jnp.sum(matrix * vector, axis=-1)


class _Scheme:
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
    model: Model,
    theta: ArrayLike,
    step: Array,
    torque: Array,
    impulses: Array,
    substeps: int,
    order: int,
) -> Array:
    delays = model.delays(theta)
    remembers = any(d is not None for d in delays)
    inertia = model.inertia(theta)
    n_steps = torque.shape[0] * substeps

    def rates(state: Array, applied: ArrayLike, past: list[Motion]) -> Array:
        motion = Motion(state[0], state[1])
        reaction = model.react(theta, motion, state[2:], past)
        acceleration = (applied - reaction.torque) / inertia
        return jnp.concatenate([jnp.stack([state[1], acceleration]), reaction.rates])

    origin = jnp.zeros(2 + model.n_internal)
    still = Motion(jnp.zeros(()), jnp.zeros(()))
    rest = [still] * len(model.effects)
    scheme = _Scheme(jax.jacfwd(lambda state: rates(state, 0.0, rest))(origin), step, order)

    def substep(carry: _Carry, inputs: tuple[Array, Array]) -> tuple[_Carry, None]:
        index, applied = inputs
        now = index * step
        history = carry.history
        if remembers:
            # Written before it is read: the compiler then needs no copy of the whole history.
            history = history.at[jnp.maximum(index - 1, 0)].set(carry.row)

        def recall(place: int) -> list[Motion]:
            time = now + 0.5 * place * step
            return [
                still
                if d is None
                else _recall(history, index, step, time - d, carry.state, place == 2)
                for d in delays
            ]

        # Reading the past is what costs most. The two-stage scheme reads it once a step: where no
        # impulse made the motion jump, the end of one step is the start of the next.
        ends = recall(2)
        recalled = {0: carry.past, 2: ends} if order == 2 else {0: recall(0), 1: recall(1), 2: ends}

        def rates_at(state: Array, place: int) -> Array:
            here = Motion(state[0], state[1])
            past = [here if d is None else p for d, p in zip(delays, recalled[place], strict=True)]
            return rates(state, applied[place], past)

        first = rates_at(carry.state, 0)
        arrived, last = scheme.advance(rates_at, carry.state, first)
        row = jnp.stack([*carry.state[:2], first[1], *arrived[:2], last[1]])
        return _Carry(arrived, history, row, ends), None

    def sample(carry: _Carry, inputs: tuple[Array, Array, Array]) -> tuple[_Carry, Array]:
        index, applied, impulse = inputs
        kicked = carry._replace(state=carry.state.at[1].add(impulse / inertia))
        if substeps == 1:
            return substep(kicked, (index, applied))[0], kicked.state[0]
        # Neighbouring steps share the value at their common end.
        per_step = jnp.stack([applied[0:-1:2], applied[1::2], applied[2::2]], axis=1)
        indices = index * substeps + jnp.arange(substeps)
        return jax.lax.scan(substep, kicked, (indices, per_step))[0], kicked.state[0]

    start = _Carry(origin, jnp.zeros((n_steps if remembers else 0, 6)), jnp.zeros(6), rest)
    # A start that depends on data and parameters in form, as its successors do in fact, spares the
    # tracer a second pass through the loop at each of its levels.
    formal = 0.0 * (torque[0, 0] + jnp.asarray(theta)[0])
    start = jax.tree.map(lambda array: array + formal, start)
    inputs = (jnp.arange(torque.shape[0]), torque, impulses[:-1])
    carry, angles = jax.lax.scan(sample, start, inputs)
    return jnp.append(angles, carry.state[0])


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


def _angle_driven(
    model: Model,
    theta: ArrayLike,
    step: Array,
    fine: Array,
    signals: Array,
    substeps: int,
    order: int,
) -> Array:
    delays = model.delays(theta)
    inertia = model.inertia(theta)
    n_intervals = fine.shape[0]

    def motion_at(time: Array, ends_step: bool) -> Motion:
        """Imposed motion at any time: its quintic within the interval, rest before it."""
        interval = step * substeps
        slot = _slot(time / interval, ends_step)
        known = jnp.clip(slot, 0, n_intervals - 1)
        ends = fine[known, 0], fine[known, -1]
        angle, velocity = _quintic(time / interval - known, interval, *ends)
        return Motion(jnp.where(slot < 0, signals[0, 0], angle), jnp.where(slot < 0, 0.0, velocity))

    def react(
        time: Array, imposed: Array, internal: Array, ends_step: bool = False
    ) -> tuple[Array, Array]:
        motion = Motion(imposed[0], imposed[1])
        past = [motion if d is None else motion_at(time - d, ends_step) for d in delays]
        reaction = model.react(theta, motion, internal, past)
        return reaction.rates, reaction.torque

    if model.n_internal == 0:
        times = step * substeps * jnp.arange(n_intervals)
        firsts = jax.vmap(lambda at, moved: react(at, moved, jnp.zeros(0))[1])(times, fine[:, 0])
        final = react(n_intervals * substeps * step, signals[-1], jnp.zeros(0))[1]
        return jnp.append(firsts, final) + inertia * signals[:, 2]
    origin, still = jnp.zeros(model.n_internal), Motion(jnp.zeros(()), jnp.zeros(()))
    scheme = _Scheme(_slopes(model, theta, still, origin), step, order)

    def substep(internal: Array, inputs: tuple[Array, Array]) -> tuple[Array, None]:
        index, imposed = inputs

        def rates_at(state: Array, place: int) -> Array:
            return react((index + 0.5 * place) * step, imposed[place], state, place == 2)[0]

        return scheme.advance(rates_at, internal, rates_at(internal, 0))[0], None

    def sample(internal: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        index, within = inputs
        torque = react(index * substeps * step, within[0], internal)[1]
        if substeps == 1:
            return substep(internal, (index, within))[0], torque
        per_step = jnp.stack([within[0:-1:2], within[1::2], within[2::2]], axis=1)
        indices = index * substeps + jnp.arange(substeps)
        internal, _ = jax.lax.scan(substep, internal, (indices, per_step))
        return internal, torque

    internal = _rest(model, theta, signals[0, 0])
    internal, torque = jax.lax.scan(sample, internal, (jnp.arange(n_intervals), fine))
    final = react(n_intervals * substeps * step, signals[-1], internal)[1]
    return jnp.append(torque, final) + inertia * signals[:, 2]


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
