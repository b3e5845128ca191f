"""Stiffness that changes with angle, in one sense."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class QuadraticStiffness(Effect):
    r"""Stiffness that grows towards one side: T = K_2 theta^2; vanishes with K_2 = 0."""

    key = "quadratic_stiffness"
    title = "a stiffness that grows towards one side (quadratic)"
    place = "joint"
    linear = False
    confused_with = ("gravity", "hill_force_velocity", "sensor_drift")
    parameters = (
        Parameter(
            "coefficient",
            "K_2",
            "Nm/rad²",
            nominal=10.0,
            lower=-20000.0,
            upper=20000.0,
            null=0.0,
            description="torque per squared angle",
        ),
    )
    references = (
        "Weiss, Hunter & Kearney 1988, J Biomech 21: 539-544 (stiffness against torque and angle)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of a linear spring."""
        return p[0] * jnp.asarray(motion.angle) ** 2
