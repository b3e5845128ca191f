"""Kinds of missing physics, each as a Gaussian process that no named effect stands behind.

Each term is piecewise linear in time, lag or state between nodes, with a Gaussian process over the
nodes, so that everything is linear in the values at the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.signal import fftconvolve

from identifiability.investigation.unexplained.linear_gaussian import side_by_side, square_root
from identifiability.investigation.unexplained.traces import Response

# Of a torque in time: what one record has, or several together by what their matrices cost.
_MOST_NODES = 240
_TORQUE_NODES, _DRIFT_NODES, _STIFFNESS_NODES = 0.01, 0.03, 0.05  # s between nodes
_FASTEST_DRIFT, _SLOWEST_TORQUE = 0.15, 0.15  # s; a slower torque moves the joint as a drift does
# A muscle needs this long to change its stiffness; what changes faster goes with the motion.
_FASTEST_CHANGE = 0.2  # s
_WARP = 0.1  # share of the largest value above which the nodes of a state are spaced by ratios
_STATE_NODES = 13
_THRESHOLDS = 14

Roots = Callable[[np.ndarray], list[np.ndarray]]


class Moving(Protocol):
    """A trial as terms see it: see `Trace`."""

    @property
    def interval(self) -> float:
        """Time [s] between samples."""

    @property
    def time(self) -> np.ndarray:
        """Time [s] since the first sample."""

    @property
    def angle(self) -> np.ndarray:
        """Angle [rad]."""

    @property
    def velocity(self) -> np.ndarray:
        """Velocity [rad/s]."""

    @property
    def residual(self) -> np.ndarray:
        """What there is to be explained [rad or Nm]."""

    @property
    def response_rate(self) -> np.ndarray:
        """Rate of the response."""


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

    traces: Sequence[Moving]
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
        return max(wanted, float(np.cbrt(sum(t.time[-1] ** 3 for t in self.traces))) / _MOST_NODES)

    def _nodes(self, trace: Moving, spacing: float) -> np.ndarray:
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
