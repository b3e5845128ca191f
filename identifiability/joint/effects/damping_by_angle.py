"""Damping that is not the same at every angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter


class DampingByAngle(Effect):
    r"""Damping that goes from one value to another as the angle grows.

    .. math::
        T = \Delta B\, [s(\theta - \theta_c) - s(-\theta_c)]\, \dot\theta, \qquad
        s(x) = \frac{1}{2} \left(1 + \frac{x}{\sqrt{x^2 + w^2}}\right)

    B is the damping at the operating point. The damping of a damper that is met on the way goes
    within a small width w; over a large one it grows in proportion to the angle. It vanishes with
    a difference of 0.
    """

    key = "damping_by_angle"
    title = "a damping that changes with the angle"
    place = "joint"
    linear = False
    confused_with = ("damping_by_direction", "hill_force_velocity", "quadratic_stiffness")
    parameters = (
        Parameter(
            "difference",
            r"\Delta B",
            "Nms/rad",
            nominal=1.0,
            lower=-500.0,
            upper=500.0,
            null=0.0,
            description="damping at large angles beyond that at small (negative) ones",
        ),
        Parameter(
            "width",
            "w",
            "rad",
            nominal=0.03,
            lower=0.001,
            upper=1.0,
            description="angle over which it changes",
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
            description="angle at which it is halfway, from the operating point",
        ),
    )
    references = (
        "Weiss, Kearney & Hunter 1986, J Biomech 19: 727-735 (ankle damping against position)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of the damping at the operating point."""
        difference, width, middle = p
        angle = jnp.asarray(motion.angle)
        share = 0.5 * (_way(angle - middle, width) + _way(middle, width))
        return difference * share * motion.velocity

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate [1/s] at which the difference would stop the joint."""
        return abs(values[f"{self.key}.difference"]) / values["I"]


def _way(angle: Array, width: Array) -> Array:
    """From -1 to 1."""
    return angle / jnp.sqrt(angle**2 + width**2)
