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
    whitened_without_level,
)
from identifiability.inference.likelihood.profiled import polynomial, within
from identifiability.loops import compiled_loop

_STEP = 1e-5  # of differences
_TRIALS = 60
_RADIUS = 0.5  # of the first step
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
        for a in range(k):
            for b in range(a):
                information[b, a] = information[a, b]
        rest += np.linalg.slogdet(information)[1]
    if not np.isfinite(rest):
        return np.full(total, np.inf), diagonal, rest
    return found, diagonal, rest


@compiled_loop
def deviance(values: np.ndarray, left: Left) -> float:
    """Minus twice the restricted log likelihood; infinite where there is none."""
    white, diagonal, rest = whitened_beside(values, left)
    return np.sum(white**2) + 2 * np.sum(diagonal) + rest


@compiled_loop
def most_likely(
    start: np.ndarray, left: Left, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Values of the least deviance, by scoring within a radius.

    The curvature that is expected of it is known from first derivatives: those of the whitened
    residuals, and of the logarithms of the diagonal.

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
    values = start.copy()
    values[:n_free] = np.minimum(np.maximum(start[:n_free], lower), upper)
    white, diagonal, rest = whitened_beside(values, left)
    least = np.sum(white**2) + 2 * np.sum(diagonal) + rest
    if not np.isfinite(least):
        return values, False
    radius, moves = _RADIUS, True
    gradient, products = np.zeros(n_free), np.zeros((n_free, n_free))
    for _ in range(_TRIALS):
        if moves:
            changes = np.zeros((n_free, 2 * white.size))
            for i in range(n_free):
                moved = values.copy()
                moved[i] += _STEP if values[i] < 0 else -_STEP  # towards 0, away from bounds
                there, its_diagonal, its_rest = whitened_beside(moved, left)
                step = moved[i] - values[i]
                gradient[i] = 0.0
                if np.isfinite(there[0]):
                    changes[i, : white.size] = (there - white) / step
                    changes[i, white.size :] = (its_diagonal - diagonal) / step
                    gradient[i] = 0.5 * (its_rest - rest) / step
                gradient[i] += changes[i, : white.size] @ white
                gradient[i] += np.sum(changes[i, white.size :])
            products = changes @ changes.T
        outside = np.where(gradient > 0, values[:n_free] <= lower, values[:n_free] >= upper)
        step_taken = within(gradient, products, outside, radius)
        moved = values.copy()
        moved[:n_free] = np.minimum(np.maximum(values[:n_free] + step_taken, lower), upper)
        taken = moved[:n_free] - values[:n_free]
        promised = -2 * (gradient @ taken) - taken @ products @ taken
        if promised <= _LEAST_GAIN:
            return values, True
        there, its_diagonal, its_rest = whitened_beside(moved, left)
        gained = least - (np.sum(there**2) + 2 * np.sum(its_diagonal) + its_rest)
        length = np.sqrt(np.sum(step_taken**2))
        if not gained > 0.25 * promised:
            radius = 0.25 * length
        elif gained > 0.75 * promised and length > 0.95 * radius:
            radius *= 2.0
        moves = gained > 0
        if moves:
            values, white, diagonal, rest = moved, there, its_diagonal, its_rest
            least -= gained
    return values, False
