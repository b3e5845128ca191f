"""Responses of joint models: exact for linear ones, integrated for the rest.

Both causalities: a drive with one signal is a torque and the response is the angle [rad]; a drive
with three signals is an angle with its derivatives and the response is the torque [Nm].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from identifiability.errors import InputError
from identifiability.joint.effects.base import Motion
from identifiability.joint.exponentials import matrix_exponential
from identifiability.joint.instruments import DriveArrays, readings_of, recorded
from identifiability.joint.integrator import integrate
from identifiability.joint.model import Model
from identifiability.joint.native.response import Responses, lanes_of, responses_of
from identifiability.joint.programs import compiled
from identifiability.joint.scheme import EXACT, MOST_SUBSTEPS, Scheme
from identifiability.measurement.perturbations import Drive

_BATCH = 32  # parameter vectors that JAX computes at once
_CONVERGED = 1e-7  # E between two responses, of which the finer is taken as converged


def drive_arrays(drive: Drive) -> DriveArrays:
    """Arrays of a drive, in the order that `exact_response` takes them."""
    return drive.interval, drive.generator, drive.readout, drive.states, drive.impulses


def simulate(
    model: Model, theta: ArrayLike, drive: Drive, *, scheme: Scheme | None = None
) -> np.ndarray:
    """Response of a joint to an imposed torque or angle.

    Parameters
    ----------
    model : Model
    theta : array, shape (..., n_parameters)
        One parameter vector, or any batch of them.
    drive : Drive
        Made by ``Perturbation.drive(time)`` or ``imposed_motion(time, angle)``.
    scheme : Scheme, optional
        How it is computed. Without it linear models are solved exactly, and others in steps that
        are halved until the response stays what it is: until E (Eq. 3) between the last two falls
        below 1e-7.

    Returns
    -------
    array, shape (..., n)
        Angle [rad] if torque was imposed, torque [Nm] if the angle was.

    Raises
    ------
    InputError
        Where the parameter vectors have the wrong length, the exact response is asked of a model
        that has none, or no number of steps that is tried is enough.

    Examples
    --------
    >>> import numpy as np
    >>> from identifiability import KBI, SeriesTendon, Step, simulate
    >>> model = KBI() + SeriesTendon()
    >>> values = model.vector({"K": 30.0, "B": 1.0, "I": 0.1, "series_tendon.stiffness": 60.0})
    >>> angle = simulate(model, values, Step(amplitude=4.0).drive(np.arange(5000) / 1000))
    >>> f"{angle[-1]:.3f} rad: muscle and tendon in series are {4 / angle[-1]:.1f} Nm/rad"
    '0.200 rad: muscle and tendon in series are 20.0 Nm/rad'
    """
    theta = np.asarray(theta, float)
    n_parameters = len(model.parameter_names)
    if theta.shape[-1:] != (n_parameters,):
        raise InputError(
            f"found parameters of shape {theta.shape}, expected (..., {n_parameters}) for "
            f"{list(model.parameter_names)}"
        )
    flat = theta.reshape(-1, n_parameters)
    found = _converged(model, flat, drive) if scheme is None else _by(scheme, model, flat, drive)
    return found.reshape(*theta.shape[:-1], -1)


def _by(
    scheme: Scheme, model: Model, thetas: np.ndarray, drive: Drive, finer: Scheme | None = None
) -> np.ndarray:
    """Responses by a scheme, with room for the past of a finer one."""
    scheme.check(model)
    found = responses_by(model, (), [drive], scheme, finer)
    if isinstance(found, Traced):
        return found.values(thetas)
    return np.array([found.at(theta)[0][:, 0] for theta in thetas]).reshape(len(thetas), -1)


def _converged(model: Model, thetas: np.ndarray, drive: Drive) -> np.ndarray:
    """Responses that half the step leaves as they are."""
    if model.linear or not len(thetas):
        return _by(EXACT, model, thetas, drive)
    wanted = [Scheme.for_model(model, theta, drive.interval, drive.imposed) for theta in thetas]
    # The fourth order, so that the finer of two responses is far better than their difference.
    start = max(s.substeps // (4 if s.order == 2 else 1) for s in wanted)
    scheme = Scheme(min(max(start, 1), MOST_SUBSTEPS // 2))
    finer = scheme.halved  # so that one program computes both
    coarse = _by(scheme, model, thetas, drive, finer)
    while not scheme.finest:
        scheme = scheme.halved
        fine = _by(scheme, model, thetas, drive, finer)
        with np.errstate(all="ignore"):
            moved = np.sum((fine - coarse) ** 2, axis=1) > _CONVERGED * np.sum(fine**2, axis=1)
        # What is not finite says so itself.
        if not np.any(moved & np.all(np.isfinite(fine), axis=1)):
            return fine
        coarse = fine
    raise InputError(
        f"found {model!r} too fast for samples {drive.interval:g} s apart: {scheme} do not resolve "
        "it; sample more often, or keep its parameters slower"
    )


def exact_response(model: Model, theta: ArrayLike, arrays: DriveArrays, readings: int = 1) -> Array:
    """Exact response of a linear model, differentiable and traceable.

    Parameters
    ----------
    model : Model
        A linear model.
    theta : array, shape (n_parameters,)
    arrays : tuple
        From `drive_arrays`.
    readings : int
        How often in a sampling interval instruments see the response, from `readings_of`.

    Returns
    -------
    array, shape (n,)
        As for `simulate`.
    """
    return recorded(
        model, theta, arrays, readings, lambda these: _true_response(model, theta, these)
    )


def _true_response(model: Model, theta: ArrayLike, arrays: DriveArrays) -> Array:
    interval, generator, readout, states, impulses = (jnp.asarray(a) for a in arrays)
    if readout.shape[0] == 1:
        system, feed = _torque_driven_system(model, theta)
        step, step_drive = _discretise(system, feed @ readout, generator, interval)
        kicks = jnp.zeros((system.shape[0],)).at[1].set(1.0 / model.inertia(theta))

        def advance(state: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
            w, impulse = inputs
            state = state + kicks * impulse
            return step @ state + step_drive @ w, state[0]

        start = jnp.zeros(system.shape[0])
        return jax.lax.scan(advance, start, (states, impulses))[1]

    signals = states @ readout.T
    system, feed, read, direct = _angle_driven_system(model, theta)
    torque = model.inertia(theta) * signals[:, 2] + signals[:, :2] @ direct
    if model.n_internal == 0:
        return torque
    step, step_drive = _discretise(system, feed @ readout[:2], generator, interval)

    def follow(state: Array, w: Array) -> tuple[Array, Array]:
        return step @ state + step_drive @ w, read @ state

    start = -jnp.linalg.solve(system, feed[:, 0] * signals[0, 0])
    return torque + jax.lax.scan(follow, start, states)[1]


def _discretise(
    system: Array, feed: Array, generator: Array, interval: Array
) -> tuple[Array, Array]:
    """Exact one-sample propagators of a system driven by a generator."""
    n, m = feed.shape
    joined = jnp.block([[system, feed], [jnp.zeros((m, n)), generator]]) if m else system
    step = matrix_exponential(joined * interval)
    return step[:n, :n], step[:n, n:]


def _torque_driven_system(model: Model, theta: ArrayLike) -> tuple[Array, Array]:
    """State and input matrices of the joint [angle, velocity, internal states]."""

    def rates(state: Array, torque: Array) -> Array:
        motion = Motion(state[0], state[1])
        reaction = model.react(theta, motion, state[2:], [motion] * len(model.effects))
        acceleration = (torque - reaction.torque) / model.inertia(theta)
        return jnp.concatenate([jnp.stack([state[1], acceleration]), reaction.rates])

    origin = jnp.zeros(2 + model.n_internal)
    system, feed = jax.jacfwd(rates, argnums=(0, 1))(origin, jnp.asarray(0.0))
    return system, feed[:, None]


def _angle_driven_system(model: Model, theta: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Matrices of the internal states driven by (angle, velocity), and of the torque."""

    def react(internal: Array, moved: Array) -> tuple[Array, Array]:
        motion = Motion(moved[0], moved[1])
        reaction = model.react(theta, motion, internal, [motion] * len(model.effects))
        return reaction.rates, reaction.torque

    jacobian = jax.jacfwd(react, argnums=(0, 1))(jnp.zeros(model.n_internal), jnp.zeros(2))
    (system, feed), (read, direct) = jacobian
    return system, feed, read, direct


