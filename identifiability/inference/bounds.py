"""Points and the bounds of their parameters: inside, touching, on."""

from __future__ import annotations

import numpy as np

_NEAR, _SMALL = 1e-6, 1e-3  # of a parameter's size, which is taken for no less than the second
_FAR = 1e12  # stands for a bound that is infinite


def size_of(x: np.ndarray) -> np.ndarray:
    """Size of parameters, by which steps and distances are measured; above zero."""
    return np.maximum(np.abs(x), _SMALL)


def strictly_inside(points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points, shape (..., n), moved strictly inside, as the trust region method requires."""
    lower = np.where(np.isfinite(lower), lower, -_FAR)
    upper = np.where(np.isfinite(upper), upper, _FAR)
    margin = _NEAR * np.minimum(upper - lower, 1.0)
    return np.clip(points, lower + margin, upper - margin)


def touching(
    x: np.ndarray, lower: np.ndarray, upper: np.ndarray, near: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Whether parameters touch their lower and their upper bounds.

    Parameters
    ----------
    x, lower, upper : array, shape (n,)
    near : array, shape (n,), optional
        Distance that counts as none; a millionth of a parameter's size by default.

    Returns
    -------
    at_lower, at_upper : array of bool, shape (n,)
    """
    near = _NEAR * size_of(x) if near is None else near
    return x - lower <= near, upper - x <= near


def onto(
    x: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    touched: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """The same point, exactly on the bounds that it touches."""
    at_lower, at_upper = touched
    return np.where(at_lower, lower, np.where(at_upper, upper, x))
