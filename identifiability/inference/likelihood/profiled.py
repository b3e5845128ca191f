"""Likelihood of a noise with its level profiled out, as a sum of squares.

It is highest where ``squares exp(log det / freedom)`` is least: that of whitened residuals times a
factor. To find a noise is then a problem of least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from identifiability.inference.likelihood.banded import (
    covariance,
    factor,
    log_determinant_of,
    whitened_without_level,
)
from identifiability.inference.likelihood.trust_region import (
    RADIUS,
    TRIALS,
    clipped,
    nearby,
    next_radius,
    stepped,
)
from identifiability.loops import compiled_loop

_LEAST_GAIN = 3e-6  # of the squares, that a step must promise: half a thousandth of a sample


@compiled_loop
def polynomial(partial: np.ndarray) -> np.ndarray:
    """Polynomial, first coefficient 1, of which these are the partial autocorrelations."""
    found = np.zeros(partial.size + 1)
    found[0] = 1.0
    for i in range(partial.size):
        before = found[: i + 2].copy()
        for j in range(i + 2):
            found[j] = before[j] + partial[i] * before[i + 1 - j]
    return found


class Residuals(NamedTuple):
    """What a noise is sought in, and of which order; its parameters are `values`.

    Those are inverse hyperbolic tangents of the p and q partial autocorrelations of the
    instrument's own noise, then the logarithm of a factor of what came in through the joint, where
    that is sought.

    Attributes
    ----------
    p, q : int
    carried : tuple of array
        Autoregression and moving average of what came in; the latter of zeros where nothing did.
    columns : array
        For each length of stretches, one after the other, their residuals side by side, then the
        `k` derivatives of each; by rows.
    lengths, numbers : array of int
        Samples of these stretches, and how many there are.
    k : int
        Directions that a fit took out of the residuals; none for the likelihood that is not
        restricted.
    """

    p: int
    q: int
    carried: tuple[np.ndarray, np.ndarray]
    columns: np.ndarray
    lengths: np.ndarray
    numbers: np.ndarray
    k: int


@compiled_loop
def scaled_residuals(values: np.ndarray, left: Residuals) -> tuple[np.ndarray, int]:
    """Whitened residuals times the root of the mean variance, and their degrees of freedom.

    Parameters
    ----------
    values : array, shape (p + q,) or (p + q + 1,)
    left : Residuals

    Returns
    -------
    array, shape (n_samples,)
        Infinite where the noise has no likelihood.
    int
    """
    p, q, carried, columns, lengths, numbers, k = left
    longest, total = lengths.max(), int(np.sum(lengths * numbers))
    partial = np.tanh(values[: p + q])
    own = (polynomial(partial[:p]), polynomial(partial[p:]))
    factor_of_carried = np.exp(values[p + q]) if values.size > p + q else 1.0
    came_in = (carried[0], factor_of_carried * carried[1])
    ar, rows = covariance((own, came_in), longest, np.zeros(0))
    triangle = factor(rows, longest)
    found = np.full(total, np.inf)
    if len(triangle) == 0:
        return found, total
    diagonal = 2 * np.log(triangle[:, 0])
    log_determinant, freedom, start, done = 0.0, 0, 0, 0
    information = np.zeros((k, k))
    for n, m in zip(lengths, numbers):  # noqa: B905 (compiled code knows no `strict`)
        size = n * m * (1 + k)
        block = columns[start : start + size].reshape(n, m * (1 + k))
        white, length = whitened_without_level(ar, triangle, block)
        for t in range(n):
            for i in range(m):
                found[done + t * m + i] = white[t, i]
                for a in range(k):
                    for b in range(a + 1):
                        at = m + i * k
                        information[a, b] += white[t, at + a] * white[t, at + b]
            log_determinant += m * diagonal[min(t, diagonal.size - 1)]
        log_determinant += 2 * m * np.log(length)
        freedom += m * (n - 1)
        start, done = start + size, done + n * m
    if k:
        log_determinant += log_determinant_of(information)
        freedom -= k
    if not np.isfinite(log_determinant):
        return np.full(total, np.inf), total
    return found * np.exp(0.5 * log_determinant / freedom), freedom


@compiled_loop
def change_of(
    values: np.ndarray, here: np.ndarray, left: Residuals, n_free: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of half the sum of squares, and the products of the residuals' derivatives.

    Parameters
    ----------
    values : array
    here : array, shape (n_samples,)
        What `scaled_residuals` gives there.
    left : Residuals
    n_free : int
        How many of the values are free, from the first.

    Returns
    -------
    array, shape (n_free,)
    array, shape (n_free, n_free)
    """
    change = np.zeros((n_free, here.size))
    for i in range(n_free):
        moved = nearby(values, i)
        there, _ = scaled_residuals(moved, left)
        if np.isfinite(there[0]):
            change[i] = (there - here) / (moved[i] - values[i])
    return change @ here, change @ change.T


@compiled_loop
def least_squares(
    start: np.ndarray, left: Residuals, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Values of the least sum of squares of `scaled_residuals`, by Levenberg and Marquardt.

    Parameters
    ----------
    start : array
    left : Residuals
    lower, upper : array, shape (n_free,)
        Bounds of the first values; the rest are held.

    Returns
    -------
    array
    bool
        Whether it ended by itself.
    """
    n_free = lower.size
    values = clipped(start, lower, upper)
    here, _ = scaled_residuals(values, left)
    squares, radius = np.sum(here**2), RADIUS
    if not np.isfinite(squares):
        return values, False
    gradient, products = change_of(values, here, left, n_free)
    for _ in range(TRIALS):
        moved, promised, length = stepped(values, gradient, products, lower, upper, radius)
        if promised <= _LEAST_GAIN * squares:
            return values, True
        there, _ = scaled_residuals(moved, left)
        gained = squares - np.sum(there**2)
        radius = next_radius(radius, gained, promised, length)
        if gained > 0:
            values, here, squares = moved, there, squares - gained
            gradient, products = change_of(values, here, left, n_free)
    return values, False
