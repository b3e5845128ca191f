"""Whitening of residuals by the noise that was estimated, for compiled functions.

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
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from identifiability.inference.likelihood.carried import motion_taps
from identifiability.inference.likelihood.estimate import NoiseEstimate
from identifiability.inference.likelihood.processes import Whitening

LEAST = 1e-6
"""Share of the ceiling that is left of it at least."""
_CEILING = 4.0  # of the correction at the optimum, so that the rest of the cost stays positive
# Lags are padded to one of two numbers, so that few programs are compiled: those of an ARMA and the
# admittance, and those of an imposed angle's derivatives.
_FEW_LAGS, _LAGS = 6, 40
_ROOM = 400  # samples in which a whitened unit of noise fades


class ColourArrays(NamedTuple):
    """Arrays of `Colour` for compiled functions; leading axis: observations, then stretches.

    The autoregression and the rows of the triangular factor have one row for each noise, and end
    with their lag, the present first.
    """

    order: Array
    weight: Array
    level: Array
    which: Array
    ar: Array
    factor: Array
    excess: tuple[Array, Array] | None


@dataclass(frozen=True, eq=False)
class Colour:
    """How the residuals of a problem are whitened.

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

    def arrays(self) -> ColourArrays:
        """Arrays that `whitened` takes."""
        rows = len(self.stretches)
        longest = self._longest
        most = max(len(of_one) for of_one in self.stretches)
        order = np.zeros((rows, most, longest), int)
        weight, level = np.zeros((2, rows, most, longest))
        whitenings = self.whitenings
        constants = [whitening(np.ones((longest, 1)))[:, 0] for whitening in whitenings]
        lags = max(w.factor.shape[1] for w in whitenings)
        ar = np.zeros((len(whitenings), longest, _FEW_LAGS))
        factor = np.zeros((len(whitenings), longest, _FEW_LAGS if lags <= _FEW_LAGS else _LAGS))
        for i, whitening in enumerate(whitenings):
            head = whitening.ar.size - 1
            ar[i, :head, 0] = 1.0
            ar[i, head:, : whitening.ar.size] = whitening.ar
            factor[i, :, : whitening.factor.shape[1]] = whitening.rows(longest)
        for row, of_one in enumerate(self.stretches):
            noise = self.which[row]
            size = self.noises[noise].levels[self.trial[row]]
            for j, samples in enumerate(of_one):
                n = samples.size
                order[row, j, :n] = samples
                weight[row, j, :n] = 1 / size
                level[row, j, :n] = constants[noise][:n] / np.linalg.norm(constants[noise][:n])
        excess = None
        if self.excess is not None:
            excess = jnp.asarray(self.excess), jnp.asarray(self.ceiling)
        return ColourArrays(
            jnp.asarray(order),
            jnp.asarray(weight),
            jnp.asarray(level),
            jnp.asarray(self.which),
            jnp.asarray(ar),
            jnp.asarray(factor),
            excess,
        )


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


def whitened(residual: Array, theta: Array, colour: ColourArrays) -> Array:
    """Whitened residuals of all observations in one row, traceable.

    Parameters
    ----------
    residual : array, shape (n_observations, n)
    theta : array, shape (n_parameters,)
        K, B and I first.
    colour : ColourArrays

    Returns
    -------
    array, shape (n_residuals,)
        With one more at the end where noise of an imposed angle is taken off: the root of what is
        left of a constant.
    """
    rows, most, longest = colour.order.shape
    chosen = jnp.take_along_axis(residual, colour.order.reshape(rows, -1), axis=1)
    values = jnp.where(colour.weight > 0, chosen.reshape(rows, most, longest), 0.0)
    ar, factor = colour.ar[colour.which], colour.factor[colour.which]
    filtered = values * ar[:, None, :, 0]
    for lag in range(1, ar.shape[-1]):
        before = jnp.pad(values, ((0, 0), (0, 0), (lag, 0)))[..., :longest]
        filtered = filtered + before * ar[:, None, :, lag]

    def solve(past: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        value, row = inputs  # (rows, stretches), (rows, lags)
        white = (value - jnp.sum(past * row[:, None, 1:], axis=-1)) / row[:, None, 0]
        return jnp.concatenate([white[..., None], past[..., :-1]], axis=-1), white

    nothing = jnp.zeros((rows, most, factor.shape[-1] - 1))
    steps = jnp.moveaxis(filtered, -1, 0), jnp.moveaxis(factor, 1, 0)
    white = jnp.moveaxis(jax.lax.scan(solve, nothing, steps)[1], 0, -1)
    white = colour.weight * white
    white = white - colour.level * jnp.sum(colour.level * white, axis=-1, keepdims=True)
    if colour.excess is None:
        return white.ravel()
    excess, ceiling = colour.excess
    left = ceiling - theta[:3] @ excess @ theta[:3]
    return jnp.append(white.ravel(), jnp.sqrt(jnp.maximum(left, LEAST * ceiling)))
