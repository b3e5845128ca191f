"""Gravity on the moving segment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_STANDARD_GRAVITY = 9.81  # m/s2
_MOMENT, _POWER, _SPREAD = 21.0, 0.75, 1.0  # Nm at 1 kg m²; of the logarithm: a factor of e
_SHORTEST = 0.01
"""Length (m) of the simple pendulum that swings like the segment, I / (m l), below which there is
no segment: of a finger of 8 cm it is 5 cm, and an apparatus only adds inertia."""


class Gravity(Effect):
    r"""Gravity, as deviation from its torque at the operating point.

    .. math:: T = m g l\,[\sin(\theta_0 + \theta) - \sin\theta_0]

    theta_0 is the operating point, 0 where the segment hangs. It vanishes with m g l = 0.
    """

    key = "gravity"
    title = "gravity on the segment"
    place = "joint"
    linear = False
    confused_with = ("quadratic_stiffness", "cubic_stiffness")
    parameters = (
        Parameter(
            "moment",
            "mgl",
            "Nm",
            nominal=3.0,
            lower=0.0,
            upper=2000.0,
            null=0.0,
            description="weight of the segment times the distance of its centre from the joint",
        ),
        Parameter(
            "posture",
            r"\theta_0",
            "rad",
            nominal=0.5,
            lower=-3.2,
            upper=3.2,
            with_level=1,
            description="angle of the operating point from hanging down",
            ends_form=True,
        ),
    )
    references = ("Winter 2009, Biomechanics and Motor Control of Human Movement, ch. 5",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that at the operating point."""
        return p[0] * (jnp.sin(p[1] + motion.angle) - jnp.sin(p[1]))

    def pace(self, values: Mapping[str, float]) -> float:
        """Frequency [rad/s] of the segment as a pendulum."""
        return math.sqrt(values[f"{self.key}.moment"] / values["I"])

    def typical(self, values: Mapping[str, float]) -> Mapping[str, tuple[float, float]]:
        """Weight times distance of a segment of this inertia.

        About their proximal joints hand, forearm with hand, shank with foot, leg and body have
        0.42, 2.8, 14, 49 and 660 Nm at 0.0055, 0.074, 0.62, 3.3 and 71 kg m² (Winter 2009, tables
        4.1 and 3.1, of 75 kg and 1.75 m). A motor adds inertia without weight, a load both.
        """
        return {f"{self.key}.moment": (_MOMENT * values["I"] ** _POWER, _SPREAD)}

    def objection(self, values: Mapping[str, float]) -> str:
        """Whether the segment would be too short for its inertia."""
        length = _STANDARD_GRAVITY * values["I"] / max(values[f"{self.key}.moment"], 1e-12)
        if length >= _SHORTEST:
            return ""
        return (
            f"weight and inertia would be those of a pendulum of {1e3 * length:.2g} mm, "
            "shorter than any segment"
        )
