"""Noise that was estimated, as it whitens residuals.

Noise of an imposed angle does more than widen: what is predicted from a noisy angle is too large a
response by the noise's own, and least squares make K, B and I smaller to make up for it, however
long the record (attenuation: Fuller 1987, Measurement Error Models, section 1.1). The expected
square of that share is known once the noise is, and is taken off the sum of squares: the likelihood
in which the true motion is a nuisance, to first order (corrected score: Nakamura 1990, Biometrika
77:127-137). No term for the determinant of the covariance belongs to it: in the joint likelihood of
both channels that of the motion cancels it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identifiability.inference.likelihood.carried import motion_taps
from identifiability.inference.likelihood.estimate import NoiseEstimate
from identifiability.inference.likelihood.processes import Whitening

LEAST = 1e-6
"""Share of the ceiling that is left of it at least."""
_CEILING = 4.0  # of the correction at the optimum, so that the rest of the cost stays positive
_ROOM = 400  # samples in which a whitened unit of noise fades


@dataclass(frozen=True, eq=False)
class Colour:
    """How the residuals of a problem are whitened.

    Where noise of an imposed angle is taken off, there is one residual more: the root of what it
    leaves of a ceiling, a constant.

    Attributes
    ----------
    noises : sequence of NoiseEstimate
        One for each sampling interval.
    which : sequence of int
        Number of the noise of each observation.
    trial : sequence of int
        Number of each observation among those of its noise.
    stretches : sequence of sequence of array of int
        Samples of each stretch of each observation; each has an unknown level.
    excess : array, shape (3, 3), or None
        Sum of squares that noise of the imposed angle adds to the whitened residual, as a
        quadratic form in K, B and I.
    joint : array, shape (3,)
        K, B and I at which the noise was estimated.
    """

    noises: Sequence[NoiseEstimate]
    which: Sequence[int]
    trial: Sequence[int]
    stretches: Sequence[Sequence[np.ndarray]]
    excess: np.ndarray | None
    joint: np.ndarray

    @cached_property
    def _longest(self) -> int:
        return max(s.size for of_one in self.stretches for s in of_one)

    @cached_property
    def whitenings(self) -> list[Whitening]:
        """Of each noise, for the longest stretch."""
        return [estimate.noise.whitening(self._longest) for estimate in self.noises]

    @cached_property
    def ceiling(self) -> float:
        """What the excess is taken off; 0 without one."""
        if self.excess is None:
            return 0.0
        return _CEILING * float(self.joint @ self.excess @ self.joint)


def excess_of(
    noises: Sequence[NoiseEstimate], counts: Sequence[int], intervals: Sequence[float]
) -> np.ndarray | None:
    """Quadratic form, shape (3, 3), of what noise of an imposed angle adds to the sum of squares.

    Parameters
    ----------
    noises : sequence of NoiseEstimate
    counts : sequence of int
        Numbers of samples with each noise.
    intervals : sequence of float
        Their sampling intervals [s].

    Returns
    -------
    array or None
        None where no noise of the angle was found.
    """
    total = np.zeros((3, 3))
    for noise, count, interval in zip(noises, counts, intervals, strict=True):
        if noise.carried is not None:
            taps = motion_taps(interval)
            unit = np.zeros((_ROOM + len(taps), 3))
            unit[_ROOM // 2 : _ROOM // 2 + len(taps)] = taps
            white = noise.noise.whitening(len(unit))(unit)
            total += count * noise.carried_sd**2 * white.T @ white
    return total if total.any() else None
