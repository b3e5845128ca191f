"""Noise that grows with the motion: what a model leaves only where the joint moves."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from identifiability.investigation.posterior.band import Band

_AROUND = 0.05  # s, over which a motion is lively
_SHARES_TRIED, _LEAST_VARIANCE = 41, 1e-6


def liveliness(band: Band) -> list[np.ndarray]:
    """How lively the motion is about every compared sample, by stretch; its mean is 1.

    NaN where a rounded angle stands still, which then has no noise.
    """
    by_trial = []
    for p, stands in zip(band.prepared, band.stands, strict=True):
        size = max(3, round(_AROUND / p.interval))
        signals = [p.response, p.trial.angle] if band.angle_imposed else [p.response]
        rest = slice(p.first, p.first + size)
        energy = np.zeros(p.response.size)
        for signal in signals:
            moved = uniform_filter1d(signal - signal[rest].mean(), size)
            for part in (moved, np.gradient(moved)):
                square = uniform_filter1d(part**2, size)
                energy += square / max(float(square.mean()), 1e-300)
        by_trial.append(np.where(stands, np.nan, energy))
    found = [
        by_trial[trial][span][:: band.every]
        for span, trial in zip(band.spans, band.trial, strict=True)
    ]
    mean = float(np.nanmean(np.concatenate(found)))
    return [one / max(mean, 1e-300) for one in found]


def growing_noise(white: np.ndarray, lively: np.ndarray, most: float) -> tuple[float, float]:
    """What noise that grows with the motion adds to the log likelihood [nats], and its share.

    Noise of an instrument is there at rest as well. What a model leaves only where the joint moves
    is not noise, whatever its colour.

    Parameters
    ----------
    white : array, shape (n,)
        Whitened residual, of variance 1 were it noise.
    lively : array, shape (n,)
        Of mean 1; NaN for what does not count.
    most : float
        Largest share of the variance that may grow.
    """
    known = np.isfinite(lively)
    squares, lively = white[known] ** 2, lively[known]
    if not squares.size or not squares.any():
        return 0.0, 0.0
    shares = most * np.linspace(0.0, 1.0, _SHARES_TRIED)
    variances = 1 - shares[:, None] + shares[:, None] * lively
    variances = np.maximum(variances, _LEAST_VARIANCE)
    level = np.mean(squares / variances, axis=1)
    cost = 0.5 * np.sum(np.log(variances), axis=1) + 0.5 * squares.size * np.log(level)
    best = int(np.argmin(cost))
    return float(cost[0] - cost[best]), float(shares[best])
