"""Measurement noise: how large, and how it is coloured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.errors import InputError

Reading = Literal["contour", "energy"]
READINGS: tuple[Reading, ...] = ("contour", "energy")


@dataclass(frozen=True)
class Noise:
    """Stationary Gaussian noise, white or first-order autoregressive.

    Attributes
    ----------
    sd : float
        Standard deviation of a sample, in the unit of the signal.
    correlation_time : float
        Time [s] over which the autocorrelation falls to 1/e; 0 for white noise.
    """

    sd: float
    correlation_time: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sd) and self.sd > 0):
            raise InputError(f"found a noise standard deviation of {self.sd}, expected one above 0")
        if not (np.isfinite(self.correlation_time) and self.correlation_time >= 0):
            raise InputError(
                f"found a correlation time of {self.correlation_time} s, expected 0 or more"
            )

    def lag_correlation(self, interval: float) -> float:
        """Correlation between samples `interval` seconds apart."""
        return float(np.exp(-interval / self.correlation_time)) if self.correlation_time else 0.0

    def draw(self, n: int, interval: float, seed: int | np.random.SeedSequence) -> np.ndarray:
        """Draw noise.

        Parameters
        ----------
        n : int
            Number of samples.
        interval : float
            Sampling interval [s].
        seed : int or SeedSequence

        Returns
        -------
        array, shape (n,)
        """
        rho = self.lag_correlation(interval)
        shocks = np.random.default_rng(seed).standard_normal(n) * self.sd
        noise = np.empty(n)
        noise[0] = shocks[0]
        for i in range(1, n):
            noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * shocks[i]
        return noise


def matched_noise(
    response: np.ndarray, reading: Reading, *, dE: float = 1e-3, correlation_time: float = 0.0
) -> Noise:
    """Noise that corresponds to an error dE of Kistemaker & Rozendaal (2011).

    Parameters
    ----------
    response : array, shape (n,)
        The noise-free response, with S the sum of its squares.
    reading : {"contour", "energy"}
        ``"contour"``: variance ``dE * S``. For white noise one posterior standard deviation along
        the least certain direction is then exactly the paper's change of parameters (Eq. 15).
        ``"energy"``: variance ``dE * S / n``, so that the noise itself has an error E of dE.
    dE : float
        The change of the error criterion E (Eq. 3).
    correlation_time : float
        Of the noise [s]; it leaves the standard deviation as it is.

    Returns
    -------
    Noise
    """
    if reading not in READINGS:
        raise InputError(f"found noise reading '{reading}', expected one of {list(READINGS)}")
    if not dE > 0:
        raise InputError(f"found dE = {dE}, expected a number above 0")
    response = np.asarray(response, float)
    energy = float(np.sum(response**2))
    variance = dE * energy / (1 if reading == "contour" else response.size)
    return Noise(float(np.sqrt(variance)), correlation_time)


def correlation_time(*pieces: np.ndarray) -> float:
    """Integrated autocorrelation time of a signal about zero [samples], at least 1.

    Summed up to the first lag beyond five times the sum so far (Sokal 1997, in Functional
    Integration: Basics and Applications, 131-192). Pieces are pooled as they are: means of their
    own would make short ones look white. Take a level off before where it is no part of the noise.

    Parameters
    ----------
    *pieces : array, shape (n,)
        The signal in one piece or several, which may differ in length.
    """
    covariance = np.zeros(max(piece.size for piece in pieces))
    for piece in pieces:
        power = np.abs(np.fft.rfft(piece, 2 * piece.size)) ** 2
        covariance[: piece.size] += np.fft.irfft(power, 2 * piece.size)[: piece.size]
    if covariance[0] == 0:
        return 1.0
    times = 2 * np.cumsum(covariance / covariance[0]) - 1
    beyond = np.flatnonzero(np.arange(times.size) >= 5 * times)
    return float(max(1.0, times[beyond[0] if beyond.size else -1]))
