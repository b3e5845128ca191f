"""What a model leaves of each trial, and the motion on which a missing torque acts.

With an imposed torque the joint moves as ``y = S (tau - m)``: S is the response to torque, and m
the torque that the model lacks, a function of the motion that took place. Against the prediction
the residual is therefore ``-S m``, exactly and not only for small m, if m is computed from the
motion as it was: what the model predicts plus the smooth part of the residual. (The recorded angle
itself is too noisy to be differentiated.) For the same reason a change of K, B or I acts on that
motion. With an imposed angle the motion is known and the residual is m itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import fftconvolve

from identifiability.inference.problem import Problem
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.pieces import places
from identifiability.investigation.unexplained.linear_gaussian import Columns
from identifiability.joint.model import KBI, Model
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.prepared import Prepared

_MOST_SAMPLES = 5000  # of all trials; more are averaged in bins
_FILTERED_SPACING = 0.01  # s; samples behind a low-pass of 50 Hz are independent at this spacing


@dataclass(frozen=True, eq=False)
class Trace:
    """One fitted trial at its compared samples.

    Attributes
    ----------
    ready : Prepared
    interval : float
        Sampling interval [s].
    imposed : array, shape (n,)
        Imposed torque [Nm] or angle [rad].
    residual : array, shape (n,)
        Measured minus predicted response.
    nuisance : array, shape (n, n_free)
        Derivatives of the response with respect to the candidate's free parameters.
    angle, velocity, acceleration : array, shape (n,)
        The motion that took place, in rad and s.
    response_rate : array, shape (n,)
        Rate of the response: velocity [rad/s], or change of torque [Nm/s].
    """

    ready: Prepared
    interval: float
    imposed: np.ndarray
    residual: np.ndarray
    nuisance: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    response_rate: np.ndarray

    @cached_property
    def time(self) -> np.ndarray:
        """Time [s] since the first sample, shape (n,)."""
        return np.arange(self.residual.size) * self.interval

    @property
    def motion(self) -> np.ndarray:
        """What stiffness, damping and inertia multiply, shape (n, 3)."""
        return np.column_stack([self.angle, self.velocity, self.acceleration])


@dataclass(frozen=True, eq=False)
class Response:
    """How a missing torque shows in the response.

    Attributes
    ----------
    impulses : dict of float to array, or None
        By sampling interval, the response to 1 Nm that rises and falls linearly within one sample
        either side; ``None`` where the angle is imposed.
    """

    impulses: dict[float, np.ndarray] | None

    def to(self, torque: np.ndarray, interval: float) -> np.ndarray:
        """Residual that missing torques leave, shape (n, m)."""
        if self.impulses is None:
            return torque
        kernel = self.impulses[interval][: len(torque), None]
        return -fftconvolve(torque, kernel, axes=0)[: len(torque)]


def traces_of(bench: Workbench, candidate: Candidate) -> tuple[list[Trace], Response]:
    """Fitted trials as a candidate leaves them; the motion is still the predicted one."""
    split, model = bench.split, candidate.model
    problem = bench.problem(model, split.fitted, refined=candidate.refined, scheme=candidate.scheme)
    nuisances = _jacobians(bench, problem, candidate)
    traces = []
    for ready, residual, nuisance in zip(
        split.fitted, candidate.fitted.by_trial, nuisances, strict=True
    ):
        signals = ready.drive.signals[ready.first : ready.last]
        trace = Trace(
            ready,
            ready.drive.interval,
            signals[:, 0],
            residual,
            nuisance,
            *(np.zeros(residual.size),) * 4,
        )
        traces.append(_moved(trace, np.zeros(residual.size)))
    return traces, _response(candidate, traces)


def _jacobians(bench: Workbench, problem: Problem, candidate: Candidate) -> list[np.ndarray]:
    """Derivatives of each trial's response at the compared samples, pieces put together."""
    split = bench.split
    white = problem.jacobian(problem.free_vector(candidate.values))
    found = places(problem.observations)
    return [sd * white[at] for at, sd in zip(found, split.weights_sd(split.fitted), strict=True)]


