"""A spring and a damper in series, beside the joint: relaxation."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class MaxwellBranch(Effect):
    r"""Stiffness that relaxes: a spring in series with a damper, in parallel with K and B.

    .. math:: T = K_m (\theta - x), \qquad \dot x = (\theta - x) / \tau

    Together with K and B it has the same form as a linear tendon in series with a muscle that has a
    parallel damper: torque and angle alone cannot tell these apart. It vanishes with K_m = 0.
    """

    key = "maxwell_branch"
    title = "a relaxing (Maxwell) stiffness"
    place = "joint"
    linear = True
    n_states = 1
    confused_with = ("series_tendon", "activation_lag", "nonlinear_tendon")
    equivalent = ("series_tendon",)
    parameters = (
        Parameter(
            "stiffness",
            r"K_\mathrm{m}",
            "Nm/rad",
            nominal=20.0,
            lower=0.0,
            upper=20000.0,
            null=0.0,
            description="stiffness that relaxes",
        ),
        Parameter(
            "time_constant",
            r"\tau_\mathrm{m}",
            "s",
            nominal=0.03,
            lower=0.001,
            upper=1.0,
            description="time constant of the relaxation",
        ),
    )
    references = ("Fung 1993, Biomechanics: Mechanical Properties of Living Tissues, ch. 2",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the branch."""
        return p[0] * (motion.angle - states[0])

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Creep of the damper."""
        return jnp.reshape((motion.angle - states[0]) / p[1], (1,))
