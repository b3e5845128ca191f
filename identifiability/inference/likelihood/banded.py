"""Banded covariance of a filtered sum of processes, its factor, and what that whitens.

A process is (ar, ma), ``ar(z) x = ma(z) e`` with e of variance 1. Rows of a covariance or of its
triangular factor belong to samples and begin with the sample's own column, then go back in time.
"""

from __future__ import annotations

import numpy as np

from identifiability.loops import compiled_loop

Filters = tuple[tuple[np.ndarray, np.ndarray], ...]

# Shares of the variance. Without so much white noise a covariance that has all but none at some
# frequency is indefinite by rounding.
ROUNDING = (1e-13, 1e-11, 1e-9)
_TOGETHER = 8  # deviations whose product is a number, however large or small they are
_REPEATS = 1e-14  # change of a row, over its first, from which on the factor repeats itself


@compiled_loop
def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Product of two polynomials."""
    found = np.zeros(one.size + other.size - 1)
    for i in range(one.size):
        for j in range(other.size):
            found[i + j] += one[i] * other[j]
    return found


@compiled_loop
def impulse_response(ar: np.ndarray, ma: np.ndarray, n: int) -> np.ndarray:
    """Response of a process to a unit of e, shape (n,)."""
    found = np.zeros(n)
    for i in range(n):
        if i < ma.size:
            found[i] = ma[i]
        for lag in range(1, min(i, ar.size - 1) + 1):
            found[i] -= ar[lag] * found[i - lag]
    return found


@compiled_loop
def shared_shocks(moving: np.ndarray, response: np.ndarray, lag: int) -> float:
    """Covariance of a moving average with what responded to the same shocks `lag` samples ago."""
    total = 0.0
    for i in range(min(response.size, moving.size - lag)):
        total += moving[lag + i] * response[i]
    return total


@compiled_loop
def autocovariance(ar: np.ndarray, ma: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance of a process at lags 0 to `lags`, shape (lags + 1,).

    From the Yule-Walker equations (Brockwell & Davis 1991, Time Series: Theory and Methods,
    section 3.3).
    """
    p = ar.size - 1
    response = impulse_response(ar, ma, ma.size)
    found = np.zeros(max(p, lags) + 1)
    for lag in range(min(ma.size, found.size)):
        found[lag] = shared_shocks(ma, response, lag)
    equations = np.zeros((p + 1, p + 1))
    for lag in range(p + 1):
        for i in range(p + 1):
            equations[lag, abs(lag - i)] += ar[i]
    found[: p + 1] = np.linalg.solve(equations, found[: p + 1])
    for lag in range(p + 1, found.size):
        for i in range(1, p + 1):
            found[lag] -= ar[i] * found[lag - i]
    return found[: lags + 1]