class Program(NamedTuple):
    """What a compiled function is specialised to.

    Attributes
    ----------
    model : Model
    free : tuple of int
        Parameters by which derivatives are wanted.
    order : int
        Of the scheme; 0 for the exact response.
    room : int
        Steps a sample that the past of a delayed model has room for.
    readings : int
        That instruments take in a sampling interval.
    """

    model: Model
    free: tuple[int, ...] = ()
    order: int = 0
    room: int = 0
    readings: int = 1


class Traced:
    """Responses of a model to some drives as JAX computes them: of one with unusual operations.

    Attributes
    ----------
    starts, columns, lanes : see `Responses`
    """

    def __init__(
        self,
        model: Model,
        free: tuple[int, ...],
        drives: Sequence[Drive],
        scheme: Scheme,
        finer: Scheme | None = None,
    ) -> None:
        readings = readings_of(model, max(drive.interval for drive in drives))
        self._program, self._steps = Program(model, free, readings=readings), np.array(0)
        if not scheme.exact:
            steps = scheme.between(readings)
            most = max(steps, (finer or scheme).between(readings))
            room = most if model.delayed else 0
            self._program = Program(model, free, scheme.order, room, readings)
            self._steps = np.array(steps)
        self._drives = [drive_arrays(drive) for drive in drives]
        self.starts = np.cumsum([0, *(len(drive.states) for drive in drives)])
        self.columns, self.lanes = 1 + len(free), lanes_of(model, free)

    def at(self, theta: np.ndarray) -> list[np.ndarray]:
        """Responses and their derivatives, see `Responses.at`."""
        theta = np.asarray(theta, float)
        return [
            np.asarray(_linearised(self._program, theta, drive, self._steps))
            for drive in self._drives
        ]

    def values(self, thetas: np.ndarray) -> np.ndarray:
        """Responses at many parameter vectors, shape (n_thetas, n)."""
        found = [np.empty((0, self.starts[-1]))]
        for first in range(0, len(thetas), _BATCH):
            chunk = thetas[first : first + _BATCH]
            # Of one size, so that one program serves any number of them.
            size = _BATCH if len(thetas) > 1 else 1
            padded = np.resize(chunk, (size, thetas.shape[1]))
            parts = [_batch(self._program, padded, d, self._steps) for d in self._drives]
            found.append(np.concatenate(parts, axis=1)[: len(chunk)])
        return np.concatenate(found)


