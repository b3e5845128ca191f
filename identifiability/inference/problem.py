"""A model, measurements, noise and a prior: everything that inference needs, as one function.

This is the waist of the package. Above it are physics and measurements; below it fits, widths,
samplers and quadrature see only parameter vectors, whitened residuals and log probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import local

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.evaluation import CONVERGED, Compared, Evaluation, compared
from identifiability.inference.likelihood.coloured import Colour
from identifiability.joint.model import Model
from identifiability.joint.response import responses_by
from identifiability.joint.scheme import Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Drive

_DIFFERENCE, _SHARE = 1e-2, 1e-2  # step of differences: in slice widths, at most of the value
_LONG = 20_000  # steps of a response that takes some tens of milliseconds
_SMALL = 1e-3  # share of its range that is a usual value of a parameter whose nominal one is 0
# Places of differences of fourth order, in steps, and their shares times 12.
_CENTRAL = (-2, -1, 1, 2), (1, -8, 8, -1)
_FORWARD = (0, 1, 2, 3, 4), (-25, 48, -36, 16, -3)


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


def _segments(observations: Sequence[Observation]) -> tuple[list[int], int]:
    """Number of each observation's first segment, all counted in one row; and of all of them."""
    firsts: list[int] = []
    used = 0
    for o in observations:
        firsts.append(firsts[-1] if o.continues else used)
        used = max(used, firsts[-1] + o.n_offsets)
    return firsts, used


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
    colour : Colour, optional
        Noise that whitens the residuals in the place of that of the observations.
    """

    model: Model
    observations: Sequence[Observation]
    prior: Prior
    fixed: Mapping[str, float] = field(default_factory=dict)
    scheme: Scheme | None = None
    colour: Colour | None = None
    _last: local = field(default_factory=local, init=False, repr=False)
    _evaluations: dict[tuple[int, ...], Evaluation] = field(
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

    @cached_property
    def integration(self) -> Scheme:
        """How the response is computed."""
        return self.scheme or self.suited(self.template)

    def suited(self, theta: np.ndarray) -> Scheme:
        """Scheme that a full parameter vector of the model asks for at these observations."""
        drive = self.observations[0].drive
        return Scheme.for_model(
            self.model, theta, self.interval, drive.imposed, curved=drive.curved
        )

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

    def with_prior(self, prior: Prior) -> Problem:
        """Return the same problem with another prior."""
        return replace(self, prior=prior)

    @property
    def takes_long(self) -> bool:
        """Whether one response to all drives takes so many steps that a sampler has to do with few.

        Steps of integration, or samples where the response is exact.
        """
        samples = sum(len(o.drive.states) for o in self.observations)
        return samples * max(1, self.integration.substeps) > _LONG

    def with_scheme(self, scheme: Scheme) -> Problem:
        """Return the same problem with its response computed in another way."""
        return replace(self, scheme=scheme)

    def halved(self) -> Problem:
        """Return the same problem in steps half as long."""
        return self.with_scheme(self.integration.halved)

    def solver_error(self, x: np.ndarray) -> float:
        """Error of the integration at a point, from what half the step changes.

        Returns
        -------
        float
            Mean square over the compared samples, in units of the noise's variance.
        """
        if self.integration.exact:
            return 0.0
        moved = self.halved().values(x) - self.values(x)
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
        found = self._evaluation(()).responses.at(self.complete(x))
        return [response[:, 0] for response in found]

    def by_observation(self, values: np.ndarray) -> np.ndarray:
        """Residuals, differences of such, or Jacobians, with a leading axis of observations."""
        return values.reshape(len(self.observations), -1, *values.shape[1:])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals, model minus measurement; 0 at samples that are not compared."""
        return self._linearise(x)[0]

    def values(self, x: np.ndarray) -> np.ndarray:
        """`residuals`, without computing their derivatives as well."""
        return self._evaluation(()).whitened(x)[:, 0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the whitened residuals, shape (n_residuals, n_free)."""
        return self._linearise(x)[1]

    def _linearise(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Optimisers ask for both at the same point, one after the other: compute them together.
        x, last = np.asarray(x, float), self._last
        if not hasattr(last, "x") or not np.array_equal(last.x, x):
            white = self._evaluation(self.free).whitened(x)
            last.x, last.both = x.copy(), (white[:, 0].copy(), white[:, 1:].copy())
        found: tuple[np.ndarray, np.ndarray] = last.both
        return found

    def solved(
        self, points: np.ndarray, moves: np.ndarray, accuracy: float = CONVERGED
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Least squares from each point on, within the bounds; see `Evaluation.optima`.

        Returns
        -------
        tuple of array, or None
            None of a model that machine code does not know.
        """
        evaluation = self._evaluation(self.free)
        if not evaluation.native:
            return None
        return evaluation.optima(points, moves, self.lower, self.upper, accuracy)

    def _evaluation(self, free: tuple[int, ...]) -> Evaluation:
        """The likelihood, with derivatives by all free parameters or none."""
        if free not in self._evaluations:
            drives, scheme = [o.drive for o in self.observations], self.integration
            # Room for half the step too, by which the scheme is checked.
            finer = None if scheme.exact else scheme.halved
            responses = responses_by(self.model, free, drives, scheme, finer)
            found = Evaluation(responses, self._compared, self.template, self.free)
            self._evaluations[free] = found
        return self._evaluations[free]

    @cached_property
    def _compared(self) -> Compared:
        firsts, used = _segments(self.observations)
        segments = [o.segment + a for o, a in zip(self.observations, firsts, strict=True)]
        return compared(self.observations, segments, used, self.colour)

    def hessian(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of the negative log likelihood, shape (n_free, n_free).

        Differences of fourth order of its exact gradient.
        """
        x = np.asarray(x, float)
        steps = _DIFFERENCE / np.maximum(np.linalg.norm(self.jacobian(x), axis=0), 1e-12)
        # Where the data say little of a parameter; an inertia stays above 0.
        nominal = np.abs(self.model.nominal[list(self.free)])
        usual = np.where(nominal > 0, nominal, _SMALL * (self.upper - self.lower))
        size = np.where(self.lower > 0, 0.0, usual)
        most = _SHARE * np.maximum(np.abs(x), size)
        steps = np.where(most > 0, np.minimum(steps, most), steps)

        def gradient(at: np.ndarray) -> np.ndarray:
            residuals, jacobian = self._linearise(at)
            return jacobian.T @ residuals

        rows = []
        for i, unit in enumerate(steps * np.eye(x.size)):
            room = (x[i] - self.lower[i]) / steps[i], (self.upper[i] - x[i]) / steps[i]
            # Beyond a bound there may be no joint: from there on inwards.
            at, shares = _CENTRAL if min(room) >= 2 else _FORWARD
            turn = -1 if at is _FORWARD[0] and room[0] > room[1] else 1
            change = sum(w * gradient(x + turn * k * unit) for k, w in zip(at, shares, strict=True))
            rows.append(turn * change / (12 * steps[i]))
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
        return self._evaluation(()).log_likelihood(np.asarray(points, float))

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        """Log likelihood inside the prior's bounds, minus infinity outside; shape (n_points,)."""
        points = np.atleast_2d(np.asarray(points, float))
        inside = np.all((points >= self.lower) & (points <= self.upper), axis=1)
        # Points outside are moved inside for the batch to keep its size, then discarded.
        safe = np.clip(points, self.lower, self.upper)
        return np.where(inside, self.log_likelihood(safe), -np.inf)
