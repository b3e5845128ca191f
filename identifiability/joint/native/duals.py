"""Small matrices with their derivatives: the last axis is the value, then each derivative.

Loops are written out: array expressions take the compiler ten times as long.
"""

from __future__ import annotations

import numpy as np

from identifiability.joint.native.machine import LANES
from identifiability.loops import compiled_loop

_TERMS = 14  # of Taylor's series, after scaling to a 1-norm of at most 1/2
_ROUNDING = 1e-17  # share that terms left out have of it; their derivatives have few times as much


@compiled_loop
def added(one: np.ndarray, a: float, other: np.ndarray, b: float, out: np.ndarray) -> None:
    """``a one + b other`` into `out`, which may be one of them."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for t in range(out.shape[2]):
                out[i, j, t] = a * one[i, j, t] + b * other[i, j, t]


@compiled_loop
def multiplied(one: np.ndarray, other: np.ndarray, out: np.ndarray) -> None:
    """Product of two matrices into a third."""
    width = one.shape[2]
    for i in range(one.shape[0]):
        for j in range(other.shape[1]):
            for t in range(width):
                out[i, j, t] = 0.0
        for k in range(one.shape[1]):
            a = one[i, k, 0]
            for j in range(other.shape[1]):
                b = other[k, j, 0]
                out[i, j, 0] += a * b
                for t in range(1, width):
                    out[i, j, t] += a * other[k, j, t] + one[i, k, t] * b


@compiled_loop
def list_entries(matrix: np.ndarray, slopes: np.ndarray, found: np.ndarray) -> None:
    """List entries that there are, and between which numbers each has derivatives.

    Parameters
    ----------
    matrix : array, shape (n, m)
    slopes : array, shape (n, m, width)
    found : array of int, shape (n, m, 3)
        By row, for each that is not 0, its column, the first derivative, a multiple of `LANES`, and
        behind the last; then -1.
    """
    n, m, width = slopes.shape
    for i in range(n):
        count = 0
        for j in range(m):
            found[i, j, 0] = -1
        for j in range(m):
            begin = end = 0
            for t in range(width):
                if slopes[i, j, t] != 0.0:
                    begin = begin if end else t - t % LANES
                    end = t + 1
            if end or matrix[i, j] != 0.0:
                found[i, count, 0], found[i, count, 1], found[i, count, 2] = j, begin, end
                count += 1


@compiled_loop
def _add_identity(matrix: np.ndarray, size: float) -> None:
    for i in range(matrix.shape[0]):
        matrix[i, i, 0] += size


@compiled_loop
def halvings(most: float) -> tuple[int, int]:
    """How often a matrix of a 1-norm is halved to one of at most 1/2; terms its series then needs.

    The derivatives are as large as they are: their terms fall as quickly.
    """
    count = 0
    while not most <= 0.5 and count < 60:
        most *= 0.5
        count += 1
    left, terms = 1.0, 1
    while left > _ROUNDING and terms < _TERMS:
        left *= most / terms
        terms += 1
    return count, terms


@compiled_loop
def _scaled(matrix: np.ndarray, scaled: np.ndarray) -> tuple[int, int]:
    """A matrix halved until its 1-norm is at most 1/2; see `halvings`."""
    most = 0.0
    for j in range(matrix.shape[1]):
        total = 0.0
        for i in range(matrix.shape[0]):
            total += abs(matrix[i, j, 0])
        most = max(most, total)
    count, terms = halvings(most)
    added(matrix, 2.0**-count, matrix, 0.0, scaled)
    return count, terms


@compiled_loop
def _series(
    scaled: np.ndarray, terms: int, above: int, product: np.ndarray, total: np.ndarray
) -> None:
    """Sum of so many terms ``above! z^j / (j + above)!``, into `total`."""
    added(scaled, 0.0, scaled, 0.0, total)
    _add_identity(total, 1.0)
    for k in range(terms):
        multiplied(scaled, total, product)
        added(product, 1.0 / (terms + above - k), product, 0.0, total)
        _add_identity(total, 1.0)


@compiled_loop
def _product_of_values(one: np.ndarray, other: np.ndarray, size: float, out: np.ndarray) -> None:
    n = len(one)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += one[i, k] * other[k, j]
            out[i, j] = size * total


@compiled_loop
def exponential_of_values(matrix: np.ndarray) -> np.ndarray:
    """The exponential of a matrix without derivatives, shape (n, n), which is scaled in place."""
    n, most = len(matrix), 0.0
    for j in range(n):
        total = 0.0
        for i in range(n):
            total += abs(matrix[i, j])
        most = max(most, total)
    count, terms = halvings(most)
    scale = 2.0**-count
    found, other = np.zeros((n, n)), np.empty((n, n))
    for i in range(n):
        found[i, i] = 1.0
        for j in range(n):
            matrix[i, j] *= scale
    for k in range(terms):
        _product_of_values(matrix, found, 1.0 / (terms - k), other)
        found, other = other, found
        for i in range(n):
            found[i, i] += 1.0
    for _ in range(count):
        _product_of_values(found, found, 1.0, other)
        found, other = other, found
    return found


@compiled_loop
def exponential(matrix: np.ndarray) -> np.ndarray:
    """Exponential by scaling and squaring of its Taylor series, see `exponentials`."""
    scaled, product, power = np.empty_like(matrix), np.empty_like(matrix), np.empty_like(matrix)
    if matrix.shape[2] == 1:
        # (Assigned as a whole, it would have the compiler write messages about shapes.)
        n = matrix.shape[0]
        values = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                values[i, j] = matrix[i, j, 0]
        values = exponential_of_values(values)
        for i in range(n):
            for j in range(n):
                power[i, j, 0] = values[i, j]
        return power
    count, terms = _scaled(matrix, scaled)
    _series(scaled, terms, 0, product, power)
    for _ in range(count):
        multiplied(power, power, product)
        added(product, 1.0, product, 0.0, power)
    return power


@compiled_loop
def phi_functions(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """phi_0 to phi_3 of half a matrix, and of the matrix, along the first axis.

    By Taylor series and doubling (Skaflestad & Wright 2009), see `exponentials`.
    """
    n, width = matrix.shape[0], matrix.shape[2]
    half, full = np.empty((4, n, n, width)), np.empty((4, n, n, width))
    scaled, product = np.empty_like(matrix), np.empty_like(matrix)
    added(matrix, 0.5, matrix, 0.0, product)
    count, terms = _scaled(product, scaled)
    _series(scaled, terms, 3, product, half[3])
    added(half[3], 1.0 / 6.0, half[3], 0.0, half[3])
    for k in range(2, -1, -1):
        multiplied(scaled, half[k + 1], half[k])
        _add_identity(half[k], 0.5 if k == 2 else 1.0)
    for done in range(count + 1):
        for k in range(4):
            multiplied(half[0], half[k], full[k])
        added(full[1], 0.5, half[1], 0.5, full[1])
        added(half[1], 0.25, half[2], 0.25, product)
        added(full[2], 0.25, product, 1.0, full[2])
        added(half[1], 0.0625, half[2], 0.125, product)
        added(product, 1.0, half[3], 0.125, product)
        added(full[3], 0.125, product, 1.0, full[3])
        if done < count:
            half, full = full, half
    return half, full


@compiled_loop
def solved(matrix: np.ndarray, right: np.ndarray) -> None:
    """Solve a linear system of values for several right sides, in place of both."""
    n, m = right.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        for j in range(n):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for j in range(m):
            right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(n):
            if i != k:
                factor = matrix[i, k] / matrix[k, k]
                for j in range(k, n):
                    matrix[i, j] -= factor * matrix[k, j]
                for j in range(m):
                    right[i, j] -= factor * right[k, j]
    for k in range(n):
        for j in range(m):
            right[k, j] /= matrix[k, k]
