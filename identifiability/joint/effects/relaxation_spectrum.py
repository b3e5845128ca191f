"""Several relaxing branches: passive memory that has no one pace."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_PACES = ((0.002, 0.007, 0.02), (0.02, 0.05, 0.12), (0.12, 0.35, 1.0))


def _branch(n: int, pace: tuple[float, float, float]) -> tuple[Parameter, Parameter]:
    shortest, nominal, longest = pace
    return (
        Parameter(
            f"stiffness_{n}",
            f"K_{n}",
            "Nm/rad",
            nominal=10.0,
            lower=0.0,
            upper=20000.0,
            null=0.0,
            description=f"stiffness that relaxes within {longest:g} s",
        ),
        Parameter(
            f"time_constant_{n}",
            rf"\tau_{n}",
            "s",
            nominal=nominal,
            lower=shortest,
            upper=longest,
            description="time constant of that relaxation",
        ),
    )


class RelaxationSpectrum(Effect):
    r"""Generalised Maxwell (Wiechert) body: three relaxing branches beside K and B.

    .. math:: T = \sum_{j=1}^3 K_j (\theta - x_j), \qquad \dot x_j = (\theta - x_j) / \tau_j

    It describes soft tissue, whose relaxation has no one time constant, and comes near any passive
    linear memory, fractional damping included. As it names no mechanism it is not in the registry:
    the investigation holds it against two mechanisms whose sum may be no more than this. It
    vanishes with all stiffnesses 0.
    """

    key = "relaxation_spectrum"
    title = "relaxation at several paces (soft tissue, fractional damping)"
    place = "joint"
    linear = True
    n_states = 3
    confused_with = (
        "maxwell_branch",
        "series_tendon",
        "nonlinear_tendon",
        "activation_lag",
        "stretch_reflex",
        "second_mass",
    )
    refines = ("maxwell_branch",)
    parameters = tuple(p for n, pace in enumerate(_PACES, 1) for p in _branch(n, pace))
    references = ("Fung 1993, Biomechanics: Mechanical Properties of Living Tissues, ch. 2 and 7",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the branches."""
        return jnp.sum(jnp.stack(p[::2]) * (motion.angle - states))

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Creep of the dampers."""
        return jnp.asarray((motion.angle - states) / jnp.stack(p[1::2]))
