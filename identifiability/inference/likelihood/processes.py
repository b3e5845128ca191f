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

import numpy as np
from scipy.signal import lfilter

from identifiability.inference.likelihood import banded

_NOTHING = np.zeros(0)


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

        Raises
        ------
        numpy.linalg.LinAlgError
            Where the variance is not bounded.
        """
        return self.sd**2 * banded.autocovariance(self.ar, self.ma, lags)

    def impulse_response(self, n: int) -> np.ndarray:
        """Response to a unit of e, without `sd`, shape (n,)."""
        return banded.impulse_response(self.ar, self.ma, n)

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

        Raises
        ------
        numpy.linalg.LinAlgError
            Where the noise has no variance at some frequency, or no bounded one.
        """
        parts = tuple((part.ar, part.sd * part.ma) for part in self.parts)
        ar, rows = banded.covariance(parts, n, _NOTHING if beside is None else beside)
        factor = banded.factor(rows, n)
        if not len(factor):
            raise np.linalg.LinAlgError("a covariance that is not positive definite")
        return Whitening(ar, factor)


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of a noise: an autoregression, then a triangular banded solution.

    Attributes
    ----------
    ar : array, shape (p + 1,)
        Filters all samples but the first p.
    factor : array, shape (m, w + 1)
        Rows of the lower Cholesky factor of the covariance of what then is left: the sample's own,
        then backwards; those beyond are the last.
    """

    ar: np.ndarray
    factor: np.ndarray

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Whiten the columns of `values`, shape (n, k), of n samples that follow each other."""
        return banded.whitened(self.ar, self.factor, np.ascontiguousarray(values, float))

    def without_level(self, values: np.ndarray) -> tuple[np.ndarray, float]:
        """The same without an unknown level of each, and the length of a whitened level of 1."""
        columns = np.ascontiguousarray(values, float)
        found: tuple[np.ndarray, float]
        found = banded.whitened_without_level(self.ar, self.factor, columns)
        return found

    def rows(self, n: int) -> np.ndarray:
        """The factor's rows of `n` samples, shape (n, w + 1)."""
        return self.factor[np.minimum(np.arange(n), len(self.factor) - 1)]

    def log_determinant(self, n: int) -> float:
        """Logarithm of the determinant of the covariance of `n` samples."""
        own = np.log(self.factor[:n, 0])
        return float(2 * (np.sum(own) + max(0, n - own.size) * own[-1]))
