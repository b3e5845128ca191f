"""Evidence of linear Gaussian models of several trials, from inner products alone.

A trial's residual is ``r = A u + D c + e``: local weights u that belong to this trial, common
weights c that all trials share, both Gaussian around 0, and noise e, first-order autoregressive.
All that the evidence needs are inner products of the columns of A, D and r under the inverse of
the noise's covariance, which is tridiagonal: three matrices a trial serve every standard deviation
and every correlation of the noise. Weights are then eliminated one set after the other (Schur
complements), so nothing larger than the number of weights of one trial is ever factorised. It is
Gaussian-process regression in its weight-space view (Rasmussen & Williams 2006, section 2.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

_JITTER = 1e-9
_RESIDUAL = np.ones((1, 1))  # its weight is 1


@dataclass(frozen=True, eq=False)
class TrialNoise:
    """Noise of all trials.

    Attributes
    ----------
    sds : array, shape (n_trials,)
        Standard deviations.
    rho : float
        Correlation from one sample to the next.
    """

    sds: np.ndarray
    rho: float

    def log_determinant(self, trial: int, n_samples: int) -> float:
        """Logarithm of the determinant of a trial's covariance."""
        return float(
            2 * n_samples * np.log(self.sds[trial]) + (n_samples - 1) * np.log1p(-(self.rho**2))
        )


@dataclass(frozen=True, eq=False)
class Columns:
    """Inner products of one trial's columns, for any noise.

    Attributes
    ----------
    n_samples, n_local : int
    whole, lagged, inner : array, shape (m, m)
        Of all samples, of samples and their successors, of all but the first and last; the m
        columns are those of the local weights, of the common weights, and the residual.
    """

    n_samples: int
    n_local: int
    whole: np.ndarray
    lagged: np.ndarray
    inner: np.ndarray

    @classmethod
    def of(cls, local: np.ndarray, common: np.ndarray, residual: np.ndarray) -> Columns:
        """Inner products of columns, shapes (n, n_local), (n, n_common) and (n,)."""
        z = np.column_stack([local, common, residual])
        lagged = z[1:].T @ z[:-1]
        inside = z[1:-1]
        return cls(len(z), local.shape[1], z.T @ z, lagged + lagged.T, inside.T @ inside)

    def only(self, local: np.ndarray, common: np.ndarray) -> Columns:
        """Inner products of some of the columns and the residual.

        Parameters
        ----------
        local, common : array of int
            Local columns, and common ones, each counted from 0.
        """
        chosen = np.concatenate([local, self.n_local + common, [len(self.whole) - 1]])
        at = np.ix_(chosen, chosen)
        return Columns(self.n_samples, len(local), self.whole[at], self.lagged[at], self.inner[at])

    def under(self, noise: TrialNoise, trial: int) -> np.ndarray:
        """Inner products under the inverse of the noise's covariance, shape (m, m)."""
        rho = noise.rho
        scale = noise.sds[trial] ** 2 * (1 - rho**2)
        return (self.whole - rho * self.lagged + rho**2 * self.inner) / scale


class Eliminated(NamedTuple):
    """What is left when weights have been integrated out.

    Attributes
    ----------
    products : array, shape (m - k, m - k)
        Inner products of the other columns, under a covariance that holds the weights' share too.
    change : float
        By how much the logarithm of that covariance's determinant grew.
    root, lower, across : array
        Factors, of which the weights' posterior is made.
    """

    products: np.ndarray
    change: float
    root: np.ndarray
    lower: np.ndarray
    across: np.ndarray

    @property
    def posterior_root(self) -> np.ndarray:
        """Square root of the weights' posterior covariance, given the other columns' weights."""
        if self.root.size == 0:
            return self.root
        return np.asarray(lapack.dtrtrs(self.lower, self.root.T, lower=1)[0].T)


