"""Exponential of a small matrix, and the phi functions of exponential integrators."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

_TERMS = 14


class Phi(NamedTuple):
    """Functions phi_0 = exp and phi_k(z) = sum over j of z^j / (j + k)!, for k = 1 to 3."""

    phi0: Array
    phi1: Array
    phi2: Array
    phi3: Array


def matrix_exponential(matrix: Array) -> Array:
    """Exponential of a small matrix by scaling and squaring of its Taylor series.

    The series has 14 terms after scaling to a 1-norm of at most 1/2, hence a relative truncation
    error below 1e-16. Unlike an eigendecomposition it needs no distinct eigenvalues, so critical
    damping is no special case, for derivatives neither.
    """
    squarings = _halvings(matrix)
    scaled = matrix * 2.0**-squarings
    identity = jnp.eye(matrix.shape[0])
    # As a loop, not unrolled: derivatives of derivatives of it compile in a third of the time.
    series = jax.lax.fori_loop(
        0, _TERMS, lambda k, s: identity + scaled @ s / (_TERMS - k), identity
    )

    def square(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        done, power = carry
        return done + 1, jnp.where(done < squarings, power @ power, power)

    # Under vmap the loop runs until the last member is done; `where` keeps the others as they are.
    start = (jnp.zeros(()), series)
    return jax.lax.while_loop(lambda carry: carry[0] < squarings, square, start)[1]


def phi_functions(matrix: Array) -> tuple[Phi, Phi]:
    """The phi functions of half a small matrix, and of the matrix.

    Taylor series of the scaled matrix and doubling formulas (Skaflestad & Wright 2009, Appl Numer
    Math 59: 783-799), which unlike the closed forms do not fail for singular matrices.

    Parameters
    ----------
    matrix : array, shape (n, n)

    Returns
    -------
    tuple of Phi
        Of ``matrix / 2`` and of ``matrix``.
    """
    half = 0.5 * matrix
    doublings = _halvings(half)
    scaled = half * 2.0**-doublings
    identity = jnp.eye(matrix.shape[0])
    phi3 = jax.lax.fori_loop(
        0, _TERMS, lambda k, s: identity + scaled @ s / (_TERMS + 3 - k), identity
    )
    phi3 = phi3 / 6.0
    phi2 = scaled @ phi3 + 0.5 * identity
    phi1 = scaled @ phi2 + identity
    start = Phi(scaled @ phi1 + identity, phi1, phi2, phi3)

    def twice(carry: tuple[Array, Phi]) -> tuple[Array, Phi]:
        done, small = carry
        large = _doubled(small)
        chosen = (jnp.where(done < doublings, n, o) for n, o in zip(large, small, strict=True))
        return done + 1, Phi(*chosen)

    halfway = jax.lax.while_loop(lambda c: c[0] < doublings, twice, (jnp.zeros(()), start))[1]
    return halfway, _doubled(halfway)


def _doubled(small: Phi) -> Phi:
    phi0, phi1, phi2, phi3 = small
    return Phi(
        phi0 @ phi0,
        (phi0 @ phi1 + phi1) / 2,
        (phi0 @ phi2 + phi1 + phi2) / 4,
        (phi0 @ phi3 + phi1 / 2 + phi2 + phi3) / 8,
    )


def _halvings(matrix: Array) -> Array:
    """How often a matrix must be halved for its 1-norm to be at most 1/2."""
    norm = jnp.max(jnp.sum(jnp.abs(jax.lax.stop_gradient(matrix)), axis=0))
    return jnp.clip(jnp.ceil(jnp.log2(jnp.clip(norm, 1e-300, 1e300) / 0.5)), 0, 60)
