"""Damping that is not the same in both directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class DampingByDirection(Effect):
    r"""Damping with a value of its own in each direction.

    .. math:: T = D\,(\sqrt{\dot\theta^2 + v_0^2} - v_0)

    It is B + D towards larger angles and B - D towards smaller ones; near rest, over v_0, it goes
    from one to the other. It vanishes with D = 0.
    """

    key = "damping_by_direction"
    title = "a damping that differs by direction"
    place = "joint"
    linear = False
    confused_with = ("damping_by_angle", "hill_force_velocity", "coulomb_friction")
    parameters = (
        Parameter(
            "difference",
            "D",
            "Nms/rad",
            nominal=0.5,
            lower=-250.0,
            upper=250.0,
            null=0.0,
            description="half of the difference between the dampings of both directions",
        ),
        Parameter(
            "velocity",
            "v_0",
            "rad/s",
            nominal=0.05,
            lower=0.002,
            upper=2.0,
            description="velocity over which it goes from one to the other",
            ends_form=True,
        ),
    )
    references = ("Dixon 2007, The Shock Absorber Handbook (bump and rebound of unequal damping)",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of the mean damping."""
        difference, smooth = p
        velocity = jnp.asarray(motion.velocity)
        return difference * velocity**2 / (jnp.sqrt(velocity**2 + smooth**2) + smooth)

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate [1/s] at which the difference would stop the joint."""
        return abs(values[f"{self.key}.difference"]) / values["I"]
