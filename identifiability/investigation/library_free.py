"""Kinds of missing physics, each as a Gaussian process that no named effect stands behind.

With an imposed torque the joint moves as ``y = S (tau - m)``: S is the response to torque, and m
the torque that the model lacks, a function of the motion that took place. Against the prediction
the residual is therefore ``-S m``, exactly and not only for small m, if m is computed from the
motion as it was: what the model predicts plus the smooth part of the residual. (The recorded angle
itself is too noisy to be differentiated.) For the same reason a change of K, B or I acts on that
motion. With an imposed angle the motion is known and the residual is m itself.

Each term is piecewise linear in time, lag or state between nodes, with a Gaussian process over the
nodes, so that everything is linear in the values at the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import fftconvolve

from identifiability.inference.problem import Problem
from identifiability.investigation.candidates import Candidate, Workbench
from identifiability.investigation.evidence import Ready
from identifiability.investigation.linear_gaussian import Columns, side_by_side, square_root
from identifiability.joint.model import KBI, Model
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque

_MOST_SAMPLES = 5000  # of all trials; more are averaged in bins
_FILTERED_SPACING = 0.01  # s; samples behind a low-pass of 50 Hz are independent at this spacing
_MOST_NODES = 500  # of a torque in time, over all trials
_TORQUE_NODES, _DRIFT_NODES, _STIFFNESS_NODES = 0.01, 0.03, 0.05  # s between nodes
_FASTEST_DRIFT, _SLOWEST_TORQUE = 0.15, 0.15  # s; a slower torque moves the joint as a drift does
# A muscle needs this long to change its stiffness; what changes faster goes with the motion.
_FASTEST_CHANGE = 0.2  # s
_WARP = 0.1  # share of the largest value above which the nodes of a state are spaced by ratios
_STATE_NODES = 13
_THRESHOLDS = 14

Roots = Callable[[np.ndarray], list[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Trace:
    """One fitted trial at its compared samples.

    Attributes
    ----------
    ready : Ready
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

    ready: Ready
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


@dataclass(frozen=True, eq=False)
class Term:
    """One kind of missing physics.

    Attributes
    ----------
    key, kind : str
    shared : bool
        Whether its weights are the same in all trials.
    columns : tuple of array, shape (n, m)
        For each trial, what a unit weight adds to the residual.
    torques : tuple of array, shape (n, m), or None
        The torque [Nm] of a unit weight; ``None`` for terms of the sensor.
    roots : callable
        Square root of the prior covariance of the weights, one matrix, or one for each trial if
        they are not shared, from the hyperparameters.
    names : tuple of str
        Of the hyperparameters.
    start : array, shape (k,)
    bounds : array, shape (k, 2)
    n_scales : int
        The first so many hyperparameters are sizes, the others shapes.
    nodes : tuple of array
        Where the weights are: lags, angles and velocities, or times.
    """

    key: str
    kind: str
    shared: bool
    columns: tuple[np.ndarray, ...]
    torques: tuple[np.ndarray, ...] | None
    roots: Roots
    names: tuple[str, ...]
    start: np.ndarray
    bounds: np.ndarray
    n_scales: int = 1
    nodes: tuple[np.ndarray, ...] = ()


