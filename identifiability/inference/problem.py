"""A model, measurements, noise and a prior: everything that inference needs, as one function.

This is the waist of the package. Above it are physics and measurements; below it fits, widths,
samplers and quadrature see only parameter vectors, whitened residuals and log probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import local
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from identifiability.errors import InputError
from identifiability.inference.evaluation import Compared, Evaluation, compared
from identifiability.inference.likelihood import coloured
from identifiability.inference.likelihood.coloured import Colour, ColourArrays
from identifiability.joint.instruments import readings_of
from identifiability.joint.integrator import integrate
from identifiability.joint.model import Model
from identifiability.joint.native.response import responses_of
from identifiability.joint.programs import compiled, make_room
from identifiability.joint.response import exact_response
from identifiability.joint.scheme import Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Drive

_BATCH = 32  # points that JAX computes at once, where machine code does not know the model
_DIFFERENCE = 1e-3  # step of differences, in slice widths


@dataclass(frozen=True, eq=False)
class Observation:
    """One measured response, and how its residual is whitened.

    With r the residual, the whitened residual is ``scale * (r - carry * r[previous])``, freed of an
    unknown constant in each segment. Samples that are not compared have a scale of 0.

    Attributes
    ----------
    drive : Drive
        The imposed signal, n samples.
    measured : array, shape (n,)
        Response: angle [rad] to a torque, torque [Nm] to an angle.
    scale, carry : array, shape (n,)
        Whitening of first-order autoregressive noise; carry is 0 where a stretch begins.
    previous : array of int, shape (n,)
        The compared sample before each sample.
    constant : array, shape (n,)
        A constant offset, whitened and normalised within each segment; 0 without offsets.
    segment : array of int, shape (n,)
        Segment that each sample belongs to.
    n_offsets : int
        Number of segments with an offset to be profiled out.
    n_compared : int
        Number of compared samples.
    continues : bool
        Whether its segments are those of the observation before: pieces of one long record.
    """

    drive: Drive
    measured: np.ndarray
    scale: np.ndarray
    carry: np.ndarray
    previous: np.ndarray
    constant: np.ndarray
    segment: np.ndarray
    n_offsets: int
    n_compared: int
    continues: bool = False


def observe(
    drive: Drive,
    measured: np.ndarray,
    noise: Noise,
    *,
    select: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    segment: np.ndarray | None = None,
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
        correlated over the gap as its correlation time says.
    weights : array, shape (k,), optional
        Weight of each squared residual, such as those of a quadrature rule in time; 1 by default.
    segment : array of int, shape (k,), optional
        Number, from 0, of the stretch that each selected sample belongs to. Each stretch then has
        an unknown constant offset, which is profiled out. Without it there is no offset.

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
    stretches = np.zeros(chosen.size, int) if segment is None else np.asarray(segment, int)
    begins = np.diff(stretches, prepend=-1) != 0
    gaps = np.diff(chosen, prepend=chosen[0]) * drive.interval
    kept = np.array([noise.lag_correlation(gap) for gap in gaps])
    kept[begins] = 0.0
    sharp = np.sqrt(1.0 if weights is None else weights) / (noise.sd * np.sqrt(1.0 - kept**2))
    level = np.zeros(chosen.size)
    n_offsets = 0
    if segment is not None:
        n_offsets = int(stretches.max()) + 1
        level = sharp * (1.0 - kept)
        level /= np.sqrt(np.bincount(stretches, level**2, n_offsets))[stretches]

    def spread(values: np.ndarray) -> np.ndarray:
        whole = np.zeros(n, values.dtype)
        whole[chosen] = values
        return whole

    return Observation(
        drive,
        measured,
        spread(sharp),
        spread(kept),
        spread(np.concatenate([chosen[:1], chosen[:-1]])),
        spread(level),
        spread(stretches),
        n_offsets,
        chosen.size,
    )


class Data(NamedTuple):
    """Observations stacked for compiled functions, padded to the longest; leading axis: trials.

    The interval is a single one where all trials share it; so are the integration steps in it.
    """

    interval: Array
    substeps: Array
    generator: Array
    readout: Array
    states: Array
    impulses: Array
    measured: Array
    scale: Array
    carry: Array
    previous: Array
    constant: Array
    segment: Array
    offsets: Array
    colour: ColourArrays | None


def _stack(
    observations: Sequence[Observation],
    substeps: int,
    room: tuple[int, int],
    colour: Colour | None,
) -> Data:
    drives = [o.drive for o in observations]
    rows = max(len(drives), room[0])
    longest = max(room[1], *(len(d.states) for d in drives))

    def padded(arrays: Sequence[np.ndarray]) -> np.ndarray:
        stacked = np.zeros((rows, longest, *arrays[0].shape[1:]), arrays[0].dtype)
        for row, array in zip(stacked, arrays, strict=False):
            row[: len(array)] = array
        return stacked

    firsts, used = _segments(observations)
    # Their number is padded too, to compile less often.
    n_offsets = 0 if used == 0 else 1 << (used - 1).bit_length()
    arrays = (
        _common([d.interval for d in drives], rows),
        np.array(substeps),
        drives[0].generator,
        drives[0].readout,
        padded([d.states for d in drives]),
        padded([d.impulses for d in drives]),
        padded([o.measured for o in observations]),
        padded([o.scale for o in observations]),
        padded([o.carry for o in observations]),
        padded([o.previous for o in observations]),
        padded([o.constant for o in observations]),
        padded([o.segment + first for o, first in zip(observations, firsts, strict=True)]),
        np.zeros(n_offsets),
    )
    arranged = None if colour is None else colour.arrays()
    return Data._make([*(jnp.asarray(array) for array in arrays), arranged])


def _segments(observations: Sequence[Observation]) -> tuple[list[int], int]:
    """Number of each observation's first segment, all counted in one row; and of all of them."""
    firsts: list[int] = []
    used = 0
    for o in observations:
        firsts.append(firsts[-1] if o.continues else used)
        used = max(used, firsts[-1] + o.n_offsets)
    return firsts, used


