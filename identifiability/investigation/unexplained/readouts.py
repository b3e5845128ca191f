"""What is read off an explanation: the missing torque, its kernel, its latency, its map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from identifiability.investigation.unexplained.explanation import Explainer, Explanation
from identifiability.investigation.unexplained.linear_gaussian import (
    eliminate,
    side_by_side,
)
from identifiability.investigation.unexplained.terms import Term
from identifiability.investigation.unexplained.traces import Response, Trace, inner_products

_DRAWS = 200
_COARSE_DELAYS = np.arange(0.0, 0.1201, 0.006)
_COARSE_DECAYS = np.array([0.0, 0.008, 0.016, 0.032, 0.064, 0.128])
_FINE_DECAYS = np.geomspace(0.002, 0.4, 25)


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """The torque that the model lacks in one trial, positive where it opposes a positive angle.

    It is what K, B and I cannot take over: its projections on angle, velocity and acceleration,
    which a refit would absorb, are removed, over all trials together.

    Attributes
    ----------
    trial : str
    time, mean, sd : array, shape (n,)
        Time [s] as recorded, torque [Nm], and its standard deviation.
    """

    trial: str
    time: np.ndarray
    mean: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class MemoryKernel:
    """Torque that is left at a time after a unit step of angle: the relaxation.

    Values near a lag of 0 are shared with K and B, which take part of them over.

    Attributes
    ----------
    lag, h, sd : array, shape (m,)
        Lag [s], torque per angle [Nm/rad] and its standard deviation.
    """

    lag: np.ndarray
    h: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class DelayReadout:
    """Latency and decay of the torque, if it is that of a motion delayed, then low-passed.

    Attributes
    ----------
    delay, delay_sd : float
        Latency [s] of highest evidence, and its standard deviation.
    decay, decay_sd : float
        Time constant of the low-pass [s], and its standard deviation.
    nats : float
        Evidence for a latency above 0.
    """

    delay: float
    delay_sd: float
    decay: float
    decay_sd: float
    nats: float


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Torque as a function of angle and velocity, less its part linear in both.

    Attributes
    ----------
    angle, velocity : array, shape (m,)
        Grid [rad], [rad/s], dense about rest.
    torque, sd : array, shape (m, m)
        Torque [Nm] by angle and velocity, NaN at states that were not visited.
    """

    angle: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    sd: np.ndarray


def missing_torque(
    explains: Explainer, found: Explanation, seed: int
) -> tuple[tuple[MissingTorque, ...], np.ndarray]:
    """Torque of all terms, and the coefficients of angle, velocity and acceleration taken out."""
    local, shared = found.posterior.draw(_DRAWS, seed)
    draws = [np.zeros((_DRAWS, t.residual.size)) for t in explains.traces]
    means = [np.zeros(t.residual.size) for t in explains.traces]
    for i in range(len(draws)):
        for t, s in zip(found.terms, found.slices_in(i), strict=True):
            if t.torques is None:
                continue
            drawn = shared if t.shared else local[i]
            mean = found.posterior.common.mean if t.shared else found.posterior.local[i].mean
            draws[i] += drawn[:, s] @ t.torques[i].T
            means[i] += t.torques[i] @ mean[s]
    motion = np.concatenate([t.motion for t in explains.traces])
    scale = np.linalg.norm(motion, axis=0)
    basis, _ = np.linalg.qr(motion / scale)
    ends = np.cumsum([m.size for m in means])[:-1]
    whole, spread = np.concatenate(means), np.concatenate(draws, axis=1)
    slopes = np.linalg.lstsq(motion / scale, whole, rcond=None)[0] / scale
    whole = whole - basis @ (basis.T @ whole)
    spread = spread - (spread @ basis) @ basis.T
    sds = np.std(spread, axis=0)
    out = []
    for trace, mean, sd in zip(
        explains.traces, np.split(whole, ends), np.split(sds, ends), strict=True
    ):
        ready = trace.ready
        out.append(MissingTorque(ready.name, ready.trial.time[ready.first : ready.last], mean, sd))
    return tuple(out), slopes


def static_map(found: Explanation, slopes: np.ndarray) -> StaticMap:
    """Torque over the states that were visited, less what is linear by the given slopes."""
    place, term = next(
        (s, t) for s, t in zip(found.slices, found.terms, strict=True) if t.key == "static"
    )
    angle, velocity, visited = term.nodes
    weights = found.posterior.common
    torque, sd = np.full((2, angle.size * velocity.size), np.nan)
    linear = (slopes[0] * angle[:, None] + slopes[1] * velocity).ravel()
    torque[visited] = weights.mean[place] - linear[visited]
    sd[visited] = weights.sd[place]
    shape = (angle.size, velocity.size)
    return StaticMap(angle, velocity, torque.reshape(shape), sd.reshape(shape))


