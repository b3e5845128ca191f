"""Stationary Gaussian noise with a rational spectrum, and its exact covariance.

Noise in what is compared has two sources. One is the instrument's own and may have any colour: an
autoregressive moving average (ARMA). The other came in through the joint: noise of the other
channel, which the joint's impedance or admittance carries over. Their sum, filtered by the product
of both autoregressions, is a moving average, whose covariance is banded: its Cholesky factor takes
a time proportional to the number of samples (Ansley 1979, Biometrika 66:59-65).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import scipy.linalg
from scipy.signal import lfilter

# Shares of the variance. Without so much white noise a covariance that has all but none at some
# frequency is indefinite by rounding.
_ROUNDING = (1e-13, 1e-11, 1e-9)
_CONVERGED = 1500  # rows after which the factor of a stationary process repeats itself


@dataclass(frozen=True, eq=False)
class Process:
    """White noise through a rational filter: ``ar(z) x = sd ma(z) e``.

    Attributes
    ----------
    ar : array, shape (p + 1,)
        Autoregression, of which the first is 1; its zeros lie within the unit circle.
    ma : array, shape (q + 1,)
        Moving average.
    sd : float
        Standard deviation of e, in the unit of x where the first of `ma` is 1.
    """

    ar: np.ndarray
    ma: np.ndarray
    sd: float = 1.0

    def autocovariance(self, lags: int) -> np.ndarray:
        """Autocovariance at lags 0 to `lags`, shape (lags + 1,).

        From the Yule-Walker equations (Brockwell & Davis 1991, Time Series: Theory and Methods,
        section 3.3).
        """
        return self.sd**2 * _autocovariance(tuple(self.ar.tolist()), tuple(self.ma.tolist()), lags)

    def impulse_response(self, n: int) -> np.ndarray:
        """Response to a unit of e, without `sd`, shape (n,)."""
        return np.array(_impulse(self.ar.tolist(), self.ma.tolist(), n))

    def draw(self, n: int, generator: np.random.Generator) -> np.ndarray:
        """Draw noise from the process, shape (n,), after a run that forgets its beginning."""
        before = 20 * (self.ar.size + self.ma.size) + 4 * n
        shocks = self.sd * generator.standard_normal(before + n)
        drawn: np.ndarray = lfilter(self.ma, self.ar, shocks)[before:]
        return drawn


@dataclass(frozen=True, eq=False)
class ProcessSum:
    """Sum of independent processes: what whitens a residual.

    Attributes
    ----------
    parts : sequence of Process
    """

    parts: Sequence[Process]

    def whitening(self, n: int, beside: np.ndarray | None = None) -> Whitening:
        """What turns up to `n` samples of the noise into independent ones of variance 1.

        Parameters
        ----------
        n : int
        beside : array, shape (n,), optional
            Variances of noise that is independent from sample to sample, and is there as well.
        """
        ar = self.parts[0].ar
        for part in self.parts[1:]:
            ar = np.convolve(ar, part.ar)
        moving = []
        for i, part in enumerate(self.parts):
            ma = part.ma
            for other in (*self.parts[:i], *self.parts[i + 1 :]):
                ma = np.convolve(ma, other.ar)
            moving.append(part.sd * ma)
        head = ar.size - 1
        width = max(head, *(ma.size - 1 for ma in moving))
        rows = n if beside is not None else min(n, _CONVERGED + width)
        band = np.zeros((width + 1, rows))
        for part, ma in zip(self.parts, moving, strict=True):
            lagged = np.correlate(ma, ma, "full")[ma.size - 1 :]
            band[: ma.size, head:] += lagged[:, None]
            if head:
                band[:, :head] += _beginning(part, ma, head, width)[:, : min(head, rows)]
        if beside is not None:
            _add_filtered(band, ar, beside)
        factor = _factor(band)
        if n > rows:
            # Where the band ends, columns lack what would follow: the last whole one repeats.
            last = factor[:, rows - width - 1]
            factor = np.concatenate(
                [factor[:, : rows - width], np.repeat(last[:, None], n - rows + width, axis=1)],
                axis=1,
            )
        return Whitening(ar, factor)


def _impulse(ar: Sequence[float], ma: Sequence[float], n: int) -> list[float]:
    """Impulse response by its recursion: for a few terms it is quicker than a filter."""
    found: list[float] = []
    for i in range(n):
        value = ma[i] if i < len(ma) else 0.0
        for lag in range(1, min(i, len(ar) - 1) + 1):
            value -= ar[lag] * found[i - lag]
        found.append(value)
    return found


# While a noise is sought, that of the other channel keeps its colour.
@lru_cache(maxsize=64)
def _autocovariance(ar: tuple[float, ...], ma: tuple[float, ...], lags: int) -> np.ndarray:
    """Autocovariance of a process driven by noise of variance 1: see `Process.autocovariance`."""
    p, q = len(ar) - 1, len(ma) - 1
    impulse, moving = np.array(_impulse(ar, ma, q + 1)), np.array(ma)
    shared = np.zeros(max(p, lags) + 1)
    for lag in range(min(q, shared.size - 1) + 1):
        shared[lag] = moving[lag:] @ impulse[: q + 1 - lag]
    before, after = _yule_walker(p)
    padded = np.array([*ar, 0.0])
    _, _, first, failed = scipy.linalg.lapack.dgesv(padded[before] + padded[after], shared[: p + 1])
    if failed:
        raise np.linalg.LinAlgError("a noise whose variance is not bounded")
    found = np.zeros(shared.size)
    found[: p + 1] = first
    back = padded[p:0:-1]
    for lag in range(p + 1, shared.size):
        found[lag] = shared[lag] - back @ found[lag - p : lag]
    found.flags.writeable = False
    return found[: lags + 1]


@cache
def _yule_walker(p: int) -> tuple[np.ndarray, np.ndarray]:
    """Which coefficients of an AR(p) multiply each autocovariance, as a lag before and after 0.

    Shape (p + 1, p + 1) each; p + 1 where there is none.
    """
    equation, lag = np.indices((p + 1, p + 1))
    before = np.where(equation >= lag, equation - lag, p + 1)
    after = np.where((lag > 0) & (equation + lag <= p), equation + lag, p + 1)
    return before, after


def _add_filtered(band: np.ndarray, ar: np.ndarray, variances: np.ndarray) -> None:
    """Add the covariance of independent noise behind an autoregression to a band."""
    n, head = variances.size, ar.size - 1
    for lag in range(min(head, n - 1) + 1):
        # Of samples `lag` apart, by the shocks that both have; the first samples are not filtered.
        for i in range(head - lag + 1):
            later = np.arange(i + lag, n)
            both = (later - lag >= head) | (i == 0)
            both &= (later >= head) | (i + lag == 0)
            shared = ar[i] * ar[i + lag] * variances[later - i - lag]
            band[lag, later - lag] += np.where(both, shared, 0.0)


def _factor(band: np.ndarray) -> np.ndarray:
    """Cholesky factor of a banded covariance, with as little white noise added as it takes."""
    for share in _ROUNDING[:-1]:
        try:
            return _cholesky(band, share)
        except np.linalg.LinAlgError:
            continue
    return _cholesky(band, _ROUNDING[-1])


def _cholesky(band: np.ndarray, share: float) -> np.ndarray:
    raised = np.array(band, order="F")
    raised[0] *= 1 + share
    factor, failed = scipy.linalg.lapack.dpbtrf(raised, lower=True, overwrite_ab=True)
    if failed:
        raise np.linalg.LinAlgError("a covariance that is not positive definite")
    return np.asarray(factor)


def _beginning(part: Process, ma: np.ndarray, head: int, width: int) -> np.ndarray:
    """Covariance of the first samples, which are not filtered, with those that follow."""
    columns = np.zeros((width + 1, head))
    own = part.autocovariance(head)
    impulse = part.sd * part.impulse_response(ma.size)
    later = np.zeros(width + 1)
    for lag in range(min(width, ma.size - 1) + 1):
        later[lag] = ma[lag:] @ impulse[: ma.size - lag]
    for first in range(head):
        columns[: head - first, first] = own[: head - first]
        columns[head - first :, first] = later[head - first :]
    return columns


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of a noise: an autoregression, then a triangular banded solution.

    Attributes
    ----------
    ar : array, shape (p + 1,)
        Filters all samples but the first p.
    factor : array, shape (w + 1, n)
        Lower Cholesky factor of the covariance of what then is left, by diagonals.
    """

    ar: np.ndarray
    factor: np.ndarray

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Whiten the columns of `values`, shape (m, k), of m samples that follow each other."""
        m, head = len(values), self.ar.size - 1
        filtered = np.array(values, order="F")  # by columns, as LAPACK has them
        for lag in range(1, head + 1):
            filtered[head:] += self.ar[lag] * values[head - lag : m - lag]
        white, failed = scipy.linalg.lapack.dtbtrs(
            self.factor[:, :m], filtered, uplo="L", overwrite_b=True
        )
        if failed:
            raise np.linalg.LinAlgError("a noise without variance")
        found: np.ndarray = white
        return found

    def back(self, white: np.ndarray) -> np.ndarray:
        """The transpose of what whitens, applied to one whitened stretch, shape (n,)."""
        n, head = white.size, self.ar.size - 1
        solved, failed = scipy.linalg.lapack.dtbtrs(
            self.factor[:, :n], white[:, None], uplo="L", trans="T"
        )
        if failed:
            raise np.linalg.LinAlgError("a noise without variance")
        solved = solved[:, 0]
        found = solved.copy()
        for lag in range(1, head + 1):
            found[head - lag : n - lag] += self.ar[lag] * solved[head:]
        return np.asarray(found)

    def log_determinant(self, n: int) -> float:
        """Logarithm of the determinant of the covariance of `n` samples."""
        return float(2 * np.sum(np.log(self.factor[0, :n])))