def responses_by(
    model: Model,
    free: tuple[int, ...],
    drives: Sequence[Drive],
    scheme: Scheme,
    finer: Scheme | None = None,
) -> Responses | Traced:
    """Responses of a model to some drives, by machine code where that knows the model.

    Parameters
    ----------
    model : Model
    free : tuple of int
        Parameters by which derivatives are wanted.
    drives : sequence of Drive
        All of torques, or all of angles.
    scheme : Scheme
    finer : Scheme, optional
        One that is asked for later: programs of JAX then serve both.
    """
    native = responses_of(model, free, drives, scheme)
    return Traced(model, free, drives, scheme, finer) if native is None else native


def _respond(program: Program, theta: Array, arrays: DriveArrays, substeps: Array) -> Array:
    model, _, order, room, readings = program
    if not order:
        return exact_response(model, theta, arrays, readings)
    return integrate(model, theta, arrays, substeps, order, room, readings)


@compiled
def _batch(program: Program, thetas: Array, arrays: DriveArrays, substeps: Array) -> Array:
    return jax.vmap(lambda theta: _respond(program, theta, arrays, substeps))(thetas)


@compiled
def _linearised(program: Program, theta: Array, arrays: DriveArrays, substeps: Array) -> Array:
    def along(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda x: _respond(program, x, arrays, substeps), (theta,), (direction,))

    if not program.free:
        return _respond(program, theta, arrays, substeps)[:, None]
    directions = jnp.eye(len(theta))[jnp.array(program.free)]
    value, slopes = jax.vmap(along, out_axes=(None, 1))(directions)
    return jnp.concatenate([value[:, None], slopes], axis=1)