def eliminate(products: np.ndarray, root: np.ndarray) -> Eliminated:
    """Integrate the first weights out.

    Parameters
    ----------
    products : array, shape (m, m)
        Inner products of the columns, those of the weights to be eliminated first.
    root : array, shape (k, k)
        Square root of these weights' prior covariance.

    Raises
    ------
    LinAlgError
        Where the columns are so nearly dependent that rounding decides.
    """
    k = len(root)
    if k == 0:
        return Eliminated(products, 0.0, root, root, products[:0])
    core = root.T @ products[:k, :k] @ root
    core.flat[:: k + 1] += 1.0
    lower, failed = lapack.dpotrf(core, lower=1)
    if failed:
        raise np.linalg.LinAlgError("the columns are too nearly dependent")
    across = lapack.dtrtrs(lower, root.T @ products[:k, k:], lower=1)[0]
    change = 2 * float(np.sum(np.log(np.diag(lower))))
    return Eliminated(products[k:, k:] - across.T @ across, change, root, lower, across)


def square_root(covariance: np.ndarray) -> np.ndarray:
    """Lower triangular square root of a covariance, with a little added to its diagonal."""
    jittered = covariance.copy()
    jittered.flat[:: len(covariance) + 1] *= 1 + _JITTER
    return np.linalg.cholesky(jittered)


def side_by_side(*blocks: np.ndarray) -> np.ndarray:
    """Block diagonal matrix; SciPy's is slow where matrices are small."""
    out = np.zeros(tuple(sum(b.shape[axis] for b in blocks) for axis in (0, 1)))
    row = column = 0
    for b in blocks:
        out[row : row + b.shape[0], column : column + b.shape[1]] = b
        row, column = row + b.shape[0], column + b.shape[1]
    return out


@dataclass(frozen=True, eq=False)
class Slope:
    """Log evidence, and its derivatives.

    Attributes
    ----------
    value : float
    local : list of array, shape (n_local, n_local)
        By the square root of the prior covariance of each trial's local weights.
    common : array, shape (n_common, n_common)
        The same of the common weights.
    log_sds : array, shape (n_trials,)
        By the logarithm of each trial's standard deviation of the noise.
    rho : float
        By the correlation of the noise.
    """

    value: float
    local: list[np.ndarray]
    common: np.ndarray
    log_sds: np.ndarray
    rho: float


def log_evidence_slope(
    trials: Sequence[Columns], noise: TrialNoise, local: Sequence[np.ndarray], common: np.ndarray
) -> Slope:
    """Log probability density of the residuals of all trials, and its derivatives.

    What is left when weights are integrated out is a minimum over them, so its derivative is that
    of the squares where the weights stay at their posterior mean; that of a log determinant is a
    trace of the posterior covariance.

    Parameters
    ----------
    trials : sequence of Columns
    noise : TrialNoise
    local : sequence of array, shape (n_local, n_local)
        Square root of the prior covariance of each trial's local weights.
    common : array, shape (n_common, n_common)
        The same of the common weights.

    Raises
    ------
    LinAlgError
        Where the columns are so nearly dependent that rounding decides.
    """
    rho = noise.rho
    products, lefts, summed, last = _eliminated(trials, noise, local, common)
    total = last.change + float(last.products[0, 0])
    spread = last.posterior_root
    outer = _second_moments(spread, last.across, _RESIDUAL)
    by_common = _by_root(summed, spread, last, _RESIDUAL)
    by_local, by_sd, by_rho = [], [], 0.0
    for i, (columns, left) in enumerate(zip(trials, lefts, strict=True)):
        total += left.change + noise.log_determinant(i, columns.n_samples)
        total += columns.n_samples * np.log(2 * np.pi)
        spread = left.posterior_root
        by_local.append(-0.5 * _by_root(products[i], spread, left, outer))
        inner = _second_moments(spread, left.across, outer)
        n, scale = columns.n_samples, noise.sds[i] ** 2 * (1 - rho**2)
        energy = float(np.sum(inner * products[i]))
        by_sd.append(energy - n)
        changed = (2 * rho * columns.inner - columns.lagged) / scale
        by_rho -= 0.5 * float(np.sum(inner * changed))
        by_rho -= rho / (1 - rho**2) * (energy - (n - 1))
    return Slope(-0.5 * total, by_local, -0.5 * by_common, np.array(by_sd), by_rho)


