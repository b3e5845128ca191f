"""Likelihood of a noise beside another whose size is known, and where it is highest.

What is not known of a motion between its samples has a size of its own in every sample: the level
of the noise beside it cannot be profiled out, and is one parameter more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from identifiability.inference.likelihood.banded import (
    Filters,
    covariance,
    factor,
    log_determinant_of,
    sum_of_logarithms,
    whitened_without_level,
)
from identifiability.inference.likelihood.of_four import (
    factors,
    first_rows,
    later_rows,
    whitened_by_four,
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
def parts_of(values: np.ndarray, left: Left) -> tuple[Filters, float]:
    """The noise at its level that values stand for, and that level."""
    p, q, carried = left.p, left.q, left.carried
    partial, level = np.tanh(values[: p + q]), np.exp(values[p + q])
    own = (polynomial(partial[:p]), polynomial(partial[p:]))
    factor_of_carried = np.exp(values[p + q + 1]) if values.size > p + q + 1 else 1.0
    return (own, (carried[0], factor_of_carried / level * carried[1])), level


@compiled_loop
def whitened_beside(values: np.ndarray, left: Left) -> tuple[np.ndarray, np.ndarray, float]:
    """Whitened residuals, the factor's diagonal, and the logarithm of all determinants.

    Minus twice the restricted log likelihood is the sum of squares of the first, and the third.

    Returns
    -------
    array, shape (n_samples,)
        Infinite where the noise has no likelihood.
    array, shape (n_samples,)
    float
    """
    columns, lengths, variances, k = left.columns, left.lengths, left.variances, left.k
    total = variances.size
    found, diagonal = np.full(total, np.inf), np.zeros(total)
    parts, level = parts_of(values, left)
    information, rest, done = np.zeros((k, k)), 0.0, 0
    for n in lengths:
        known = variances[done : done + n]
        # Where there is none its factor repeats itself.
        known = known[:0] if known.max() == 0 else known / level**2
        ar, rows = covariance(parts, n, known)
        triangle = factor(rows, n)
        if len(triangle) == 0:
            return np.full(total, np.inf), diagonal, rest
        block = columns[done * (1 + k) : (done + n) * (1 + k)].reshape(n, 1 + k)
        white, length = whitened_without_level(ar, triangle, block)
        for t in range(n):
            found[done + t] = white[t, 0] / level
            diagonal[done + t] = triangle[min(t, len(triangle) - 1), 0] * level
            for a in range(k):
                for b in range(a + 1):
                    information[a, b] += white[t, 1 + a] * white[t, 1 + b] / level**2
        rest += 2 * np.log(length / level)
        done += n
    rest += 2 * sum_of_logarithms(diagonal)
    if k:
        rest += log_determinant_of(information)
    if not np.isfinite(rest):
        return np.full(total, np.inf), diagonal, rest
    return found, diagonal, rest


@compiled_loop
def whitened_beside_of_four(
    points: np.ndarray, left: Left
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `whitened_beside` gives at four points, shape (4, n_values)."""
    columns, lengths, variances, k = left.columns, left.lengths, left.variances, left.k
    white, diagonal = np.empty((4, variances.size)), np.empty((4, variances.size))
    levels, rest, done = np.empty(4), np.zeros(4), 0
    information = np.zeros((4, k, k))
    for n in lengths:
        known = variances[done : done + n]
        ar, rows, later, begin = np.empty((0, 4)), np.empty((0, 0, 4)), np.empty((0, 4)), 0
        for j in range(4):
            parts, levels[j] = parts_of(points[j], left)
            its_ar, its_first, its_later = first_rows(parts, known / levels[j] ** 2)
            if j == 0:
                ar, later = np.empty((its_ar.size, 4)), np.empty((its_later.size, 4))
                rows, begin = np.empty((n, its_later.size, 4)), len(its_first)
            ar[:, j], later[:, j] = its_ar, its_later
            rows[:begin, :, j] = its_first
        later_rows(ar, later, known, levels, begin, rows)
        triangles = factors(rows)
        if len(triangles) == 0:
            for j in range(4):
                white[j], diagonal[j], rest[j] = whitened_beside(points[j], left)
            return white, diagonal, rest
        block = columns[done * (1 + k) : (done + n) * (1 + k)].reshape(n, 1 + k)
        found, lengths_of_level = whitened_by_four(ar, triangles, block)
        for j in range(4):
            for t in range(n):
                white[j, done + t] = found[0, t, j] / levels[j]
                diagonal[j, done + t] = triangles[t, 0, j] * levels[j]
            for a in range(k):
                for b in range(a + 1):
                    shared = 0.0
                    for t in range(n):
                        shared += found[1 + a, t, j] * found[1 + b, t, j]
                    information[j, a, b] += shared / levels[j] ** 2
            rest[j] += 2 * np.log(lengths_of_level[j] / levels[j])
        done += n
    for j in range(4):
        rest[j] += 2 * sum_of_logarithms(diagonal[j])
        if k:
            rest[j] += log_determinant_of(information[j])
        if not np.isfinite(rest[j]):
            white[j] = np.inf
    return white, diagonal, rest


@compiled_loop
def deviance(values: np.ndarray, left: Left) -> float:
    """Minus twice the restricted log likelihood; infinite where there is none."""
    white, _, rest = whitened_beside(values, left)
    return np.sum(white**2) + rest


@compiled_loop
def change_beside(
    values: np.ndarray, white: np.ndarray, diagonal: np.ndarray, rest: float, left: Left, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of half the deviance by the first values, and its curvature as it is expected.

    That is known from first derivatives: those of the whitened residuals, and of the diagonal,
    each over its own.

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
    points = np.empty((4, values.size))
    for first in range(0, n, 4):
        for j in range(4):
            points[j] = nearby(values, min(first + j, n - 1))
        there, its_diagonal, its_rest = whitened_beside_of_four(points, left)
        for i in range(first, min(first + 4, n)):
            j = i - first
            step = points[j, i] - values[i]
            if np.isfinite(there[j, 0]):
                changes[i, : white.size] = (there[j] - white) / step
                changes[i, white.size :] = (its_diagonal[j] - diagonal) / (step * diagonal)
                gradient[i] = 0.5 * (its_rest[j] - rest) / step
            gradient[i] += changes[i, : white.size] @ white
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
    least, radius = np.sum(white**2) + rest, RADIUS
    if not np.isfinite(least):
        return values, False
    gradient, products = change_beside(values, white, diagonal, rest, left, n_free)
    for _ in range(TRIALS):
        moved, promised, length = stepped(values, gradient, products, lower, upper, radius)
        if promised <= _LEAST_GAIN:
            return values, True
        there, its_diagonal, its_rest = whitened_beside(moved, left)
        gained = least - (np.sum(there**2) + its_rest)
        radius = next_radius(radius, gained, promised, length)
        if gained > 0:
            values, white, diagonal, rest = moved, there, its_diagonal, its_rest
            least -= gained
            gradient, products = change_beside(values, white, diagonal, rest, left, n_free)
    return values, False
