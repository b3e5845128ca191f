"""The noise that a residual is judged by, and residuals in its units.

The noise is read from the quiet samples before the perturbation: an autoregressive model that all
trials share, and a level for each trial. Residuals pass that model's inverse, which leaves white
noise of variance 1 and what the noise does not explain, and are averaged over blocks of 5 ms, in
which a joint moves smoothly while the noise averages out. Sums of their squares follow F, since the
noise's level is itself an estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal, stats

from identifiability.investigation.fits.candidate import Residual
from identifiability.investigation.where.imposed import starts
from identifiability.measurement.prepared import Prepared

BLOCK = 0.005
"""Duration [s] that whitened residuals are averaged over."""
_HIGHEST_ORDER, _SAMPLES_PER_COEFFICIENT = 8, 25
_ROUNDS = 5
_LEAST_GAP = 0.03  # of the coefficients' sum from 1, where the noise would be a random walk
_MEDIAN_EFFICIENCY = 0.37  # of the median absolute deviation as an estimate of a Gaussian's level


@dataclass(frozen=True, eq=False)
class Portion:
    """How many blocks of one trial are in a sum of squares, and what they share.

    Attributes
    ----------
    n : float
        Number of blocks.
    offset : float
        Sum of squares that the uncertainty of the level at rest adds, on average.
    dof : float
        Degrees of freedom of the trial's noise level.
    """

    n: float
    offset: float
    dof: float


@dataclass(frozen=True, eq=False)
class Blocks:
    """One trial's residual in units of the noise, by blocks, from its first perturbation on.

    Attributes
    ----------
    values : array, shape (n,)
        White noise of variance 1, if the model is right.
    time : array, shape (n,)
        Time [s] since the latest perturbation, at the beginning of each block.
    event : array of int, shape (n,)
        Number of that perturbation.
    level : array, shape (n,)
        What a constant offset looks like, in units of its standard deviation.
    index : array of int, shape (n, m)
        Compared samples in each block.
    """

    values: np.ndarray
    time: np.ndarray
    event: np.ndarray
    level: np.ndarray
    index: np.ndarray


@dataclass(frozen=True, eq=False)
class Whitening:
    """The noise of the fitted trials.

    Attributes
    ----------
    known : bool
        Whether it was read from quiet leads; otherwise from the residual itself.
    coefficients : array, shape (p,)
        Autoregressive coefficients, those of the nearest sample first.
    sds : array, shape (n_trials,)
        Standard deviation [rad or Nm] of the innovations.
    dof : array, shape (n_trials,)
        Degrees of freedom of each.
    offsets : array, shape (n_trials,)
        Standard error [rad or Nm] of the level at rest.
    covariance : array, shape (p, p)
        Of the coefficients.
    """

    known: bool
    coefficients: np.ndarray
    sds: np.ndarray
    dof: np.ndarray
    offsets: np.ndarray
    covariance: np.ndarray

    def white(self, trial: int, columns: np.ndarray) -> np.ndarray:
        """Columns over a trial's compared samples, shape (n, k), through the noise's inverse."""
        inverse = np.concatenate([[1.0], -self.coefficients])
        return np.asarray(signal.lfilter(inverse, [1.0], columns, axis=0) / self.sds[trial])

    def averaged(self, trial: int, columns: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Whitened columns summed over blocks, such that white noise keeps its variance."""
        return self.white(trial, columns)[index].sum(axis=1) / np.sqrt(index.shape[1])

    def slack(self, frequency: np.ndarray, weight: np.ndarray | float = 1.0) -> float:
        """Relative variance that the coefficients' errors give the power of whitened noise.

        Parameters
        ----------
        frequency : array, shape (n,)
            Frequencies [cycles a sample] over which the power is averaged.
        weight : array, shape (n,), or float
            Weight of each, 1 on average.
        """
        slope = self._slope(frequency, weight)
        return float(slope @ self.covariance @ slope)

    def lift(self, frequency: np.ndarray) -> float:
        """Relative rise of the whitened noise's power that the caution at low frequencies costs."""
        return max(0.0, float(self._slope(frequency, 1.0) @ _caution(self.covariance)))

    def _slope(self, frequency: np.ndarray, weight: np.ndarray | float) -> np.ndarray:
        """Derivative of the logarithm of the noise's power by the coefficients, shape (p,)."""
        turn = np.exp(-2j * np.pi * np.outer(np.arange(1, self.coefficients.size + 1), frequency))
        return np.mean(weight * 2 * (turn / (1 - self.coefficients @ turn)).real, axis=1)

    def block_slack(self, m: int) -> float:
        """The same for blocks of m samples."""
        frequency = (np.arange(256) + 0.5) / 512
        lags = np.arange(1 - m, m)
        weight = np.cos(2 * np.pi * np.outer(frequency, lags)) @ (1 - np.abs(lags) / m)
        return self.slack(frequency, weight)

    def blocks(self, trial: int, ready: Prepared, residual: np.ndarray) -> Blocks:
        """A trial's residual by blocks; the samples before the first perturbation are left out.

        Parameters
        ----------
        trial : int
            Its number.
        ready : Prepared
        residual : array, shape (n,)
            Measured minus predicted response at the compared samples.
        """
        interval = ready.drive.interval
        m = max(1, round(BLOCK / interval))
        onsets = starts(ready)
        firsts, times, events = [], [], []
        for k, (onset, end) in enumerate(zip(onsets, [*onsets[1:], residual.size], strict=True)):
            begins = np.arange(onset, end - m + 1, m)
            firsts.append(begins)
            times.append((begins - onset) * interval)
            events.append(np.full(begins.size, k))
        index = np.concatenate(firsts)[:, None] + np.arange(m)
        columns = np.column_stack([residual, np.full(residual.size, self.offsets[trial])])
        values, level = self.averaged(trial, columns, index).T
        return Blocks(values, np.concatenate(times), np.concatenate(events), level, index)

    def portion(self, trial: int, blocks: Blocks, chosen: np.ndarray | slice) -> Portion:
        """What some blocks of a trial, given as a mask or slice, contribute to a sum of squares."""
        level = blocks.level[chosen]
        return Portion(level.size, float(level @ level), float(self.dof[trial]))


