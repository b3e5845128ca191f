"""Fixed-step Runge-Kutta integration of any joint model, with delayed motion.

The classical fourth-order scheme; the past motion is kept at every step and read between steps by
Hermite interpolation, so a derivative with respect to a delay is right too. The one exception is an
ideal torque impulse under delayed velocity feedback: the velocity jumps, and what moves with the
delay is then a jump inside a step, which no derivative of the steps can see.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Motion
from identifiability.joint.model import Model

Past = Callable[[Array], Motion]


class _Carry(NamedTuple):
    state: Array
    history: Array


def integrate(
    model: Model,
    theta: ArrayLike,
    arrays: tuple[ArrayLike, ...],
    fine: ArrayLike,
    substeps: int,
) -> Array:
    """Response of any model by Runge-Kutta steps.

    Parameters
    ----------
    model : Model
    theta : array, shape (n_parameters,)
    arrays : tuple
        From ``response.drive_arrays``.
    fine : array, shape (n - 1, 2 * substeps + 1, q)
        The imposed signals within each interval, from ``Drive.refined(substeps)``.
    substeps : int
        Steps per sampling interval. The error falls with its fourth power, except where a delayed
        jump of the torque falls inside a step.

    Returns
    -------
    array, shape (n,)
        Angle [rad] if the drive is a torque, torque [Nm] if it is an angle.
    """
    interval, _, readout, states, impulses = (jnp.asarray(a) for a in arrays)
    step = interval / substeps
    fine = jnp.asarray(fine)
    if readout.shape[0] == 1:
        return _torque_driven(model, theta, step, fine[..., 0], impulses, substeps)
    return _angle_driven(model, theta, step, fine, states @ readout.T, substeps)


def _rk4(rates: Callable[[Array, int], Array], state: Array, step: Array, first: Array) -> Array:
    """One step; `rates` takes the state and the place in the step: 0, 1 (middle), 2 (end)."""
    second = rates(state + 0.5 * step * first, 1)
    third = rates(state + 0.5 * step * second, 1)
    fourth = rates(state + step * third, 2)
    return state + step / 6 * (first + 2 * second + 2 * third + fourth)


def _torque_driven(
    model: Model, theta: ArrayLike, step: Array, torque: Array, impulses: Array, substeps: int
) -> Array:
    delays = model.delays(theta)
    remembers = any(d is not None for d in delays)
    inertia = model.inertia(theta)
    n_steps = torque.shape[0] * substeps

    def rates(state: Array, applied: Array, past: list[Motion]) -> Array:
        motion = Motion(state[0], state[1])
        reaction = model.react(theta, motion, state[2:], past)
        acceleration = (applied - reaction.torque) / inertia
        return jnp.concatenate([jnp.stack([state[1], acceleration]), reaction.rates])

    def substep(carry: _Carry, inputs: tuple[Array, Array]) -> tuple[_Carry, None]:
        index, applied = inputs
        now = index * step

        def recall(stage: int, here: Motion) -> list[Motion]:
            time = now + 0.5 * stage * step
            return [
                here
                if d is None
                else _recall(carry.history, index, step, time - d, carry.state, stage == 2)
                for d in delays
            ]

        def stage_rates(state: Array, stage: int) -> Array:
            here = Motion(state[0], state[1])
            return rates(state, applied[stage], recall(stage, here))

        first = stage_rates(carry.state, 0)
        arrived = _rk4(stage_rates, carry.state, step, first)
        history = carry.history
        if remembers:
            last = stage_rates(arrived, 2)
            ends = jnp.stack([*carry.state[:2], first[1], *arrived[:2], last[1]])
            history = history.at[index].set(ends)
        return _Carry(arrived, history), None

    def sample(carry: _Carry, inputs: tuple[Array, Array, Array]) -> tuple[_Carry, Array]:
        index, applied, impulse = inputs
        kicked = carry.state.at[1].add(impulse / inertia)
        # Neighbouring steps share the value at their common end.
        per_step = jnp.stack([applied[0:-1:2], applied[1::2], applied[2::2]], axis=1)
        indices = index * substeps + jnp.arange(substeps)
        carry, _ = jax.lax.scan(substep, _Carry(kicked, carry.history), (indices, per_step))
        return carry, kicked[0]

    start = _Carry(jnp.zeros(2 + model.n_internal), jnp.zeros((n_steps if remembers else 0, 6)))
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
    place = jax.lax.stop_gradient(time / step)
    slot = jnp.ceil(place - 1e-6) - 1 if ends_step else jnp.floor(place + 1e-6)
    slot = slot.astype(int)
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
    model: Model, theta: ArrayLike, step: Array, fine: Array, signals: Array, substeps: int
) -> Array:
    delays = model.delays(theta)
    inertia = model.inertia(theta)
    n_intervals = fine.shape[0]

    def motion_at(time: Array) -> Motion:
        """Imposed motion at any time: its quintic within the interval, rest before it."""
        interval = step * substeps
        slot = jnp.clip(
            jnp.floor(jax.lax.stop_gradient(time / interval)).astype(int), 0, n_intervals - 1
        )
        angle, velocity = _quintic(time / interval - slot, interval, fine[slot, 0], fine[slot, -1])
        return Motion(jnp.where(time < 0, signals[0, 0], angle), jnp.where(time < 0, 0.0, velocity))

    def react(time: Array, imposed: Array, internal: Array) -> tuple[Array, Array]:
        motion = Motion(imposed[0], imposed[1])
        past = [motion if d is None else motion_at(time - d) for d in delays]
        reaction = model.react(theta, motion, internal, past)
        return reaction.rates, reaction.torque

    def substep(internal: Array, inputs: tuple[Array, Array]) -> tuple[Array, None]:
        index, imposed = inputs

        def stage_rates(state: Array, stage: int) -> Array:
            return react((index + 0.5 * stage) * step, imposed[stage], state)[0]

        return _rk4(stage_rates, internal, step, stage_rates(internal, 0)), None

    def sample(internal: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        index, within = inputs
        torque = react(index * substeps * step, within[0], internal)[1]
        per_step = jnp.stack([within[0:-1:2], within[1::2], within[2::2]], axis=1)
        indices = index * substeps + jnp.arange(substeps)
        internal, _ = jax.lax.scan(substep, internal, (indices, per_step))
        return internal, torque

    internal = _rest(model, theta, signals[0, 0])
    internal, torque = jax.lax.scan(sample, internal, (jnp.arange(n_intervals), fine))
    final = react(n_intervals * substeps * step, signals[-1], internal)[1]
    return jnp.append(torque, final) + inertia * signals[:, 2]


def _rest(model: Model, theta: ArrayLike, angle: Array) -> Array:
    """Internal states in equilibrium at a held angle: one Newton step, exact for linear models."""
    if model.n_internal == 0:
        return jnp.zeros(0)
    held = Motion(angle, jnp.zeros(()))

    def rates(internal: Array) -> Array:
        return model.react(theta, held, internal, [held] * len(model.effects)).rates

    origin = jnp.zeros(model.n_internal)
    return -jnp.linalg.solve(jax.jacfwd(rates)(origin), rates(origin))
