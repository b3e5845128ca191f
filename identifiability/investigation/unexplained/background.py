"""What every explanation has besides its terms: unknown levels, parameters, and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.unexplained.terms import Term
from identifiability.investigation.unexplained.traces import Trace


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
