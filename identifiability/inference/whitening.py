"""Whitened residuals of an observation, with their derivatives."""

from __future__ import annotations

import numpy as np

from identifiability.loops import compiled_loop


@compiled_loop
def whiten(
    response: np.ndarray,
    measured: np.ndarray,
    scale: np.ndarray,
    carry: np.ndarray,
    previous: np.ndarray,
    out: np.ndarray,
) -> None:
    """``scale * (r - carry * r[previous])`` of a residual r, into `out`.

    Parameters
    ----------
    response : array, shape (n, width)
        Response, then its derivatives.
    measured, scale, carry, previous : array, shape (n,)
        See `Observation`.
    out : array, shape (n or more, width)
    """
    for i in range(response.shape[0]):
        before = previous[i]
        for t in range(response.shape[1]):
            rest = response[i, t] - carry[i] * response[before, t]
            if t == 0:
                rest -= measured[i] - carry[i] * measured[before]
            out[i, t] = scale[i] * rest


@compiled_loop
def sum_levels(
    white: np.ndarray, constant: np.ndarray, segment: np.ndarray, out: np.ndarray
) -> None:
    """Add up what each segment has of its constant, into `out`, shape (n_segments, width)."""
    for i in range(segment.size):
        for t in range(white.shape[1]):
            out[segment[i], t] += constant[i] * white[i, t]


@compiled_loop
def take_levels(
    white: np.ndarray, constant: np.ndarray, segment: np.ndarray, sums: np.ndarray
) -> None:
    """Free whitened residuals of these constants, in place."""
    for i in range(segment.size):
        for t in range(white.shape[1]):
            white[i, t] -= constant[i] * sums[segment[i], t]
