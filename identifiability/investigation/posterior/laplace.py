"""Laplace's approximation: a posterior's integral about its mode, bounds included."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.special

_LEAST_EIGENVALUE = 1e-12
_FAR = 50.0  # nats, ten standard deviations of a prior
_LEAST_LEFT = 0.1  # share of a precision that noise of the angle leaves


def less(precision: np.ndarray, probe: np.ndarray) -> np.ndarray:
    """Precision without what noise of the angle adds to it, which by chance may be more than all.

    A share of it is kept in every direction: none is known less than that well.
    """
    left, vectors = scipy.linalg.eigh(precision - probe.T @ probe, precision)
    turned = precision @ vectors
    return np.asarray(turned * np.maximum(left, _LEAST_LEFT) @ turned.T)


def moved_by(pull: np.ndarray, precision: np.ndarray) -> float:
    """How much higher [nats] a posterior is at its mode than where it has this slope.

    Nothing where that is so far that no straight line leads there.
    """
    size = np.sqrt(np.diag(precision))
    scaled, steps = precision / np.outer(size, size), pull / size
    gained = 0.5 * float(steps @ np.linalg.lstsq(scaled, steps, rcond=1e-10)[0])
    return gained if gained < _FAR else 0.0


def log_volume(
    precision: np.ndarray, gradient: np.ndarray, at_bound: np.ndarray
) -> tuple[float, np.ndarray, dict[int, float]]:
    """Logarithm of the integral of the posterior about its mode, over its height there.

    Normal in the coordinates inside their bounds; in one at a bound the part of a normal that lies
    on its side, whose slope there is not 0.

    Returns
    -------
    float
    array of int
        Coordinates inside.
    dict of int to float
        Of those at a bound, how much higher [nats] the posterior would be beyond it.
    """
    inside = np.flatnonzero(~at_bound)
    size = np.sqrt(np.abs(np.diag(precision)))
    scaled = precision / np.outer(size, size)
    block = scaled[np.ix_(inside, inside)]
    eigenvalues = np.maximum(np.linalg.eigvalsh(block), _LEAST_EIGENVALUE)
    total = 0.5 * inside.size * np.log(2 * np.pi)
    total -= 0.5 * float(np.sum(np.log(eigenvalues))) + float(np.sum(np.log(size[inside])))
    gains = {}
    for i in np.flatnonzero(at_bound):
        # What the others take over when this one moves inside.
        taken = scaled[i, inside]
        others = np.linalg.lstsq(block, taken, rcond=1e-10)[0] if inside.size else np.zeros(0)
        curvature = max(float(1 - taken @ others), _LEAST_EIGENVALUE) * size[i] ** 2
        slope = abs(gradient[i]) / np.sqrt(2 * curvature)
        gains[int(i)] = float(slope**2)
        total += 0.5 * np.log(np.pi / (2 * curvature))
        total += float(np.log(max(scipy.special.erfcx(min(slope, 1e8)), 1e-300)))
    return total, inside, gains
