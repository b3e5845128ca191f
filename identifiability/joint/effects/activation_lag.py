"""Stiffness that arrives late: feedback through activation dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class ActivationLag(Effect):
    r"""Feedback of the angle through first-order activation dynamics, without delay.

    .. math:: T = G\,a, \qquad \dot a = (\theta - a) / \tau

    The same form as a Maxwell branch with the opposite sign: stiffness that builds up instead of
    relaxing. It vanishes with G = 0.
    """

    key = "activation_lag"
    title = "a stiffness that builds up with activation"
    place = "joint"
    linear = True
    n_states = 1
    confused_with = ("maxwell_branch", "stretch_reflex", "second_mass")
    parameters = (
        Parameter(
            "gain",
            "G_a",
            "Nm/rad",
            nominal=10.0,
            lower=0.0,
            upper=2000.0,
            null=0.0,
            description="stiffness that is added once activation has followed",
        ),
        Parameter(
            "time_constant",
            r"\tau_a",
            "s",
            nominal=0.04,
            lower=0.002,
            upper=1.0,
            description="time constant of activation",
        ),
    )
    references = ("Zajac 1989, Crit Rev Biomed Eng 17: 359-411 (activation dynamics)",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the activated muscle."""
        return p[0] * states[0]

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Activation follows the angle."""
        return jnp.reshape((motion.angle - states[0]) / p[1], (1,))