def _eliminated(
    trials: Sequence[Columns], noise: TrialNoise, local: Sequence[np.ndarray], common: np.ndarray
) -> tuple[list[np.ndarray], list[Eliminated], np.ndarray, Eliminated]:
    """Integrate all weights out: by trial before and after, and of all trials before and after."""
    products = [columns.under(noise, i) for i, columns in enumerate(trials)]
    lefts = [eliminate(own, root) for own, root in zip(products, local, strict=True)]
    summed = np.sum([left.products for left in lefts], axis=0)
    return products, lefts, summed, eliminate(summed, common)


def renewed(
    trials: Sequence[Columns], noise: TrialNoise, local: Sequence[np.ndarray], common: np.ndarray
) -> TrialNoise:
    """Noise whose standard deviations are one step of expectation maximisation further."""
    grown = log_evidence_slope(trials, noise, local, common).log_sds
    n = np.array([columns.n_samples for columns in trials])
    return TrialNoise(noise.sds * np.sqrt(1 + grown / n), noise.rho)


def _second_moments(spread: np.ndarray, across: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Second moments of all columns' weights, from those of the columns that were left."""
    k = len(spread)
    gains = np.vstack([-spread @ across, np.eye(len(outer))])
    moments = np.asarray(gains @ outer @ gains.T)
    moments[:k, :k] += spread @ spread.T
    return moments


def _by_root(
    products: np.ndarray, spread: np.ndarray, left: Eliminated, outer: np.ndarray
) -> np.ndarray:
    """Derivative, by a prior's root, of the change plus the products left, weighed by `outer`."""
    k = len(spread)
    if k == 0:
        return spread
    own = products[:k, :k]
    whitened = lapack.dtrtrs(left.lower, np.eye(k), lower=1)[0]
    to_root = spread @ whitened  # root times the inverse of the core
    missed = products[:k, k:] - own @ spread @ left.across
    gains = whitened.T @ left.across
    return np.asarray(2 * own @ to_root - 2 * missed @ outer @ gains.T)


@dataclass(frozen=True, eq=False)
class Weights:
    """Posterior of one set of weights: mean, shape (k,), and a square root of its covariance."""

    mean: np.ndarray
    root: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations, shape (k,)."""
        return np.asarray(np.sqrt(np.sum(self.root**2, axis=1)))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of all weights under given noise and priors: see `log_evidence_slope`."""

    trials: Sequence[Columns]
    noise: TrialNoise
    local_root: Sequence[np.ndarray]
    common_root: np.ndarray

    @cached_property
    def _solved(self) -> tuple[list[tuple[np.ndarray, np.ndarray]], Weights]:
        """By trial a root of the local weights and their gains; the common weights."""
        _, lefts, _, last = _eliminated(self.trials, self.noise, self.local_root, self.common_root)
        roots = [left.posterior_root for left in lefts]
        parts = [(root, root @ left.across) for root, left in zip(roots, lefts, strict=True)]
        root = last.posterior_root
        return parts, Weights(root @ last.across[:, -1], root)

    @property
    def common(self) -> Weights:
        """Of the common weights."""
        return self._solved[1]

    @cached_property
    def local(self) -> list[Weights]:
        """Of each trial's local weights, the uncertainty of the common ones included."""
        parts, common = self._solved
        out = []
        for root, gains in parts:
            mean = gains[:, -1] - gains[:, :-1] @ common.mean
            out.append(Weights(mean, np.hstack([root, gains[:, :-1] @ common.root])))
        return out

    def draw(self, n: int, seed: int) -> tuple[list[np.ndarray], np.ndarray]:
        """Draw weights.

        Parameters
        ----------
        n : int
            Number of draws.
        seed : int

        Returns
        -------
        list of array, shape (n, n_local)
            Local weights of each trial.
        array, shape (n, n_common)
        """
        rng = np.random.default_rng(seed)
        parts, common = self._solved
        shared = common.mean + rng.standard_normal((n, common.mean.size)) @ common.root.T
        local = []
        for root, gains in parts:
            given = gains[:, -1] - shared @ gains[:, :-1].T
            local.append(given + rng.standard_normal((n, len(root))) @ root.T)
        return local, shared
