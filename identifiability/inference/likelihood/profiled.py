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
    whitened_without_level,
)
from identifiability.loops import compiled_loop

_DEPENDENT = 1e-13  # share of all products, that lets dependent directions have a root


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
        for a in range(k):
            for b in range(a):
                information[b, a] = information[a, b]
        log_determinant += np.linalg.slogdet(information)[1]
        freedom -= k
    if not np.isfinite(log_determinant):
        return np.full(total, np.inf), total
    return found * np.exp(0.5 * log_determinant / freedom), freedom


@compiled_loop
def slopes(values: np.ndarray, left: Residuals, n_free: int, step: float) -> np.ndarray:
    """Derivatives of `scaled_residuals` by the first values, as an optimiser needs them.

    That is their lengths and angles: the residuals lie along the first of `n_free` + 1 axes.

    Parameters
    ----------
    values : array
    left : Residuals
    n_free : int
        How many of the values.
    step : float
        Of differences, towards 0.

    Returns
    -------
    array, shape (n_free + 1, n_free)
        Of zeros where the noise has no likelihood.
    """
    here, _ = scaled_residuals(values, left)
    if not np.isfinite(here[0]):
        return np.zeros((n_free + 1, n_free))
    change = np.zeros((n_free, here.size))
    for i in range(n_free):
        moved = values.copy()
        moved[i] += step if values[i] < 0 else -step
        there, _ = scaled_residuals(moved, left)
        if np.isfinite(there[0]):
            change[i] = (there - here) / (moved[i] - values[i])
    direction = here / np.sqrt(np.sum(here**2))
    found = np.empty((n_free + 1, n_free))
    found[0] = change @ direction
    for i in range(n_free):
        change[i] -= found[0, i] * direction
    products = change @ change.T
    products += np.eye(n_free) * (_DEPENDENT * np.trace(products) + 1e-300)
    found[1:] = np.linalg.cholesky(products).T
    return found