def whitening(part: Sequence[Prepared], residual: Residual) -> Whitening:
    """Noise of some trials, from their quiet leads or else from their residuals.

    Parameters
    ----------
    part : sequence of Prepared
    residual : Residual
        What a model leaves of them.
    """
    if all(ready.lead.n_samples and ready.lead.sd > 0 for ready in part):
        leads = [np.asarray(ready.response[: ready.lead.n_samples]) for ready in part]
        # At rest a coarse recorder may show no noise at all.
        if all(np.any(x) for x in leads):
            found = _from_leads(leads)
            if np.all(found.sds > 0):
                return found
    return _from_residuals(part, residual)


def _from_leads(leads: Sequence[np.ndarray]) -> Whitening:
    lengths = np.array([x.size for x in leads])
    # A level that was taken off takes its share of the slowest noise with it.
    centred = np.array([abs(x.mean()) < 1e-9 * np.sqrt(np.mean(x**2)) for x in leads], float)
    sds = np.sqrt([np.mean(x**2) for x in leads])
    for _ in range(_ROUNDS):  # the levels weigh the trials, and are those of the innovations
        scaled = [x / sd for x, sd in zip(leads, sds, strict=True)]
        coefficients, covariance = _autoregression(scaled, float(np.mean(centred / lengths)))
        p = coefficients.size
        coefficients = coefficients + _caution(covariance)
        inverse = np.concatenate([[1.0], -coefficients])
        energy = [np.sum(np.convolve(x, inverse)[p : x.size] ** 2) for x in leads]
        dof = lengths - p - centred
        sds = np.sqrt(np.array(energy) / dof)
        if not np.all(sds > 0):
            break
    # A level within the scatter was left in place: it is as uncertain as one that was taken off.
    offsets = sds / max(1 - coefficients.sum(), _LEAST_GAP) / np.sqrt(lengths)
    return Whitening(True, coefficients, sds, dof, offsets, covariance)


def _caution(covariance: np.ndarray) -> np.ndarray:
    """Change of the coefficients that raises their sum by its standard error.

    Too low a sum leaves slow noise that would look like a misfit, so they err to the other side.
    """
    together = covariance.sum(axis=1)
    return np.asarray(together / np.sqrt(max(float(together.sum()), 1e-300)))