def traces_of(bench: Workbench, candidate: Candidate) -> tuple[list[Trace], Response]:
    """Fitted trials as a candidate leaves them; the motion is still the predicted one."""
    evidence, model = bench.evidence, candidate.model
    problem = bench.problem(model, evidence.fitted, refined=candidate.refined)
    nuisances = _jacobians(bench, problem, candidate)
    traces = []
    for ready, residual, nuisance in zip(
        evidence.fitted, candidate.fitted.by_trial, nuisances, strict=True
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
    evidence = bench.evidence
    theta = candidate.model.vector(candidate.values)[list(problem.free)]
    white = problem.jacobian(theta).reshape(*evidence.room, -1)
    out, row = [], 0
    for ready, sd in zip(evidence.fitted, evidence.weights_sd(evidence.fitted), strict=True):
        collected: list[np.ndarray] = []
        while sum(len(c) for c in collected) < ready.last - ready.first:
            compared = problem.observations[row].scale > 0
            collected.append(white[row, : compared.size][compared])
            row += 1
        out.append(sd * np.concatenate(collected))
    return out


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
    # In series with a tendon, stiffness and damping multiply a motion that is not the joint's.
    acting = ("I",) if any(e.place == "series" for e in effects) else ("K", "B", "I")
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
    theta, substeps = model.vector(values), None if model.linear else 2
    moved, still = (
        simulate(
            model, theta, SampledTorque(size * (time == time[1])).drive(time), substeps=substeps
        )
        for size in (1.0, 0.0)
    )
    return np.asarray((moved - still)[1:])


# Pieces that terms are made of


def interpolation(at: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Weights of linear interpolation, shape (n, m); 0 outside of the nodes."""
    out = np.zeros((at.size, nodes.size))
    left = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    share = (at - nodes[left]) / (nodes[left + 1] - nodes[left])
    inside = np.flatnonzero((share >= 0) & (share <= 1 + 1e-9))
    out[inside, left[inside]] = 1 - share[inside]
    out[inside, left[inside] + 1] = share[inside]
    return out


def past(signal: np.ndarray, lags: np.ndarray, interval: float) -> np.ndarray:
    """Convolutions of a signal with kernels that are 1 at one lag, 0 at the others; (n, m)."""
    fine = np.arange(round(lags[-1] / interval) + 1) * interval
    kernels = interval * interpolation(fine, lags)
    return np.asarray(fftconvolve(signal[:, None], kernels, axes=0)[: signal.size])


def matern(distance: np.ndarray, length: float) -> np.ndarray:
    """Correlation of the once differentiable Matern process (order 3/2)."""
    scaled = np.sqrt(3) * np.abs(distance) / length
    return np.asarray((1 + scaled) * np.exp(-scaled))


def stable_spline(lags: np.ndarray, decay: float) -> np.ndarray:
    """Covariance of a kernel that decays with lag and may jump (first-order stable spline).

    Pillonetto & De Nicolao 2010 (Automatica 46: 81-93).
    """
    return np.asarray(np.exp(-np.maximum(lags[:, None], lags) / decay))


def stops(angle: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Stop operators: they follow the motion, up to a threshold; shape (n, m), within -1..1.

    With a small threshold this is dry friction that can stick, with a larger one an elastic
    element that yields (Prandtl-Ishlinskii; Krejci & Kuhnen 2001, IEE Proc Control 148: 185-192).
    """
    out = np.zeros((angle.size, thresholds.size))
    stretch = np.zeros(thresholds.size)
    for i, move in enumerate(np.diff(angle)):
        stretch = np.clip(stretch + move, -thresholds, thresholds)
        out[i + 1] = stretch
    return out / thresholds


def _in_time(nodes: Sequence[np.ndarray]) -> Roots:
    """Roots of a Matern process in each trial, of a size and a length.

    Nodes start at 0 in every trial and are equally spaced, so the root for a short trial is the
    first part of that for the longest.
    """
    longest = max(nodes, key=len)
    distance = longest[:, None] - longest

    def roots(h: np.ndarray) -> list[np.ndarray]:
        root = h[0] * square_root(matern(distance, h[1]))
        return [root[: n.size, : n.size] for n in nodes]

    return roots


def _log_range(*ranges: tuple[float, float]) -> np.ndarray:
    return np.log(np.array(ranges))


@dataclass(frozen=True, eq=False)
class Terms:
    """Makes the terms for a set of traces."""

    traces: Sequence[Trace]
    response: Response
    values: dict[str, float]

    def every(self) -> Iterator[Term]:
        """All terms."""
        yield self.unrepeatable()
        yield self.drift()
        yield self.common_drift()
        yield self.sensor()
        yield self.static()
        yield self.hysteresis()
        yield self.memory("memory", lambda velocity: velocity)
        yield self.memory("memory_positive", lambda velocity: np.maximum(velocity, 0))
        yield self.memory("memory_negative", lambda velocity: np.minimum(velocity, 0))
        yield self.variation()
        yield self.varying()

    def _spacing(self, wanted: float) -> float:
        return max(wanted, sum(t.time[-1] for t in self.traces) / _MOST_NODES)

    def _nodes(self, trace: Trace, spacing: float) -> np.ndarray:
        return np.arange(0.0, trace.time[-1] + spacing, spacing)

    def _felt(self, torques: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        return tuple(
            self.response.to(m, t.interval) for m, t in zip(torques, self.traces, strict=True)
        )

    def _scaled(
        self,
        columns: Sequence[np.ndarray],
        roots: Roots,
        shapes: Sequence[float],
        ranges: Sequence[tuple[float, float]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start and bounds of a size that explains the whole residual, and of the shapes."""
        made = roots(np.array([1.0, *shapes]))
        made = made * len(columns) if len(made) == 1 else made
        power = sum(np.sum((c @ root) ** 2) for c, root in zip(columns, made, strict=True))
        energy = sum(np.sum(t.residual**2) for t in self.traces)
        size = np.sqrt(max(energy, 1e-300) / max(power, 1e-300))
        return np.array([size, *shapes]), _log_range((1e-4 * size, 400 * size), *ranges)

    def unrepeatable(self) -> Term:
        """A smooth torque of its own in every trial."""
        spacing = self._spacing(_TORQUE_NODES)
        nodes = [self._nodes(t, spacing) for t in self.traces]
        torques = tuple(interpolation(t.time, n) for t, n in zip(self.traces, nodes, strict=True))
        columns = self._felt(torques)
        roots = _in_time(nodes)

        start, bounds = self._scaled(columns, roots, [0.04], [(0.004, _SLOWEST_TORQUE)])
        return Term(
            "unrepeatable",
            "unrepeatable",
            False,
            columns,
            torques,
            roots,
            ("size [Nm]", "length [s]"),
            start,
            bounds,
            nodes=tuple(nodes),
        )

    def drift(self) -> Term:
        """A slow change of the recorded response, of its own in every trial."""
        spacing = self._spacing(_DRIFT_NODES)
        nodes = [self._nodes(t, spacing) for t in self.traces]
        columns = tuple(interpolation(t.time, n) for t, n in zip(self.traces, nodes, strict=True))
        roots = _in_time(nodes)

        start, bounds = self._scaled(columns, roots, [0.5], [(_FASTEST_DRIFT, 5.0)])
        names = ("size", "length [s]")
        return Term("drift", "drift", False, columns, None, roots, names, start, bounds)

    def common_drift(self) -> Term:
        """A slow change of the recorded response that is the same in all trials."""
        longest = max(self.traces, key=lambda t: t.time[-1])
        nodes = self._nodes(longest, self._spacing(_DRIFT_NODES))
        columns = tuple(interpolation(t.time, nodes) for t in self.traces)
        distance = nodes[:, None] - nodes

        def roots(h: np.ndarray) -> list[np.ndarray]:
            return [h[0] * square_root(matern(distance, h[1]))]

        start, bounds = self._scaled(columns, roots, [0.5], [(_FASTEST_DRIFT, 5.0)])
        names = ("size", "length [s]")
        return Term("common_drift", "drift", True, columns, None, roots, names, start, bounds)

    def sensor(self) -> Term:
        """A filter or shift of the recorded response: a short convolution of its rate.

        The convolution reaches both ways: the recorded response stands for the true one here, and
        the inverse of a filter that is late is early.
        """
        lags = 1e-3 * np.array([0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 21, 25, 30])
        step = max(t.interval for t in self.traces)
        lags = np.concatenate([[0.0], lags[lags >= step][:: max(1, round(step / 1e-3))]])
        columns = []
        for t in self.traces:
            late = past(t.response_rate, lags, t.interval)
            early = past(t.response_rate[::-1], lags, t.interval)[::-1]
            columns.append(np.hstack([late, early]))

        def roots(h: np.ndarray) -> list[np.ndarray]:
            one = h[0] * square_root(stable_spline(lags, h[1]))
            return [side_by_side(one, one)]

        start, bounds = self._scaled(columns, roots, [0.01], [(0.001, 0.03)])
        names = ("size", "decay [s]")
        return Term(
            "sensor",
            "sensor",
            True,
            tuple(columns),
            None,
            roots,
            names,
            start,
            bounds,
            nodes=(lags,),
        )

    def static(self) -> Term:
        """A torque that is a function of the present angle and velocity.

        Nodes lie on a grid, dense about rest. The function is a smooth process plus powers of
        angle and velocity and the sign of velocity.
        """
        largest = [
            max(np.abs(getattr(t, x)).max() for t in self.traces) for x in ("angle", "velocity")
        ]
        grid = np.linspace(-1.0, 1.0, _STATE_NODES)
        width = np.arcsinh(1 / _WARP)
        spread = _WARP * np.sinh(grid * width)

        def at(values: np.ndarray, scale: float) -> np.ndarray:
            return interpolation(np.clip(np.arcsinh(values / (_WARP * scale)) / width, -1, 1), grid)

        whole = []
        for t in self.traces:
            by_angle, by_velocity = at(t.angle, largest[0]), at(t.velocity, largest[1])
            whole.append((by_angle[:, :, None] * by_velocity[:, None, :]).reshape(t.angle.size, -1))
        visited = np.flatnonzero(sum(w.sum(axis=0) for w in whole) > 3)
        torques = tuple(w[:, visited] for w in whole)
        columns = self._felt(torques)
        x, v = (c.ravel()[visited] for c in np.meshgrid(grid, grid, indexing="ij"))
        angle, velocity = (c.ravel()[visited] for c in np.meshgrid(spread, spread, indexing="ij"))
        powers = np.column_stack(
            [angle**2, angle**3, velocity * np.abs(velocity), np.sign(v), angle * velocity]
        )
        means = powers @ powers.T
        squared = (x[:, None] - x) ** 2 + (v[:, None] - v) ** 2

        def roots(h: np.ndarray) -> list[np.ndarray]:
            smooth = np.exp(-0.5 * squared / h[1] ** 2)
            smooth.flat[:: len(smooth) + 1] += 1e-6
            return [h[0] * square_root(smooth + h[2] ** 2 * means)]

        start, bounds = self._scaled(columns, roots, [0.5, 1.0], [(0.1, 5.0), (0.03, 30.0)])
        return Term(
            "static",
            "static",
            True,
            columns,
            torques,
            roots,
            ("size [Nm]", "length", "share of powers"),
            start,
            bounds,
            nodes=(largest[0] * spread, largest[1] * spread, visited),
        )

    def hysteresis(self) -> Term:
        """A torque of how far the joint has moved since it turned back, not of how fast."""
        largest = max(np.abs(t.angle).max() for t in self.traces)
        thresholds = largest * np.geomspace(0.003, 0.7, _THRESHOLDS)
        torques = tuple(stops(t.angle, thresholds) for t in self.traces)
        columns = self._felt(torques)
        distance = np.log(thresholds)[:, None] - np.log(thresholds)

        def roots(h: np.ndarray) -> list[np.ndarray]:
            return [h[0] * square_root(matern(distance, h[1]))]

        start, bounds = self._scaled(columns, roots, [1.0], [(0.2, 5.0)])
        return Term(
            "hysteresis",
            "hysteresis",
            True,
            columns,
            torques,
            roots,
            ("size [Nm]", "length"),
            start,
            bounds,
            nodes=(thresholds,),
        )

    def memory(self, key: str, part: Callable[[np.ndarray], np.ndarray]) -> Term:
        """A torque that depends on past velocity, or on a part of it, up to 300 ms ago."""
        reach = min(0.3, 0.75 * max(t.time[-1] for t in self.traces))
        lags = np.concatenate(
            [np.arange(0, 0.02, 0.0025), np.arange(0.02, 0.1, 0.005), np.arange(0.1, 0.31, 0.0125)]
        )
        step = max(t.interval for t in self.traces)
        lags = lags[lags <= reach]
        lags = lags[np.concatenate([[True], np.diff(np.floor(lags / step + 1e-6)) > 0])]
        torques = tuple(past(part(t.velocity), lags, t.interval) for t in self.traces)
        columns = self._felt(torques)

        def roots(h: np.ndarray) -> list[np.ndarray]:
            return [h[0] * square_root(stable_spline(lags, h[1]))]

        start, bounds = self._scaled(columns, roots, [0.05], [(0.005, 0.5)])
        return Term(
            key,
            "memory",
            True,
            columns,
            torques,
            roots,
            ("size [Nm/rad]", "decay [s]"),
            start,
            bounds,
            nodes=(lags,),
        )

    def variation(self) -> Term:
        """Stiffness and damping that differ from trial to trial, by a share of themselves."""
        stiffness, damping = self.values["K"], self.values["B"]
        torques = tuple(
            np.column_stack([stiffness * t.angle, damping * t.velocity]) for t in self.traces
        )

        def roots(h: np.ndarray) -> list[np.ndarray]:
            return [np.diag(h)] * len(self.traces)

        return Term(
            "variation",
            "unrepeatable",
            False,
            self._felt(torques),
            torques,
            roots,
            ("sd of ln K", "sd of ln B"),
            np.array([0.05, 0.05]),
            _log_range((1e-4, 2.0), (1e-4, 2.0)),
            n_scales=2,
        )

    def varying(self) -> Term:
        """Stiffness and damping that change within trials, differently in each."""
        spacing = self._spacing(_STIFFNESS_NODES)
        stiffness, damping = self.values["K"], self.values["B"]
        nodes = [self._nodes(t, spacing) for t in self.traces]
        in_time, torques = _in_time(nodes), []
        for t, own in zip(self.traces, nodes, strict=True):
            at = interpolation(t.time, own)
            torques.append(
                np.hstack([stiffness * t.angle[:, None] * at, damping * t.velocity[:, None] * at])
            )

        def roots(h: np.ndarray) -> list[np.ndarray]:
            return [side_by_side(h[0] * c, h[1] * c) for c in in_time(np.array([1.0, h[2]]))]

        return Term(
            "varying",
            "unrepeatable",
            False,
            self._felt(torques),
            tuple(torques),
            roots,
            ("sd of ln K", "sd of ln B", "length [s]"),
            np.array([0.05, 0.05, 0.3]),
            _log_range((1e-4, 2.0), (1e-4, 2.0), (_FASTEST_CHANGE, 5.0)),
            n_scales=2,
        )


@dataclass(frozen=True, eq=False)
class Background:
    """What every explanation has besides its terms: unknown levels, parameters, and noise.

    Attributes
    ----------
    local : tuple of array, shape (n, m)
        A constant, and the response to noise in the recorded torque where the quiet samples show
        any that matters.
    local_roots : list of array, shape (m, m)
        Square roots of the prior covariances.
    common : tuple of array, shape (n, n_free)
        Derivatives by the candidate's free parameters.
    common_root : array, shape (n_free, n_free)
        Broad: a standard deviation of 100 %.
    """

    local: tuple[np.ndarray, ...]
    local_roots: list[np.ndarray]
    common: tuple[np.ndarray, ...]
    common_root: np.ndarray


def background(traces: Sequence[Trace], candidate: Candidate, torque_in_time: Term) -> Background:
    """What every explanation has besides its terms.

    Parameters
    ----------
    traces : sequence of Trace
    candidate : Candidate
    torque_in_time : Term
        A torque of its own in every trial.
    """
    local, roots = [], []
    variances = [_torque_noise(t, n) for t, n in zip(traces, torque_in_time.nodes, strict=True)]
    felt = [
        np.sqrt(v * np.mean(np.sum(c**2, axis=1)))
        for c, v in zip(torque_in_time.columns, variances, strict=True)
    ]
    matters = any(f > 0.1 * t.ready.lead.sd for f, t in zip(felt, traces, strict=True))
    for t, columns, variance in zip(traces, torque_in_time.columns, variances, strict=True):
        # A level that was read from quiet samples is uncertain by less than the noise itself.
        level = t.ready.lead.sd if t.ready.lead.n_samples else np.sqrt(t.ready.mean_square)
        constant = np.full((t.residual.size, 1), max(level, 1e-12))
        noisy = columns if matters else columns[:, :0]
        local.append(np.hstack([constant, noisy]))
        roots.append(np.diag([1.0, *(np.sqrt(variance),) * noisy.shape[1]]))
    sizes = [max(abs(candidate.values[name]), 1e-3) for name in candidate.free]
    return Background(tuple(local), roots, tuple(t.nuisance for t in traces), np.diag(sizes))


def _torque_noise(trace: Trace, nodes: np.ndarray) -> float:
    """Variance [Nm²] at the nodes of white noise in the recorded torque, from the quiet samples."""
    ready = trace.ready
    if trace.ready.trial.driven == "angle" or ready.lead.n_samples == 0:
        return 0.0
    quiet = ready.trial.torque[: ready.lead.n_samples]
    return float(np.var(quiet) * trace.interval / (nodes[1] - nodes[0]))


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