@compiled_loop
def covariance(parts: Filters, n: int, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of a sum of processes, filtered by the product of all autoregressions.

    The first samples, as many as the filter is long, are not filtered.

    Parameters
    ----------
    parts : tuple of (array, array)
    n : int
        Number of samples.
    beside : array, shape (n,) or (0,)
        Variances of noise that is independent from sample to sample, and is there as well.

    Returns
    -------
    array, shape (p + 1,)
        The filter.
    array, shape (m, w + 1)
        Rows of the covariance; those beyond are the last.
    """
    ar = np.ones(1)
    for own, _ in parts:
        ar = product(ar, own)
    head, width = ar.size - 1, ar.size - 1
    for own, ma in parts:
        width = max(width, head - (own.size - 1) + ma.size - 1)
    rows = np.zeros((n if beside.size else min(n, head + width + 1), width + 1))
    for k in range(len(parts)):
        own, ma = parts[k]
        moving = ma
        for other in range(len(parts)):
            if other != k:
                moving = product(moving, parts[other][0])
        response = impulse_response(own, ma, moving.size)
        first = autocovariance(own, ma, head)
        across, later = np.zeros(width + 1), np.zeros(width + 1)
        for lag in range(width + 1):
            across[lag] = shared_shocks(moving, response, lag)
            later[lag] = shared_shocks(moving, moving, lag)
        for t in range(len(rows)):
            for lag in range(min(t, width) + 1):
                if t < head:
                    rows[t, lag] += first[lag]
                elif t - lag < head:
                    rows[t, lag] += across[lag]
                else:
                    rows[t, lag] += later[lag]
    if beside.size:
        add_beside(rows, ar, beside)
    return ar, rows


@compiled_loop
def add_beside(rows: np.ndarray, ar: np.ndarray, variances: np.ndarray) -> None:
    """Add noise that is independent from sample to sample to rows of a filtered covariance."""
    for t in range(len(rows)):
        for lag in range(min(t, ar.size - 1) + 1):
            _add_filtered(rows, ar, variances, t, lag)


@compiled_loop
def _add_filtered(
    rows: np.ndarray, ar: np.ndarray, variances: np.ndarray, t: int, lag: int
) -> None:
    """Add the covariance of independent noise at a sample and one before it, both filtered."""
    head = ar.size - 1
    for i in range(head - lag + 1):  # of the shock's own sample behind the earlier one
        shock = t - lag - i
        if shock < 0 or (i and t - lag < head) or (i + lag and t < head):
            continue
        rows[t, lag] += ar[i] * ar[i + lag] * variances[shock]


@compiled_loop
def _factor(rows: np.ndarray, n: int, share: float) -> np.ndarray:
    """Rows of a triangular factor, as far as they differ; none of an indefinite covariance."""
    width = rows.shape[1] - 1
    found, inverse = np.zeros((n, width + 1)), np.zeros(n)
    repeated = 0
    for t in range(n):
        row, most = min(t, len(rows) - 1), min(t, width)
        # Far lags first, here and below: only the last term has to wait for the sample before.
        for lag in range(most, 0, -1):
            value = rows[row, lag]
            for back in range(most, lag, -1):
                value -= found[t, back] * found[t - lag, back - lag]
            found[t, lag] = value * inverse[t - lag]
        value = rows[row, 0] * (1 + share)
        for back in range(most, 0, -1):
            value -= found[t, back] ** 2
        if not value > 0:
            return found[:0]
        found[t, 0] = np.sqrt(value)
        inverse[t] = 1 / found[t, 0]
        if t < len(rows):
            continue
        change = 0.0
        for lag in range(width + 1):
            change = max(change, abs(found[t, lag] - found[t - 1, lag]))
        repeated = repeated + 1 if change <= _REPEATS * found[t, 0] else 0
        if repeated > width:
            return found[: t + 1]
    return found


@compiled_loop
def factor(rows: np.ndarray, n: int) -> np.ndarray:
    """Triangular factor of a covariance, with as little white noise added as it takes.

    Parameters
    ----------
    rows : array, shape (m, w + 1)
        See `covariance`.
    n : int
        Number of samples.

    Returns
    -------
    array, shape (m, w + 1)
        Its rows; those beyond are the last. None where no factor was found.
    """
    for share in ROUNDING:
        found = _factor(rows, n, share)
        if len(found):
            return found
    return np.zeros((0, rows.shape[1]))


@compiled_loop
def whitened(ar: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns of samples that follow each other, filtered and solved by a factor.

    Parameters
    ----------
    ar : array, shape (p + 1,)
    rows : array, shape (m, w + 1)
        See `factor`.
    values : array, shape (n, k)
    """
    n, k = values.shape
    head, width, last = ar.size - 1, rows.shape[1] - 1, len(rows) - 1
    inverse = 1 / rows[:, 0]
    found = np.empty((n, k))
    # Four columns at a time are one operation of the processor. Rows of zeros come before them.
    given, solved = np.zeros((n, 4)), np.zeros((width + n, 4))
    for first in range(0, k, 4):
        those = min(4, k - first)
        for t in range(n):
            for j in range(those):
                given[t, j] = values[t, first + j]
        for t in range(n):
            row = min(t, last)
            a, b, c, d = given[t, 0], given[t, 1], given[t, 2], given[t, 3]
            if t >= head:
                for lag in range(1, head + 1):
                    at, by = t - lag, ar[lag]
                    a += by * given[at, 0]
                    b += by * given[at, 1]
                    c += by * given[at, 2]
                    d += by * given[at, 3]
            for lag in range(width, 0, -1):
                at, by = width + t - lag, rows[row, lag]
                a -= by * solved[at, 0]
                b -= by * solved[at, 1]
                c -= by * solved[at, 2]
                d -= by * solved[at, 3]
            at, by = width + t, inverse[row]
            solved[at, 0], solved[at, 1] = a * by, b * by
            solved[at, 2], solved[at, 3] = c * by, d * by
        for t in range(n):
            for j in range(those):
                found[t, first + j] = solved[width + t, j]
    return found


@compiled_loop
def whitened_without_level(
    ar: np.ndarray, rows: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, float]:
    """Whitened columns without an unknown level each, and the length of a whitened one."""
    n, k = values.shape
    with_level = np.ones((n, k + 1))
    with_level[:, :k] = values
    white = whitened(ar, rows, with_level)
    square, shares = 0.0, np.zeros(k)
    for t in range(n):
        square += white[t, k] ** 2
        for j in range(k):
            shares[j] += white[t, k] * white[t, j]
    shares /= square
    found = np.empty((n, k))
    for t in range(n):
        for j in range(k):
            found[t, j] = white[t, j] - shares[j] * white[t, k]
    return found, np.sqrt(square)


@compiled_loop
def sum_of_logarithms(values: np.ndarray) -> float:
    """Sum of logarithms of positive values, of some together: one takes long."""
    total, product_of_some = 0.0, 1.0
    for i in range(values.size):
        product_of_some *= values[i]
        if i % _TOGETHER == _TOGETHER - 1:
            total += np.log(product_of_some)
            product_of_some = 1.0
    return total + np.log(product_of_some)


@compiled_loop
def log_determinant_of(lower: np.ndarray) -> float:
    """Of a symmetric matrix, of which the lower triangle is given; the upper one is filled in."""
    for a in range(len(lower)):
        for b in range(a):
            lower[b, a] = lower[a, b]
    return np.linalg.slogdet(lower)[1]
