"""Likelihood of a noise beside another whose size is known, and where it is highest.

What is not known of a motion between its samples has a size of its own in every sample: the level
of the noise beside it cannot be profiled out, and is one parameter more.
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
from identifiability.inference.likelihood.profiled import polynomial
from identifiability.inference.likelihood.trust_region import (
    RADIUS,
    TRIALS,
    clipped,
    nearby,
    next_radius,
    stepped,
)
from identifiability.loops import compiled_loop

_LEAST_GAIN = 2e-3  # of minus twice the log likelihood, that a step must promise


class Left(NamedTuple):
    """What a noise is sought in, and of which order; its parameters are `values`.

    Those are inverse hyperbolic tangents of the p and q partial autocorrelations of the
    instrument's own noise, the logarithm of its level, and that of a factor of what came in through
    the joint, where it is sought.

    Attributes
    ----------
    p, q : int
    carried : tuple of array
        Autoregression and moving average of what came in; the latter of zeros where nothing did.
    columns : array
        Of the stretches, one after the other, residual and `k` derivatives; by rows.
    lengths : array of int
    variances : array
        Of the noise beside, sample by sample.
    k : int
        Directions that a fit took out of the residuals; none for the likelihood that is not
        restricted.
    """

    p: int
    q: int
    carried: tuple[np.ndarray, np.ndarray]
    columns: np.ndarray
    lengths: np.ndarray
    variances: np.ndarray
    k: int


@compiled_loop
def whitened_beside(values: np.ndarray, left: Left) -> tuple[np.ndarray, np.ndarray, float]:
    """Whitened residuals, logarithms of the factor's diagonal, and what determinants are left.

    Minus twice the restricted log likelihood is the sum of squares of the first, twice the sum of
    the second, and the third.

    Returns
    -------
    array, shape (n_samples,)
        Infinite where the noise has no likelihood.
    array, shape (n_samples,)
    float
    """
    p, q, carried, columns, lengths, variances, k = left
    total = variances.size
    found, diagonal = np.full(total, np.inf), np.zeros(total)
    partial, level = np.tanh(values[: p + q]), np.exp(values[p + q])
    own = (polynomial(partial[:p]), polynomial(partial[p:]))
    factor_of_carried = np.exp(values[p + q + 1]) if values.size > p + q + 1 else 1.0
    came_in = (carried[0], factor_of_carried / level * carried[1])
    information, rest, done = np.zeros((k, k)), 0.0, 0
    for n in lengths:
        known = variances[done : done + n]
        # Where there is none its factor repeats itself.
        known = known[:0] if known.max() == 0 else known / level**2
        ar, rows = covariance((own, came_in), n, known)
        triangle = factor(rows, n)
        if len(triangle) == 0:
            return np.full(total, np.inf), diagonal, rest
        block = columns[done * (1 + k) : (done + n) * (1 + k)].reshape(n, 1 + k)
        white, length = whitened_without_level(ar, triangle, block)
        for t in range(n):
            found[done + t] = white[t, 0] / level
            diagonal[done + t] = np.log(triangle[min(t, len(triangle) - 1), 0] * level)
            for a in range(k):
                for b in range(a + 1):
                    information[a, b] += white[t, 1 + a] * white[t, 1 + b] / level**2
        rest += 2 * np.log(length / level)
        done += n
    if k:
        rest += log_determinant_of(information)
    if not np.isfinite(rest):
        return np.full(total, np.inf), diagonal, rest
    return found, diagonal, rest


@compiled_loop
def deviance(values: np.ndarray, left: Left) -> float:
    """Minus twice the restricted log likelihood; infinite where there is none."""
    white, diagonal, rest = whitened_beside(values, left)
    return np.sum(white**2) + 2 * np.sum(diagonal) + rest


@compiled_loop
def change_beside(
    values: np.ndarray, white: np.ndarray, diagonal: np.ndarray, rest: float, left: Left, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of half the deviance by the first values, and its curvature as it is expected.

    That is known from first derivatives: those of the whitened residuals, and of the logarithms of
    the diagonal.

    Parameters
    ----------
    values : array
    white, diagonal, rest
        What `whitened_beside` gives there.
    left : Left
    n : int
        How many of the values are free, from the first.

    Returns
    -------
    array, shape (n,)
    array, shape (n, n)
    """
    gradient, changes = np.zeros(n), np.zeros((n, 2 * white.size))
    for i in range(n):
        moved = nearby(values, i)
        there, its_diagonal, its_rest = whitened_beside(moved, left)
        step = moved[i] - values[i]
        if np.isfinite(there[0]):
            changes[i, : white.size] = (there - white) / step
            changes[i, white.size :] = (its_diagonal - diagonal) / step
            gradient[i] = 0.5 * (its_rest - rest) / step
        gradient[i] += changes[i, : white.size] @ white
        gradient[i] += np.sum(changes[i, white.size :])
    return gradient, changes @ changes.T


@compiled_loop
def most_likely(
    start: np.ndarray, left: Left, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Values of the least deviance, by scoring within a radius.

    Parameters
    ----------
    start : array
    left : Left
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
    white, diagonal, rest = whitened_beside(values, left)
    least, radius = np.sum(white**2) + 2 * np.sum(diagonal) + rest, RADIUS
    if not np.isfinite(least):
        return values, False
    gradient, products = change_beside(values, white, diagonal, rest, left, n_free)
    for _ in range(TRIALS):
        moved, promised, length = stepped(values, gradient, products, lower, upper, radius)
        if promised <= _LEAST_GAIN:
            return values, True
        there, its_diagonal, its_rest = whitened_beside(moved, left)
        gained = least - (np.sum(there**2) + 2 * np.sum(its_diagonal) + its_rest)
        radius = next_radius(radius, gained, promised, length)
        if gained > 0:
            values, white, diagonal, rest = moved, there, its_diagonal, its_rest
            least -= gained
            gradient, products = change_beside(values, white, diagonal, rest, left, n_free)
    return values, False