def read_delay(
    explains: Explainer, response: Response, found: Explanation, memory: Term
) -> DelayReadout:
    """Latency and time constant of highest evidence, each pair of them with its own K and B."""

    def evidence(cells: np.ndarray) -> np.ndarray:
        return _delay_evidence(explains, response, found, memory, cells)

    cells = _cells(_COARSE_DELAYS, _COARSE_DECAYS)
    cells = np.concatenate([_cells(np.zeros(1), _FINE_DECAYS), cells[cells[:, 0] > 0]])
    heights = evidence(cells)
    for width in (0.5, 0.15):
        delay, decay = cells[np.argmax(heights)]
        steps = width * np.linspace(-1, 1, 7)
        delays = delay + _COARSE_DELAYS[1] * steps
        decays = decay * 2**steps if decay else np.array([0.0, 0.002, 0.004, 0.007])
        more = _cells(np.unique(np.maximum(delays, 0.0)), decays)
        cells, heights = np.concatenate([cells, more]), np.append(heights, evidence(more))
    weight = np.exp(heights[-len(more) :] - heights.max())
    weight /= weight.sum()
    delay, decay = cells[np.argmax(heights)]
    spread = weight @ (more - weight @ more) ** 2
    at_once = heights[cells[:, 0] == 0].max()
    return DelayReadout(
        float(delay),
        float(np.sqrt(spread[0])),
        float(decay),
        float(np.sqrt(spread[1])),
        float(heights.max() - at_once),
    )


def _cells(delays: np.ndarray, decays: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(delays, decays, indexing="ij"), axis=-1).reshape(-1, 2)


def _delay_evidence(
    explains: Explainer,
    response: Response,
    found: Explanation,
    memory: Term,
    cells: np.ndarray,
) -> np.ndarray:
    """Log evidence, up to a constant, of each latency and time constant; cells of shape (n, 2)."""
    rest = [t for t in found.terms if t is not memory]
    values = [v for t, v in zip(found.terms, found.values, strict=True) if t is not memory]
    local_roots, rest_root = explains.roots(rest, values)
    moving = [_moving(memory, t) for t in explains.traces]
    n_signals = moving[0].shape[1]
    local, common = [], []
    for i, t in enumerate(explains.traces):
        own = [x.columns[i] for x in rest if not x.shared]
        shared = [x.columns[i] for x in rest if x.shared]
        grid = _delayed(moving[i], t, response, cells)
        local.append(np.hstack([*own, explains.background.local[i]]))
        common.append(np.hstack([grid, *shared, explains.background.common[i]]))
    products = inner_products(explains.traces, local, common)
    summed = np.sum(
        [
            eliminate(c.under(found.noise, i), root).products
            for i, (c, root) in enumerate(zip(products, local_roots, strict=True))
        ],
        axis=0,
    )
    # Torques as large as those there were are possible.
    strength = np.sqrt(np.mean(np.concatenate([_torque(t) for t in explains.traces]) ** 2))
    sizes = strength / np.sqrt(np.mean(np.concatenate(moving) ** 2, axis=0))
    root = side_by_side(np.diag(sizes), rest_root)
    always = np.arange(len(cells) * n_signals, len(summed))
    out = np.empty(len(cells))
    for i in range(len(cells)):
        chosen = np.concatenate([i * n_signals + np.arange(n_signals), always])
        left = eliminate(summed[np.ix_(chosen, chosen)], root)
        out[i] = -0.5 * (left.change + left.products[0, 0])
    return out


def _torque(trace: Trace) -> np.ndarray:
    ready = trace.ready
    return trace.imposed if ready.trial.driven == "torque" else ready.compared


def _moving(memory: Term, trace: Trace) -> np.ndarray:
    """Signals that a memory reads, shape (n, m)."""
    if memory.key == "memory":
        return trace.motion[:, :2]
    sign = 1 if memory.key == "memory_positive" else -1
    return sign * np.maximum(sign * trace.velocity, 0)[:, None]


def _delayed(
    signals: np.ndarray, trace: Trace, response: Response, cells: np.ndarray
) -> np.ndarray:
    """What delayed, low-passed signals add to the residual, shape (n, cells * signals)."""
    out = np.empty((len(signals), len(cells), signals.shape[1]))
    for decay in np.unique(cells[:, 1]):
        keep = np.exp(-trace.interval / decay) if decay else 0.0
        felt = response.to(lfilter([1 - keep], [1, -keep], signals, axis=0), trace.interval)
        for i in np.flatnonzero(cells[:, 1] == decay):
            for j in range(signals.shape[1]):
                earlier = trace.time - cells[i, 0]
                out[:, i, j] = np.interp(earlier, trace.time, felt[:, j], left=0.0)
    return out.reshape(len(signals), -1)
