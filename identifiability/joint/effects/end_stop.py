"""A stop: bone, capsule or a rig's rubber, beyond which the joint is stiffer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class EndStop(Effect):
    r"""Stiffness that begins at an angle, on one side or on both.

    .. math::
        T = k\left[\frac{1 + a}{2}\, g(\theta - \theta_c) - \frac{1 - a}{2}\, g(\theta_c - \theta)
        \right], \qquad
        g(x) = \frac{1}{2}\left[\sqrt{(x - q)^2 + r^2} + x - \sqrt{q^2 + r^2}\right]

    beyond torque and stiffness at the operating point, which count as level and K. Beyond the angle
    q the joint is stiffer by k (1 + a) / 2 towards larger angles and by k (1 - a) / 2 towards
    smaller ones; r rounds the corner: up to a tenth of a radian it is passive tissue that stiffens
    towards the end of its range. In the plain form r = 2 mrad and theta_c = 0. It vanishes with
    k = 0.
    """

    key = "end_stop"
    title = "a stop (stiffer beyond an angle)"
    place = "joint"
    linear = False
    confused_with = ("cubic_stiffness", "quadratic_stiffness")
    parameters = (
        Parameter(
            "stiffness",
            "k",
            "Nm/rad",
            nominal=100.0,
            lower=0.0,
            upper=50000.0,
            null=0.0,
            description="stiffness beyond the stops, of both sides together",
        ),
        Parameter(
            "angle",
            "q",
            "rad",
            nominal=0.04,
            lower=0.001,
            upper=1.5,
            description="angle from the middle at which they begin",
        ),
        Parameter(
            "side",
            "a",
            "1",
            nominal=0.0,
            lower=-1.0,
            upper=1.0,
            description="1: on the side of larger angles alone, -1: of smaller ones, 0: on both",
            ends_form=True,
        ),
        Parameter(
            "rounding",
            "r",
            "rad",
            nominal=0.002,
            lower=0.0005,
            upper=0.1,
            plain=0.002,
            description="angle over which they begin",
            ends_form=True,
        ),
        Parameter(
            "middle",
            r"\theta_c",
            "rad",
            nominal=0.0,
            lower=-0.5,
            upper=0.5,
            plain=0.0,
            with_level=-1,
            description="angle midway between the stops, from the operating point",
        ),
    )
    references = (
        "Riener & Edrich 1999, J Biomech 32: 539-544 (passive torques at the ends of the range)",
        "Yoon & Mansour 1982, J Biomech 15: 905-911 (the passive elastic moment at the hip)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of the stiffness at the operating point."""
        stiffness, begin, side, rounding, middle = p
        angle = jnp.asarray(motion.angle)
        above = _beyond(angle, begin + middle, rounding)
        below = _beyond(-angle, begin - middle, rounding)
        return 0.5 * stiffness * ((1 + side) * above - (1 - side) * below)

    def pace(self, values: Mapping[str, float]) -> float:
        """Frequency [rad/s] to which the stops raise the joint."""
        return math.sqrt(values[f"{self.key}.stiffness"] / values["I"])


def _beyond(angle: Array, begin: Array, rounding: Array) -> Array:
    """How far an angle is beyond where a stop begins, less value and slope of that at 0."""
    at_rest = jnp.sqrt(begin**2 + rounding**2)
    here = jnp.sqrt((angle - begin) ** 2 + rounding**2)
    return 0.5 * (here - at_rest + angle * begin / at_rest)
