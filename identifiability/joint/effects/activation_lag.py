"""Stiffness that arrives late: feedback through activation dynamics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.activation import approach, kink, off_ratio
from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class ActivationLag(Effect):
    r"""Feedback of the angle through first-order activation dynamics, without delay.

    Each muscle of an antagonist pair answers its own stretch:

    .. math:: T = a_+ - a_-, \qquad \tau_\pm \dot a_\pm = G \max(\pm\theta, 0) - a_\pm

    with a longer time constant where activation falls than where it rises. In its plain form, as
    fast off as on, this is linear, and the same as a Maxwell branch with the opposite sign:
    stiffness that builds up instead of relaxing. It vanishes with G = 0.
    """

    key = "activation_lag"
    title = "a stiffness that builds up with activation"
    place = "joint"
    linear = False
    n_states = 2
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
        off_ratio(r"\rho_a"),
    )
    references = (
        "Zajac 1989, Crit Rev Biomed Eng 17: 359-411 (activation dynamics)",
        "Thelen 2003, J Biomech Eng 125: 70-77 (activation and deactivation)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the activated muscles, their difference."""
        return states[0] - states[1]

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Activation follows the stretch."""
        gain, tau, ratio = p
        angle = jnp.asarray(motion.angle)
        stretch = jnp.stack([jnp.maximum(angle, 0.0), jnp.maximum(-angle, 0.0)])
        return approach(gain * stretch - states, tau, ratio)

    def pace(self, values: Mapping[str, float]) -> float:
        """Difference between the rates of activation and deactivation."""
        return kink(self.key, values)
