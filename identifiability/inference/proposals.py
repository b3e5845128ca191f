"""Proposals that do not depend on where a walker stands: multivariate t and mixtures of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp

_MOST_REDRAWS, _LARGEST_BLOCK = 400, 100_000


@dataclass(frozen=True, eq=False)
class StudentMixture:
    """Mixture of multivariate t densities, cut to a box by redrawing what falls outside.

    The cut changes the density inside only by a constant, which Metropolis-Hastings ratios and
    normalised importance weights do not see.

    Attributes
    ----------
    weights : array, shape (c,)
    means : array, shape (c, k)
    factors : array, shape (c, k, k)
        Lower Cholesky factors of the scale matrices.
    df : float
        Degrees of freedom: heavy tails are what makes an independence sampler safe.
    lower, upper : array, shape (k,)
        The box.
    """

    weights: np.ndarray
    means: np.ndarray
    factors: np.ndarray
    df: float
    lower: np.ndarray
    upper: np.ndarray

    def draw(self, n: int, random: np.random.RandomState) -> np.ndarray:
        """Draw points inside the box, shape (n, k).

        Raises
        ------
        RuntimeError
            Where hardly any of the density lies in the box.
        """
        kept, missing, block = [], n, n
        for _ in range(_MOST_REDRAWS):
            points = self._draw_uncut(block, random)
            inside = np.all((points >= self.lower) & (points <= self.upper), axis=1)
            kept.append(points[inside][:missing])
            missing -= len(kept[-1])
            if not missing:
                return np.concatenate(kept)
            # The fewer points fall inside, the more are drawn at once.
            expected = missing * block / max(1, int(inside.sum()))
            block = int(min(max(1.2 * expected, 16), _LARGEST_BLOCK))
        raise RuntimeError("hardly any of the proposal lies inside the prior's bounds")

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Log density inside the box, up to a constant, shape (n,)."""
        k = self.means.shape[1]
        terms = []
        for weight, mean, factor in zip(self.weights, self.means, self.factors, strict=True):
            z = (points - mean) @ np.linalg.inv(factor).T
            squared = np.einsum("nk,nk->n", z, z)
            log_scale = np.sum(np.log(np.diag(factor)))
            terms.append(
                np.log(weight) - log_scale - 0.5 * (self.df + k) * np.log1p(squared / self.df)
            )
        normalisation = gammaln(0.5 * (self.df + k)) - gammaln(0.5 * self.df)
        mixed = terms[0] if len(terms) == 1 else logsumexp(terms, axis=0)
        return mixed + normalisation - 0.5 * k * np.log(self.df * np.pi)

    def _draw_uncut(self, n: int, random: np.random.RandomState) -> np.ndarray:
        k = self.means.shape[1]
        normal = random.standard_normal((n, k))
        stretch = np.sqrt(self.df / random.chisquare(self.df, n))
        if len(self.weights) == 1:
            return np.asarray(self.means[0] + stretch[:, None] * (normal @ self.factors[0].T))
        component = random.choice(len(self.weights), size=n, p=self.weights)
        for i, factor in enumerate(self.factors):
            chosen = component == i
            normal[chosen] = normal[chosen] @ factor.T
        return np.asarray(self.means[component] + stretch[:, None] * normal)


def laplace_t(
    optimum: np.ndarray, precision: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> StudentMixture:
    """Multivariate t (5 degrees of freedom) with the shape of the posterior's top.

    Directions that the data leave open, or that the Hessian bends upwards, get the width of the
    prior's box, or a thousand times the parameter's size where there is no box.

    Parameters
    ----------
    optimum : array, shape (k,)
    precision : array, shape (k, k)
        Hessian of the negative log posterior.
    lower, upper : array, shape (k,)
    """
    widest = np.where(np.isfinite(upper - lower), upper - lower, 1e3 * np.abs(optimum) + 1e-9)
    # In units of the narrowest curvature per parameter the eigenvalues are comparable.
    size = 1 / np.sqrt(np.maximum(np.abs(np.diag(precision)), 1 / widest**2))
    values, vectors = np.linalg.eigh(precision * np.outer(size, size))
    floor = np.einsum("i,ij->j", (size / widest) ** 2, vectors**2)
    factor = (size[:, None] * vectors) / np.sqrt(np.maximum(values, floor))
    return StudentMixture(
        np.ones(1),
        optimum[None].astype(float),
        np.linalg.cholesky(factor @ factor.T)[None],
        5.0,
        lower,
        upper,
    )


def combined(proposals: Sequence[StudentMixture], weights: Sequence[float]) -> StudentMixture:
    """Mixture of proposals that share box and degrees of freedom."""
    first = proposals[0]
    return StudentMixture(
        np.concatenate([w * p.weights for w, p in zip(weights, proposals, strict=True)]),
        np.concatenate([p.means for p in proposals]),
        np.concatenate([p.factors for p in proposals]),
        first.df,
        first.lower,
        first.upper,
    )


def fitted_mixture(
    points: np.ndarray, lower: np.ndarray, upper: np.ndarray, *, components: int = 6, seed: int
) -> StudentMixture:
    """Mixture of t densities (8 degrees of freedom) fitted to draws from a pilot run.

    Parameters
    ----------
    points : array, shape (n, k)
    lower, upper : array, shape (k,)
    components : int
    seed : int
    """
    from sklearn.mixture import GaussianMixture  # half a second, that most problems need not pay

    centre, size = points.mean(axis=0), points.std(axis=0)
    mixture = GaussianMixture(components, random_state=seed, reg_covar=1e-6, max_iter=200)
    mixture.fit((points - centre) / size)
    # A little wider than the fit: a proposal that is too narrow gets stuck, one too wide does not.
    factors = np.sqrt(1.2) * size[:, None] * np.linalg.cholesky(mixture.covariances_)
    means = centre + size * mixture.means_
    return StudentMixture(mixture.weights_, means, factors, 8.0, lower, upper)


def efficiency_on_gaussian(k: int, df: float) -> float:
    """Importance efficiency (Kish) of a t about a Gaussian of the same scale in k dimensions.

    The inverse of the mean of p²/q under q, whose integral over directions is in closed form and
    over the radius by quadrature.
    """
    radius = np.linspace(0, 12 + np.sqrt(k), 4001)[1:]
    log_p = -0.5 * radius**2 - 0.5 * k * np.log(2 * np.pi)
    log_q = (
        gammaln(0.5 * (df + k))
        - gammaln(0.5 * df)
        - 0.5 * k * np.log(df * np.pi)
        - 0.5 * (df + k) * np.log1p(radius**2 / df)
    )
    log_shell = np.log(2) + 0.5 * k * np.log(np.pi) - gammaln(0.5 * k) + (k - 1) * np.log(radius)
    return float(1 / np.trapezoid(np.exp(2 * log_p - log_q + log_shell), radius))
