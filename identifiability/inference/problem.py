"""A model, measurements, noise and a prior: everything that inference needs, as one function.

This is the waist of the package. Above it are physics and measurements; below it fits, widths,
samplers and quadrature see only parameter vectors, whitened residuals and log probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from identifiability.errors import InputError
from identifiability.joint.integrator import integrate
from identifiability.joint.model import Model
from identifiability.joint.response import DriveArrays, drive_arrays, exact_response
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Drive

# Batches are padded to one of these sizes, so that three compilations serve any number of points.
BATCHES = (64, 512, 4096)


class Observation(NamedTuple):
    """One measured response, and how its residual is whitened.

    With r the residual at the selected samples, the whitened residual is
    ``scale * (r - carry * previous r)``, freed of an unknown constant in each segment.

    Attributes
    ----------
    drive : tuple of arrays
        The imposed signal.
    fine : array
        The same within each interval, for models that are integrated; else of size 0.
    select : array of int, shape (k,)
        Samples of the response that are compared.
    measured : array, shape (k,)
        What was measured there: angle [rad] or torque [Nm].
    scale, carry : array, shape (k,)
        Whitening of first-order autoregressive noise; carry is 0 where a stretch of samples begins.
    constant : array, shape (k,)
        A constant offset, whitened and normalised within each segment; of size 0 without offsets.
    segment : array of int, shape (k,)
        Segment that each sample belongs to.
    offsets : array, shape (n_segments,)
        Zeros, one for each offset to be profiled out.
    """

    drive: DriveArrays
    fine: np.ndarray
    select: np.ndarray
    measured: np.ndarray
    scale: np.ndarray
    carry: np.ndarray
    constant: np.ndarray
    segment: np.ndarray
    offsets: np.ndarray


def observe(
    drive: Drive,
    measured: np.ndarray,
    noise: Noise,
    *,
    select: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    segment: np.ndarray | None = None,
    substeps: int | None = None,
) -> Observation:
    """Prepare a measured response for inference.

    Parameters
    ----------
    drive : Drive
        The imposed signal, n samples.
    measured : array, shape (n,)
        The response: angle [rad] to a torque, torque [Nm] to an angle.
    noise : Noise
        Of the response.
    select : array of int, shape (k,), optional
        Samples to compare, increasing; all by default. Where they skip samples the noise is
        correlated over the gap as its correlation time says; where they skip more than ten
        correlation times this is as good as independent.
    weights : array, shape (k,), optional
        Weight of each squared residual, such as those of a quadrature rule in time; 1 by default.
    segment : array of int, shape (k,), optional
        Number, from 0, of the stretch that each selected sample belongs to. Each stretch then has
        an unknown constant offset, which is profiled out. Without it there is no offset.
    substeps : int, optional
        Runge-Kutta steps per sample for a model without exact response.

    Returns
    -------
    Observation
    """
    n = len(drive.states)
    measured = np.asarray(measured, float)
    if measured.shape != (n,):
        raise InputError(f"found a response of shape {measured.shape} to a drive of {n} samples")
    chosen = np.arange(n) if select is None else np.asarray(select, int)
    if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n or np.any(np.diff(chosen) < 1):
        raise InputError("the selected samples must be increasing and lie within the record")
    gaps = np.diff(chosen, prepend=chosen[0]) * drive.interval
    carry = np.array([noise.lag_correlation(gap) if gap > 0 else 0.0 for gap in gaps])
    scale = 1.0 / (noise.sd * np.sqrt(1.0 - carry**2))
    if weights is not None:
        scale = scale * np.sqrt(weights)
    constant = np.zeros(0)
    stretches = np.zeros(chosen.size, int)
    n_offsets = 0
    if segment is not None:
        stretches = np.asarray(segment, int)
        n_offsets = int(stretches.max()) + 1
        # Where a stretch begins, the residual before it is not carried over.
        begins = np.diff(stretches, prepend=-1) != 0
        carry = np.where(begins, 0.0, carry)
        scale = np.where(begins, 1.0 / noise.sd, scale)
        constant = scale * (1.0 - carry)
        constant /= np.sqrt(np.bincount(stretches, constant**2, n_offsets))[stretches]
    return Observation(
        drive_arrays(drive),
        np.zeros((0, 0, 0)) if substeps is None else drive.refined(substeps),
        chosen,
        measured[chosen],
        scale,
        carry,
        constant,
        stretches,
        np.zeros(n_offsets),
    )


@dataclass(frozen=True, eq=False)
class Prior:
    """Uniform between bounds, which may be infinite.

    Attributes
    ----------
    lower, upper : array, shape (n_parameters,)
    """

    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def physical(cls, model: Model, **bounds: tuple[float, float]) -> Prior:
        """Bounds declared by the model's parameters, some replaced by name."""
        lower, upper = model.lower, model.upper
        names = list(model.parameter_names)
        for name, (low, high) in bounds.items():
            if name not in names:
                raise InputError(f"found bounds for '{name}', expected one of {names}")
            if not low < high:
                raise InputError(f"found bounds {low}..{high} for {name}, expected lower < upper")
            lower[names.index(name)], upper[names.index(name)] = low, high
        return cls(lower, upper)

    @classmethod
    def unbounded(cls, model: Model) -> Prior:
        """No bounds, but for an inertia above zero, without which there is no motion."""
        n = len(model.parameter_names)
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
        lower[2] = 1e-6
        return cls(lower, upper)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether each point, shape (..., n_parameters), lies inside."""
        return np.all((points >= self.lower) & (points <= self.upper), axis=-1)


class Program(NamedTuple):
    """What a compiled function is specialised to; everything else is data."""

    model: Model
    free: tuple[int, ...]
    substeps: int | None


@dataclass(frozen=True, eq=False)
class Problem:
    """Posterior of the free parameters of a model, given measurements.

    Attributes
    ----------
    model : Model
    observations : sequence of Observation
    prior : Prior
        Over all parameters of the model.
    fixed : mapping of str to float
        Parameters that are known.
    substeps : int, optional
        Runge-Kutta steps per sample, for models without exact response.
    """

    model: Model
    observations: Sequence[Observation]
    prior: Prior
    fixed: Mapping[str, float] = field(default_factory=dict)
    substeps: int | None = None
    _last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = field(
        default=None, init=False, repr=False
    )

    def __post_init__(self) -> None:
        unknown = set(self.fixed) - set(self.model.parameter_names)
        if unknown:
            raise InputError(
                f"found fixed parameters {sorted(unknown)}, expected some of "
                f"{list(self.model.parameter_names)}"
            )

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Indices of the free parameters in the model's vector."""
        names = self.model.parameter_names
        return tuple(i for i, name in enumerate(names) if name not in self.fixed)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.model.parameter_names[i] for i in self.free)

    @cached_property
    def lower(self) -> np.ndarray:
        """Lower bounds of the free parameters."""
        return self.prior.lower[list(self.free)]

    @cached_property
    def upper(self) -> np.ndarray:
        """Upper bounds of the free parameters."""
        return self.prior.upper[list(self.free)]

    @cached_property
    def n_samples(self) -> int:
        """Number of compared samples."""
        return sum(o.measured.size for o in self.observations)

    @cached_property
    def batch(self) -> int:
        """Largest number of points that are computed at once, for the memory they take."""
        return max(b for b in BATCHES if b == BATCHES[0] or b * self.n_samples <= 2**22)

    @cached_property
    def template(self) -> np.ndarray:
        """Parameter vector of the model in which the free ones are to be filled in."""
        template = self.model.nominal
        for name, value in self.fixed.items():
            template[self.model.parameter_names.index(name)] = value
        return template

    @cached_property
    def program(self) -> Program:
        """What compiled functions are specialised to."""
        return Program(self.model, self.free, self.substeps)

    @cached_property
    def data(self) -> tuple[Observation, ...]:
        """The observations, as compiled functions take them."""
        return tuple(self.observations)

    def with_prior(self, prior: Prior) -> Problem:
        """Return the same problem with another prior."""
        return replace(self, prior=prior)

    def complete(self, x: np.ndarray) -> np.ndarray:
        """Parameter vectors of the model, shape (..., n_parameters), from free parameters."""
        x = np.asarray(x, float)
        whole = np.broadcast_to(self.template, (*x.shape[:-1], self.template.size)).copy()
        whole[..., list(self.free)] = x
        return whole

    def responses(self, x: np.ndarray) -> list[np.ndarray]:
        """Model responses at the selected samples of each observation."""
        return [np.asarray(y) for y in _responses(self.program, x, self.template, self.data)]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals, model minus measurement, shape (n_samples,)."""
        return self._linearise(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the whitened residuals, shape (n_samples, n_free)."""
        return self._linearise(x)[1]

    def _linearise(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Optimisers ask for both at the same point, one after the other: compute them together.
        x = np.asarray(x, float)
        if self._last is None or not np.array_equal(self._last[0], x):
            both = _linearised(self.program, x, self.template, self.data)
            object.__setattr__(self, "_last", (x.copy(), np.asarray(both[0]), np.asarray(both[1])))
        assert self._last is not None
        return self._last[1], self._last[2]

    def hessian(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of the negative log likelihood, shape (n_free, n_free)."""
        return np.asarray(_hessian(self.program, x, self.template, self.data))

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """Minus half the sum of squared whitened residuals, for a batch of points.

        Parameters
        ----------
        points : array, shape (n_points, n_free)

        Returns
        -------
        array, shape (n_points,)
            Minus infinity where the response overflows.
        """
        points = np.asarray(points, float)
        out = np.empty(len(points))
        for first in range(0, len(points), self.batch):
            chunk = np.arange(first, min(first + self.batch, len(points)))
            padded = points[pad(chunk)]
            values = _log_likelihoods(self.program, padded, self.template, self.data)
            out[chunk] = np.asarray(values)[: chunk.size]
        return out

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        """Log likelihood inside the prior's bounds, minus infinity outside; shape (n_points,)."""
        points = np.atleast_2d(np.asarray(points, float))
        inside = np.all((points >= self.lower) & (points <= self.upper), axis=1)
        # Points outside are moved inside for the batch to keep its size, then discarded.
        safe = np.clip(points, self.lower, self.upper)
        return np.where(inside, self.log_likelihood(safe), -np.inf)


def pad(indices: np.ndarray) -> np.ndarray:
    """Indices repeated up to the next size in `BATCHES`."""
    return np.resize(indices, next(size for size in BATCHES if size >= indices.size))


def _response(program: Program, theta: Array, observation: Observation) -> Array:
    if program.substeps is None:
        return exact_response(program.model, theta, observation.drive)
    return integrate(
        program.model, theta, observation.drive, observation.fine, program.substeps
    )


def whitened(program: Program, x: Array, template: Array, data: tuple[Observation, ...]) -> Array:
    """Whitened residuals of all observations, shape (n_samples,), traceable."""
    theta = jnp.asarray(template).at[jnp.array(program.free)].set(x)
    parts = []
    for observation in data:
        residual = _response(program, theta, observation)[observation.select] - observation.measured
        previous = jnp.concatenate([jnp.zeros(1), residual[:-1]])
        white = observation.scale * (residual - observation.carry * previous)
        if observation.offsets.size:
            sums = observation.offsets.at[observation.segment].add(observation.constant * white)
            white = white - observation.constant * sums[observation.segment]
        parts.append(white)
    return jnp.concatenate(parts)


def _negative_log_likelihood(
    program: Program, x: Array, template: Array, data: tuple[Observation, ...]
) -> Array:
    white = whitened(program, x, template, data)
    return 0.5 * white @ white


@partial(jax.jit, static_argnums=0)
def _responses(program: Program, x: Array, template: Array, data: tuple[Observation, ...]) -> list[Array]:
    theta = jnp.asarray(template).at[jnp.array(program.free)].set(x)
    return [_response(program, theta, o)[o.select] for o in data]


@partial(jax.jit, static_argnums=0)
def _linearised(
    program: Program, x: Array, template: Array, data: tuple[Observation, ...]
) -> tuple[Array, Array]:
    def twice(point: Array) -> tuple[Array, Array]:
        white = whitened(program, point, template, data)
        return white, white

    jacobian, white = jax.jacfwd(twice, has_aux=True)(x)
    return white, jacobian


_hessian = jax.jit(
    jax.jacfwd(jax.jacfwd(_negative_log_likelihood, argnums=1), argnums=1), static_argnums=0
)


@partial(jax.jit, static_argnums=0)
def _log_likelihoods(
    program: Program, points: Array, template: Array, data: tuple[Observation, ...]
) -> Array:
    values = jax.vmap(lambda x: -_negative_log_likelihood(program, x, template, data))(points)
    return jnp.where(jnp.isnan(values), -jnp.inf, values)
