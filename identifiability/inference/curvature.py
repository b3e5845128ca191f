"""Widths from the shape of the likelihood at its top: the quadratic estimate and its kin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identifiability.inference.problem import Problem

NORMAL_95 = 1.96
"""Standard deviations of a Gaussian that its 95 % interval reaches to either side."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """Second-order description of a problem at its optimum.

    Attributes
    ----------
    hessian : array, shape (k, k)
        Second derivatives of the negative log likelihood, exact.
    gauss_newton : array, shape (k, k)
        J'J of the whitened residuals; it leaves out the curvature of the model, which matters
        because a wrong model's residual does not vanish.
    """

    hessian: np.ndarray
    gauss_newton: np.ndarray

    @property
    def slice_sd(self) -> np.ndarray:
        """Widths with all other parameters held, shape (k,)."""
        diagonal = np.diag(self.hessian)
        return np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), np.inf)

    @property
    def covariance(self) -> np.ndarray:
        """Inverse of the full Hessian (NaN where it has no maximum to describe)."""
        return _inverse(self.hessian)

    @property
    def gauss_newton_covariance(self) -> np.ndarray:
        """Inverse of J'J."""
        return _inverse(self.gauss_newton)

    @property
    def sandwich_covariance(self) -> np.ndarray:
        """``H^-1 J'J H^-1``: how the optimum scatters over repetitions, for a wrong model too."""
        inverse = self.covariance
        return inverse @ self.gauss_newton @ inverse


def curvature(problem: Problem, x: np.ndarray) -> Curvature:
    """Curvature of the negative log likelihood at `x`, shape (k,), by automatic differentiation."""
    jacobian = problem.jacobian(x)
    hessian = problem.hessian(x)
    return Curvature(0.5 * (hessian + hessian.T), jacobian.T @ jacobian)


def largest_change(hessian: np.ndarray, dE: float = 1e-3) -> np.ndarray:
    """Largest simultaneous change of parameters that raises E by `dE` (Eqs. 12-15 of the paper).

    Parameters
    ----------
    hessian : array, shape (k, k)
        Second derivatives of E at its minimum.
    dE : float

    Returns
    -------
    array, shape (k,)
        ``sqrt(2 dE / lambda_min) v_min``; its sign is arbitrary, here that of a positive first
        component.
    """
    values, vectors = np.linalg.eigh(hessian)
    change = np.sqrt(2 * dE / values[0]) * vectors[:, 0]
    return change if change[0] >= 0 else -change


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix, in scaled units; NaN if it is not one."""
    size = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
    scaled = matrix / np.outer(size, size)
    if not np.all(np.isfinite(scaled)) or np.linalg.eigvalsh(scaled)[0] <= 1e-13:
        return np.full_like(matrix, np.nan)
    return np.linalg.inv(scaled) / np.outer(size, size)