def _moved(trace: Trace, smooth: np.ndarray) -> Trace:
    """Put the smooth part of the residual on top of the predicted response."""
    response = trace.ready.compared - trace.residual + smooth
    rate = np.gradient(response, trace.interval)
    if trace.ready.trial.driven == "angle":
        ready = trace.ready
        motion = ready.drive.signals[ready.first : ready.last].T
    else:
        motion = np.array([response, rate, np.gradient(rate, trace.interval)])
    angle, velocity, acceleration = motion
    return replace(
        trace, angle=angle, velocity=velocity, acceleration=acceleration, response_rate=rate
    )


def follow(
    traces: Sequence[Trace], smooth: Sequence[np.ndarray], candidate: Candidate, response: Response
) -> list[Trace]:
    """Traces whose motion, and what the parameters multiply, is that which took place.

    Parameters
    ----------
    traces : sequence of Trace
    smooth : sequence of array, shape (n,)
        Smooth part of each residual.
    candidate : Candidate
    response : Response
    """
    effects = candidate.model.effects
    # In series with a tendon, stiffness and damping multiply a motion that is not the joint's; nor
    # does what is behind a coupling.
    places = {effect.place for effect in effects}
    acting = "" if "coupling" in places else "I" if "series" in places else "KBI"
    out = []
    for trace, part in zip(traces, smooth, strict=True):
        moved = _moved(trace, part)
        nuisance = trace.nuisance.copy()
        if trace.ready.trial.driven == "torque":
            shift = response.to(moved.motion - trace.motion, trace.interval)
            for i, name in enumerate(("K", "B", "I")):
                if name in acting and name in candidate.free:
                    nuisance[:, candidate.free.index(name)] += shift[:, i]
        out.append(replace(moved, nuisance=nuisance))
    return out


def _response(candidate: Candidate, traces: Sequence[Trace]) -> Response:
    """Response to torque: of a linear model its own, else of the K, B, I that come nearest to it.

    Nearest is that which makes the same torque out of the predicted motion.
    """
    if traces[0].ready.trial.driven == "angle":
        return Response(None)
    model, values = candidate.model, dict(candidate.values)
    if not all(effect.linear for effect in model.effects):
        motion = np.concatenate([t.motion for t in traces])
        torque = np.concatenate([t.imposed for t in traces])
        scale = np.linalg.norm(motion, axis=0)
        nearest = np.linalg.lstsq(motion / scale, torque, rcond=None)[0] / scale
        lower = KBI().lower
        model, values = KBI(), dict(zip("KBI", np.maximum(nearest, lower), strict=True))
    longest: dict[float, int] = {}
    for trace in traces:
        longest[trace.interval] = max(longest.get(trace.interval, 0), trace.residual.size)
    return Response({dt: _impulse(model, values, n, dt) for dt, n in longest.items()})


def _impulse(model: Model, values: dict[str, float], n: int, interval: float) -> np.ndarray:
    time = np.arange(n + 1) * interval
    theta = model.vector(values)
    moved, still = (
        simulate(model, theta, SampledTorque(size * (time == time[1])).drive(time))
        for size in (1.0, 0.0)
    )
    return np.asarray((moved - still)[1:])


def bin_width(traces: Sequence[Trace]) -> int:
    """Number of samples that are averaged: more where there are many, or they were filtered."""
    width = -(-sum(t.residual.size for t in traces) // _MOST_SAMPLES)
    if traces[0].ready.trial.driven == "angle":
        width = max(width, round(_FILTERED_SPACING / traces[0].interval))
    return max(width, 1)


def binned(values: np.ndarray, width: int) -> np.ndarray:
    """Averages over bins of so many samples along the first axis; a last part of a bin is left."""
    n = len(values) // width
    return np.asarray(values[: n * width].reshape(n, width, *values.shape[1:]).mean(axis=1))


def inner_products(
    traces: Sequence[Trace], local: Sequence[np.ndarray], common: Sequence[np.ndarray]
) -> list[Columns]:
    """Inner products of columns and residuals in bins."""
    width = bin_width(traces)
    return [
        Columns.of(*(binned(x, width) for x in (own, shared, t.residual)))
        for t, own, shared in zip(traces, local, common, strict=True)
    ]
