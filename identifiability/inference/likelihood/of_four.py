"""Four noises at a time, each beside another whose size is known: see `banded` for one.

The factor of a noise waits for the sample before at every sample. Four of them wait together, and
each step is one operation of the processor.
"""

from __future__ import annotations

import numpy as np

from identifiability.inference.likelihood.banded import ROUNDING, Filters, add_beside, covariance
from identifiability.loops import compiled_loop


@compiled_loop
def first_rows(parts: Filters, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A noise's filter, the rows of its covariance that differ, and what all later ones have alike.

    Parameters
    ----------
    parts : tuple of (array, array)
    beside : array, shape (n,)
        Variances of the noise beside.

    Returns
    -------
    array, shape (p + 1,)
    array, shape (m, w + 1)
    array, shape (w + 1,)
    """
    ar, rows = covariance(parts, beside.size, beside[:0])
    later = rows[-1].copy()
    add_beside(rows, ar, beside)
    return ar, rows, later


@compiled_loop
def later_rows(
    ar: np.ndarray,
    later: np.ndarray,
    beside: np.ndarray,
    levels: np.ndarray,
    begin: int,
    rows: np.ndarray,
) -> None:
    """Fill in the rows of four covariances, from one on.

    Parameters
    ----------
    ar : array, shape (p + 1, 4)
    later : array, shape (w + 1, 4)
    beside : array, shape (n,)
        Variances of the noise beside.
    levels : array, shape (4,)
        Over whose squares they are.
    begin : int
        The first row that `first_rows` does not give.
    rows : array, shape (n, w + 1, 4)
    """
    head, width = len(ar) - 1, rows.shape[1] - 1
    shares = np.zeros((head + 1, head + 1, 4))
    for lag in range(head + 1):
        for i in range(head - lag + 1):
            for j in range(4):
                shares[lag, i, j] = ar[i, j] * ar[i + lag, j] / levels[j] ** 2
    for t in range(begin, len(rows)):
        for lag in range(width + 1):
            a, b, c, d = later[lag, 0], later[lag, 1], later[lag, 2], later[lag, 3]
            for i in range(head - lag + 1):
                by = beside[t - lag - i]
                a += shares[lag, i, 0] * by
                b += shares[lag, i, 1] * by
                c += shares[lag, i, 2] * by
                d += shares[lag, i, 3] * by
            rows[t, lag, 0], rows[t, lag, 1] = a, b
            rows[t, lag, 2], rows[t, lag, 3] = c, d


@compiled_loop
def factors(rows: np.ndarray) -> np.ndarray:
    """Triangular factors of four covariances, shape (n, w + 1, 4); none where one has none."""
    n, width, more = rows.shape[0], rows.shape[1] - 1, 1 + ROUNDING[0]
    found, inverse = np.zeros((n, width + 1, 4)), np.zeros((n, 4))
    for t in range(n):
        most = min(t, width)
        for lag in range(most, -1, -1):
            a, b, c, d = rows[t, lag, 0], rows[t, lag, 1], rows[t, lag, 2], rows[t, lag, 3]
            if lag == 0:
                a, b, c, d = a * more, b * more, c * more, d * more
            for back in range(most, lag, -1):
                at, by = t - lag, back - lag
                a -= found[t, back, 0] * found[at, by, 0]
                b -= found[t, back, 1] * found[at, by, 1]
                c -= found[t, back, 2] * found[at, by, 2]
                d -= found[t, back, 3] * found[at, by, 3]
            if lag:
                at = t - lag
                found[t, lag, 0], found[t, lag, 1] = a * inverse[at, 0], b * inverse[at, 1]
                found[t, lag, 2], found[t, lag, 3] = c * inverse[at, 2], d * inverse[at, 3]
                continue
            if not (a > 0 and b > 0 and c > 0 and d > 0):
                return found[:0]
            a, b, c, d = np.sqrt(a), np.sqrt(b), np.sqrt(c), np.sqrt(d)
            found[t, 0, 0], found[t, 0, 1], found[t, 0, 2], found[t, 0, 3] = a, b, c, d
            inverse[t, 0], inverse[t, 1], inverse[t, 2], inverse[t, 3] = 1 / a, 1 / b, 1 / c, 1 / d
    return found


@compiled_loop
def whitened_by_four(
    ar: np.ndarray, rows: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened columns without an unknown level each, and the lengths of the whitened ones.

    Parameters
    ----------
    ar : array, shape (p + 1, 4)
    rows : array, shape (n, w + 1, 4)
        See `factors`.
    values : array, shape (n, k)

    Returns
    -------
    array, shape (k, n, 4)
    array, shape (4,)
    """
    n, k = values.shape
    head, width = len(ar) - 1, rows.shape[1] - 1
    given = np.ones((k + 1, n))
    given[:k] = values.T
    # Rows of zeros come before the samples.
    solved = np.zeros((k + 1, width + n, 4))
    for j in range(k + 1):
        column, out = given[j], solved[j]
        for t in range(n):
            a = b = c = d = column[t]
            if t >= head:
                for lag in range(1, head + 1):
                    value = column[t - lag]
                    a += ar[lag, 0] * value
                    b += ar[lag, 1] * value
                    c += ar[lag, 2] * value
                    d += ar[lag, 3] * value
            for lag in range(width, 0, -1):
                at = width + t - lag
                a -= rows[t, lag, 0] * out[at, 0]
                b -= rows[t, lag, 1] * out[at, 1]
                c -= rows[t, lag, 2] * out[at, 2]
                d -= rows[t, lag, 3] * out[at, 3]
            at = width + t
            out[at, 0], out[at, 1] = a / rows[t, 0, 0], b / rows[t, 0, 1]
            out[at, 2], out[at, 3] = c / rows[t, 0, 2], d / rows[t, 0, 3]
    white, squares = solved[:, width:], np.zeros(4)
    for t in range(n):
        for i in range(4):
            squares[i] += white[k, t, i] ** 2
    for j in range(k):
        shares = np.zeros(4)
        for t in range(n):
            for i in range(4):
                shares[i] += white[k, t, i] * white[j, t, i]
        shares /= squares
        for t in range(n):
            for i in range(4):
                white[j, t, i] -= shares[i] * white[k, t, i]
    return white[:k], np.sqrt(squares)