def _common(intervals: Sequence[float], rows: int) -> np.ndarray:
    """One sampling interval where all are equal: steps then fall together, which is much faster."""
    if np.ptp(intervals) <= 1e-9 * intervals[0]:
        return np.array(intervals[0])
    return np.resize(intervals, rows)


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
    def recorded(cls, model: Model, **bounds: tuple[float, float]) -> Prior:
        """Bounds that any recorded joint lies within, a finger's, a standing body's or a robot's.

        Some replaced by name. An index finger has some 1e-4 kg m², a standing body 70 kg m² and
        1,000 Nm/rad (Winter 2009; Loram & Lakie 2002); a rigid drive is stiffer still.
        """
        return cls.physical(model, **{**_ANY_JOINT, **bounds})

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


_ANY_JOINT = {"K": (0.0, 1e5), "B": (0.0, 1e4), "I": (1e-7, 1e3)}


class Program(NamedTuple):
    """What a compiled function is specialised to; everything else is data.

    The order of the scheme is 0 where the response is exact. The history of a delayed model has
    room for so many steps a sample. Instruments read the response so often in a sampling interval.
    """

    model: Model
    free: tuple[int, ...]
    order: int = 0
    history: int = 0
    readings: int = 1


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
    scheme : Scheme, optional
        How the response is computed. Without it a linear model is solved exactly, and another in
        the steps that its parameters, where they are fixed at these values and else at nominal
        ones, ask for.
    room : tuple of int
        Least number of observations and of samples that the data are padded to: problems of one
        shape share their compiled programs.
    exact_hessian : bool
        Whether second derivatives are automatic, or differences of the (automatic) first ones, for
        models whose second derivatives take long to compile.
    colour : Colour, optional
        Noise that whitens the residuals in the place of that of the observations.
    """

    model: Model
    observations: Sequence[Observation]
    prior: Prior
    fixed: Mapping[str, float] = field(default_factory=dict)
    scheme: Scheme | None = None
    room: tuple[int, int] = (0, 0)
    exact_hessian: bool = True
    colour: Colour | None = None
    _last: local = field(default_factory=local, init=False, repr=False)
    _evaluations: dict[tuple[int, ...], Evaluation | None] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        unknown = set(self.fixed) - set(self.model.parameter_names)
        if unknown:
            raise InputError(
                f"found fixed parameters {sorted(unknown)}, expected some of "
                f"{list(self.model.parameter_names)}"
            )
        if len({o.drive.readout.shape for o in self.observations}) != 1:
            raise InputError("the observations must all be driven alike, by torque or by angle")
        self.integration.check(self.model)
        make_room()

    @cached_property
    def integration(self) -> Scheme:
        """How the response is computed."""
        return self.scheme or self.suited(self.template)

    def suited(self, theta: ArrayLike) -> Scheme:
        """Scheme that a full parameter vector of the model asks for at these observations."""
        imposed = self.observations[0].drive.imposed
        return Scheme.for_model(self.model, theta, self.interval, imposed)

    @property
    def interval(self) -> float:
        """Longest sampling interval [s] of the observations."""
        return max(o.drive.interval for o in self.observations)

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
        return sum(o.n_compared for o in self.observations)

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
        scheme, readings = self.integration, readings_of(self.model, self.interval)
        if scheme.exact:
            return Program(self.model, self.free, readings=readings)
        # Room for half the step too, by which the scheme is checked.
        history = scheme.halved.between(readings) if self.model.delayed else 0
        return Program(self.model, self.free, scheme.order, history, readings)

    @cached_property
    def data(self) -> Data:
        """The observations, as compiled functions take them."""
        steps = self.integration.between(self.program.readings)
        return _stack(self.observations, steps, self.room, self.colour)

    def with_prior(self, prior: Prior) -> Problem:
        """Return the same problem with another prior."""
        return replace(self, prior=prior)

    def with_scheme(self, scheme: Scheme) -> Problem:
        """Return the same problem with its response computed in another way."""
        other = replace(self, scheme=scheme)
        if "data" in self.__dict__:
            steps = scheme.between(self.program.readings)
            stacked = self.data._replace(substeps=jnp.asarray(steps))
            other.__dict__["data"] = stacked  # all but the steps, as it would be put together anew
        return other

    def halved(self) -> Problem:
        """Return the same problem in steps half as long, computed by the same compiled programs."""
        other = self.with_scheme(self.integration.halved)
        other.__dict__["program"] = self.program
        return other

    def solver_error(self, x: np.ndarray) -> float:
        """Error of the integration at a point, from what half the step changes.

        Returns
        -------
        float
            Mean square over the compared samples, in units of the noise's variance.
        """
        if self.integration.exact:
            return 0.0
        moved = self.halved().residuals(x) - self.residuals(x)
        return float(moved @ moved) / self.n_samples / self.integration.shown

    def resolved(self, x: np.ndarray, share: float = 0.1) -> Problem:
        """Return the same problem in steps that suit a point: those that it has, or finer ones.

        Parameters
        ----------
        x : array, shape (n_free,)
            Such as the optimum, which may be faster than the nominal parameters.
        share : float
            `solver_error` that is allowed.

        Raises
        ------
        InputError
            Where the model is too fast for its samples at this point.
        """
        suited = self.suited(self.complete(x))
        problem = self
        if suited.is_finer_than(self.integration):
            problem = self.with_scheme(suited)
        while (error := problem.solver_error(x)) > share:
            scheme = problem.integration
            if scheme.finest:
                raise InputError(
                    f"found parameters too fast for samples {self.interval:g} s apart, which "
                    f"{scheme} do not resolve; give narrower bounds or sample more often"
                )
            problem = problem.with_scheme(scheme.improved(error / share))
        return problem

    def complete(self, x: np.ndarray) -> np.ndarray:
        """Parameter vectors of the model, shape (..., n_parameters), from free parameters."""
        x = np.asarray(x, float)
        whole = np.broadcast_to(self.template, (*x.shape[:-1], self.template.size)).copy()
        whole[..., list(self.free)] = x
        return whole

    def free_vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Free parameters, shape (n_free,), from values of all parameters by name."""
        return self.model.vector(values)[list(self.free)]

    def responses(self, x: np.ndarray) -> list[np.ndarray]:
        """Model response of each observation, at all its samples."""
        if (evaluation := self._evaluation(())) is not None:
            return [found[:, 0] for found in evaluation.responses.at(self.complete(x))]
        stacked = np.asarray(_responses(self.program, x, self.template, self.data))
        return [y[: o.measured.size] for y, o in zip(stacked, self.observations, strict=False)]

    def by_observation(self, values: np.ndarray) -> np.ndarray:
        """Residuals, differences of such, or Jacobians, with a leading axis of observations."""
        return values.reshape(max(len(self.observations), self.room[0]), -1, *values.shape[1:])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals, model minus measurement; 0 at samples that are not compared."""
        return self._linearise(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the whitened residuals, shape (n_residuals, n_free)."""
        return self._linearise(x)[1]

    def _linearise(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Optimisers ask for both at the same point, one after the other: compute them together.
        x, last = np.asarray(x, float), self._last
        if not hasattr(last, "x") or not np.array_equal(last.x, x):
            if (evaluation := self._evaluation(self.free)) is not None:
                white = evaluation.whitened(x)
                last.both = white[:, 0].copy(), white[:, 1:].copy()
            else:
                both = _linearised(self.program, x, self.template, self.data)
                last.both = np.asarray(both[0]), np.asarray(both[1])
            last.x = x.copy()
        found: tuple[np.ndarray, np.ndarray] = last.both
        return found

    def solved(self, points: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Least squares from each point on, within the bounds; see `Evaluation.optima`.

        Returns
        -------
        tuple of array, or None
            None of a model that machine code does not know.
        """
        evaluation = self._evaluation(self.free)
        if evaluation is None:
            return None
        return evaluation.optima(points, moves, self.lower, self.upper)

    def _evaluation(self, free: tuple[int, ...]) -> Evaluation | None:
        """The likelihood by machine code, with derivatives by all free parameters or none."""
        if free not in self._evaluations:
            drives = [o.drive for o in self.observations]
            responses = responses_of(self.model, free, drives, self.integration)
            self._evaluations[free] = (
                None
                if responses is None
                else Evaluation(responses, self._compared, self.template, self.free)
            )
        return self._evaluations[free]

    @cached_property
    def _compared(self) -> Compared:
        firsts, used = _segments(self.observations)
        segments = [o.segment + a for o, a in zip(self.observations, firsts, strict=True)]
        return compared(self.observations, segments, used, self.room, self.colour)

    def hessian(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of the negative log likelihood, shape (n_free, n_free)."""
        if self.exact_hessian:
            return np.asarray(_hessian(self.program, x, self.template, self.data))
        x = np.asarray(x, float)
        jacobian = self.jacobian(x)
        steps = _DIFFERENCE / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)

        def gradient(at: np.ndarray) -> np.ndarray:
            residuals, jacobian = self._linearise(at)
            return jacobian.T @ residuals

        rows = [
            (gradient(x + step * unit) - gradient(x - step * unit)) / (2 * step)
            for step, unit in zip(steps, np.eye(x.size), strict=True)
        ]
        return 0.5 * (np.array(rows) + np.array(rows).T)

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
        if (evaluation := self._evaluation(())) is not None:
            return evaluation.log_likelihood(points)

        found = [np.empty(0)]
        for first in range(0, len(points), _BATCH):
            chunk = points[first : first + _BATCH]
            # Of one size, so that one program serves any number of points.
            padded = np.resize(chunk, (_BATCH, points.shape[1]))
            values = _log_likelihoods(self.program, padded, self.template, self.data)
            found.append(np.asarray(values)[: len(chunk)])
        return np.concatenate(found)

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        """Log likelihood inside the prior's bounds, minus infinity outside; shape (n_points,)."""
        points = np.atleast_2d(np.asarray(points, float))
        inside = np.all((points >= self.lower) & (points <= self.upper), axis=1)
        # Points outside are moved inside for the batch to keep its size, then discarded.
        safe = np.clip(points, self.lower, self.upper)
        return np.where(inside, self.log_likelihood(safe), -np.inf)


def _whole(program: Program, x: ArrayLike, template: ArrayLike) -> Array:
    return jnp.asarray(template).at[jnp.array(program.free)].set(jnp.asarray(x))


def _stacked_responses(program: Program, x: ArrayLike, template: ArrayLike, data: Data) -> Array:
    theta = _whole(program, x, template)

    def respond(interval: Array, states: Array, impulses: Array) -> Array:
        arrays = (interval, data.generator, data.readout, states, impulses)
        if not program.order:
            return exact_response(program.model, theta, arrays, program.readings)
        return integrate(
            program.model,
            theta,
            arrays,
            data.substeps,
            program.order,
            program.history,
            program.readings,
        )

    along = (None if jnp.ndim(data.interval) == 0 else 0, 0, 0)
    return jax.vmap(respond, along)(data.interval, data.states, data.impulses)


def whitened(program: Program, x: ArrayLike, template: ArrayLike, data: Data) -> Array:
    """Whitened residuals of all observations in one row, traceable."""
    residual = _stacked_responses(program, x, template, data) - data.measured
    if data.colour is not None:
        return coloured.whitened(residual, _whole(program, x, template), data.colour)
    before = jnp.take_along_axis(residual, jnp.asarray(data.previous), axis=1)
    white = data.scale * (residual - data.carry * before)
    if data.offsets.size:
        sums = jnp.asarray(data.offsets).at[data.segment].add(data.constant * white)
        white = white - data.constant * sums[data.segment]
    return white.ravel()


def _negative_log_likelihood(program: Program, x: Array, template: Array, data: Data) -> Array:
    white = whitened(program, x, template, data)
    return 0.5 * white @ white


_responses = compiled(_stacked_responses)


@compiled
def _linearised(program: Program, x: Array, template: Array, data: Data) -> tuple[Array, Array]:
    def twice(point: Array) -> tuple[Array, Array]:
        white = whitened(program, point, template, data)
        return white, white

    jacobian, white = jax.jacfwd(twice, has_aux=True)(x)
    return white, jacobian


_hessian = jax.jit(
    jax.jacfwd(jax.jacfwd(_negative_log_likelihood, argnums=1), argnums=1), static_argnums=0
)


@compiled
def _log_likelihoods(program: Program, points: Array, template: Array, data: Data) -> Array:
    values = jax.vmap(lambda x: -_negative_log_likelihood(program, x, template, data))(points)
    return jnp.where(jnp.isnan(values), -jnp.inf, values)