def _from_residuals(part: Sequence[Prepared], residual: Residual) -> Whitening:
    floor = [1e-9 * np.sqrt(ready.mean_square) for ready in part]
    scaled = [
        r / max(float(np.sqrt(np.mean(r**2))), low)
        for r, low in zip(residual.by_trial, floor, strict=True)
    ]
    coefficients, covariance = _autoregression(scaled, 0.0)
    inverse = np.concatenate([[1.0], -coefficients])
    sds, dof = [], []
    for r, low in zip(residual.by_trial, floor, strict=True):
        innovations = np.convolve(r, inverse)[: r.size]
        sds.append(max(1.4826 * float(np.median(np.abs(innovations))), low))
        dof.append(max(_MEDIAN_EFFICIENCY * r.size, 5.0))
    none = np.zeros(len(sds))
    return Whitening(False, coefficients, np.array(sds), np.array(dof), none, covariance)


def _autoregression(pieces: Sequence[np.ndarray], centred: float) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients by Yule-Walker from pooled pieces, and their covariance.

    Their number is chosen by the Schwarz criterion, at least one where the pieces are long enough:
    a correlation too weak to be seen still matters in a sum over many samples.

    Parameters
    ----------
    pieces : sequence of array
        All of one level.
    centred : float
        Mean over the pieces of 1/n where the mean was taken off, else 0. It lowers all
        autocovariances by the noise's power at frequency 0 over n, which is put back.
    """
    n = sum(piece.size for piece in pieces)
    highest = min(_HIGHEST_ORDER, n // _SAMPLES_PER_COEFFICIENT, min(p.size for p in pieces) // 3)
    found = np.array(
        [
            sum(x[: x.size - k] @ x[k:] for x in pieces) / sum(x.size - k for x in pieces)
            for k in range(max(highest, 0) + 1)
        ]
    )
    if highest < 1 or not found[0] > 0:
        return np.zeros(0), np.zeros((0, 0))
    best, covariance = np.zeros(0), found
    for _ in range(_ROUNDS if centred else 1):
        best = _chosen_order(covariance, n)
        power = _innovation(covariance, best) / max(1 - best.sum(), _LEAST_GAP) ** 2
        covariance = found + centred * power
    matrix = linalg.toeplitz(covariance[: best.size])
    return best, _innovation(covariance, best) * np.linalg.pinv(matrix) / n


def _chosen_order(covariance: np.ndarray, n: int) -> np.ndarray:
    best, least = np.zeros(1), np.inf
    for order in range(1, covariance.size):
        coefficients = linalg.solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        variance = _innovation(covariance, coefficients)
        if not variance > 0:
            break
        criterion = n * np.log(variance) + order * np.log(n)
        if criterion < least:
            best, least = coefficients, criterion
    return best


def _innovation(covariance: np.ndarray, coefficients: np.ndarray) -> float:
    return float(covariance[0] - coefficients @ covariance[1 : coefficients.size + 1])


def excess(total: float, portions: Sequence[Portion], slack: float = 0.0) -> tuple[float, float]:
    """Sum of squares of whitened residuals over its expectation, and how likely it is.

    The ratio of a sum of chi-squares to estimated noise levels has a known mean and variance; the
    scaled F distribution that has both, and the numerator's degrees of freedom, stands for it. For
    one trial whose noise is white it is exact.

    Parameters
    ----------
    total : float
    portions : sequence of Portion
        Where its squares come from.
    slack : float
        Relative variance of the noise's power that all of them share.

    Returns
    -------
    float
        1 on average, if the residual is noise.
    float
        Probability of as large a sum.
    """
    mean, variance, plain_mean, plain_variance = 0.0, 0.0, 0.0, 0.0
    for portion in portions:
        expected = portion.n + portion.offset
        spread = 2 * (portion.n + 2 * portion.offset + portion.offset**2)
        nu = portion.dof
        first, second = nu / (nu - 2), nu**2 / ((nu - 2) * (nu - 4))
        mean += expected * first
        variance += (spread + expected**2) * second - (expected * first) ** 2
        plain_mean += expected
        plain_variance += spread
    if mean == 0:
        return 1.0, 1.0
    h = 2 * plain_mean**2 / plain_variance
    c = (variance / mean**2 * (1 + slack) + slack) * h
    if c <= 2 * (1 + 1e-6):
        return total / mean, float(stats.chi2.sf(h * total / mean, h))
    nu = (2 * h - 4 + 4 * c) / (c - 2)
    return total / mean, float(stats.f.sf(total / mean * nu / (nu - 2), h, nu))
