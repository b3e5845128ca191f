"""Steps within a radius: what a search for the likeliest noise takes, by whichever likelihood.

A library's optimiser in Python takes as long for its own steps as the residuals of a noise take,
and a noise is sought thousands of times in one investigation.
"""

from __future__ import annotations

import numpy as np

from identifiability.loops import compiled_loop

TRIALS = 60
RADIUS = 0.5
"""Of the first step."""
_STEP = 1e-5  # of differences
_BISECTIONS = 30
_DEPENDENT = 1e-13  # of the largest slope, squared, below which there is none


@compiled_loop
def clipped(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Values of which the first are moved inside their bounds."""
    found = values.copy()
    found[: lower.size] = np.minimum(np.maximum(values[: lower.size], lower), upper)
    return found


@compiled_loop
def nearby(values: np.ndarray, i: int) -> np.ndarray:
    """Values of which one is moved a little towards 0, away from bounds: for differences."""
    found = values.copy()
    found[i] += _STEP if values[i] < 0 else -_STEP
    return found


@compiled_loop
def stepped(
    values: np.ndarray,
    gradient: np.ndarray,
    products: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    radius: float,
) -> tuple[np.ndarray, float, float]:
    """Where a step leads, what it promises to take off a sum of squares, and how long it is.

    Values at a bound are left there while the squares fall beyond it.

    Parameters
    ----------
    values : array
        The first are free, the rest are held.
    gradient : array, shape (n_free,)
        Of half the sum of squares.
    products : array, shape (n_free, n_free)
        Its curvature.
    lower, upper : array, shape (n_free,)
    radius : float

    Returns
    -------
    array
    float
    float
    """
    n = lower.size
    outside = np.where(gradient > 0, values[:n] <= lower, values[:n] >= upper)
    step = _within(gradient, products, outside, radius)
    moved = values.copy()
    moved[:n] += step
    moved = clipped(moved, lower, upper)
    taken = moved[:n] - values[:n]
    promised = -2 * (gradient @ taken) - taken @ products @ taken
    return moved, promised, np.sqrt(np.sum(step**2))


@compiled_loop
def next_radius(radius: float, gained: float, promised: float, length: float) -> float:
    """Radius after a step that gained so much of what it promised."""
    if not gained > 0.25 * promised:
        return 0.25 * length
    if gained > 0.75 * promised and length > 0.95 * radius:
        return 2.0 * radius
    return radius


@compiled_loop
def _within(
    gradient: np.ndarray, products: np.ndarray, held: np.ndarray, radius: float
) -> np.ndarray:
    """Step of least squares no longer than a radius (Moré & Sorensen 1983), some values held."""
    pull, products = gradient.copy(), products.copy()
    for i in range(held.size):
        if held[i]:
            pull[i] = 0.0
            products[i, :] = 0.0
            products[:, i] = 0.0
    lengths, axes = np.linalg.eigh(products)
    lengths = np.maximum(lengths, _DEPENDENT * lengths[-1]) + 1e-300
    along = -(axes.T @ pull)
    damping = 0.0
    for _ in range(_BISECTIONS):
        size = np.sqrt(np.sum((along / (lengths + damping)) ** 2))
        if size <= 1.05 * radius:
            break
        # Newton's step for 1 / size, which is all but linear in the damping.
        slope = np.sum(along**2 / (lengths + damping) ** 3) / size**3
        damping += (1 / radius - 1 / size) / slope
    return axes @ (along / (lengths + damping))
