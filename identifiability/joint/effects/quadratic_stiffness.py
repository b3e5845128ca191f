"""Stiffness that changes with angle, in one sense."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import TYPICAL_ANGLE, Effect, Motion
from identifiability.joint.parameters import Parameter

_SERIES = 0.02  # of h theta, below which the closed form cancels


class QuadraticStiffness(Effect):
    r"""Stiffness that grows towards one side.

    .. math:: T = 2 K_2\,\frac{e^{h \theta} - 1 - h \theta}{h^2}, \qquad T = K_2\,\theta^2
              \text{ in the plain form, } h = 0

    The refined form is the exponential one of passive tissue. It vanishes with K_2 = 0.
    """

    key = "quadratic_stiffness"
    title = "a stiffness that grows towards one side (quadratic)"
    place = "joint"
    linear = False
    confused_with = ("gravity", "nonlinear_tendon", "hill_force_velocity", "sensor_drift")
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
        Parameter(
            "hardening",
            "h",
            "1/rad",
            nominal=0.0,
            lower=-20.0,
            upper=20.0,
            plain=0.0,
            description="relative growth of the stiffness' own slope with angle",
        ),
    )
    references = (
        "Weiss, Hunter & Kearney 1988, J Biomech 21: 539-544 (stiffness against torque and angle)",
        "Fung 1967, Am J Physiol 213: 1532-1544 (the exponential form)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] beyond that of a linear spring."""
        angle = jnp.asarray(motion.angle)
        grown = p[1] * angle
        small = jnp.abs(grown) < _SERIES
        large = jnp.where(small, 1.0, grown)
        closed = (jnp.expm1(large) - large) / large**2
        series = 0.5 + grown / 6 + grown**2 / 24 + grown**3 / 120 + grown**4 / 720
        return 2 * p[0] * angle**2 * jnp.where(small, series, closed)

    def pace(self, values: Mapping[str, float]) -> float:
        """Frequency [rad/s] to which the stiffness at a typical angle would raise the joint."""
        stiffening = 2 * abs(values[f"{self.key}.coefficient"]) * TYPICAL_ANGLE
        return math.sqrt(stiffening / values["I"])
