"""Stiffness that changes with angle, alike on both sides."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import TYPICAL_ANGLE, Effect, Motion
from identifiability.joint.parameters import Parameter


class CubicStiffness(Effect):
    r"""Stiffness that grows to both sides of an angle.

    .. math:: T = K_3\,\theta^2 (\theta - 3 \theta_c), \qquad T = K_3\,\theta^3
              \text{ in the plain form, } \theta_c = 0

    what is left of :math:`K_3 (\theta - \theta_c)^3` when its torque and stiffness at the operating
    point count as level and K. It vanishes with K_3 = 0.
    """

    key = "cubic_stiffness"
    title = "a stiffness that grows with the angle (cubic)"
    place = "joint"
    linear = False
    confused_with = ("short_range_stiffness", "gravity", "end_stop")
    parameters = (
        Parameter(
            "coefficient",
            "K_3",
            "Nm/rad³",
            nominal=50.0,
            lower=-20000.0,
            upper=200000.0,
            null=0.0,
            description="torque per cubed angle",
        ),
        Parameter(
            "centre",
            r"\theta_c",
            "rad",
            nominal=0.0,
            lower=-0.5,
            upper=0.5,
            plain=0.0,
            with_level=-1,
            description="angle about which it grows, from the operating point",
        ),
    )
    references = (
        "Kovacic & Brennan 2011, The Duffing Equation: Nonlinear Oscillators and their Behaviour",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of a linear spring."""
        angle = jnp.asarray(motion.angle)
        return p[0] * angle**2 * (angle - 3 * p[1])

    def pace(self, values: Mapping[str, float]) -> float:
        """Frequency [rad/s] to which the stiffness at a typical angle would raise the joint."""
        stiffening = 3 * abs(values[f"{self.key}.coefficient"]) * TYPICAL_ANGLE**2
        return math.sqrt(stiffening / values["I"])
