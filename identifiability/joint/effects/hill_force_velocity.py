"""Hill's force-velocity relation: damping that saturates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_CURVATURE = 0.25  # a/F0 of Hill's hyperbola
_PLATEAU = 0.4  # extra force of a fast lengthening muscle, in units of its isometric force


def _force_change(velocity: ArrayLike) -> Array:
    """Force of a muscle lengthened at a velocity in units of its fastest shortening, minus 1."""
    shortening = jnp.minimum(velocity, 0.0)
    lengthening = jnp.maximum(velocity, 0.0)
    slope = 1 + 1 / _CURVATURE  # the two branches meet with one slope
    concentric = slope * shortening / (1 - shortening / _CURVATURE)
    eccentric = _PLATEAU * lengthening / (lengthening + _PLATEAU / slope)
    return jnp.asarray(concentric + eccentric)


class HillForceVelocity(Effect):
    r"""Force-velocity relation of an antagonist pair of muscles (Hill's hyperbola).

    .. math:: T = \tfrac{1}{2} T_0 \left[(1+a) f(\dot\theta/v_m) - (1-a) f(-\dot\theta/v_m)\right]

    where f(w) is what a muscle's force changes by, in units of its isometric force, when it
    lengthens at w maximal shortening velocities: the hyperbola (1+w)/(1-4w) - 1 in shortening, a
    plateau of 0.4 in lengthening, one slope at rest. Damping falls with velocity; with a pair that
    is not balanced it also depends on direction. It vanishes with T0 = 0.
    """

    key = "hill_force_velocity"
    title = "Hill's force-velocity relation (damping that saturates)"
    place = "muscle"
    linear = False
    affine_in_velocity = False
    confused_with = ("coulomb_friction", "nonlinear_tendon", "quadratic_stiffness")
    parameters = (
        Parameter(
            "strength",
            "T_0",
            "Nm",
            nominal=5.0,
            lower=0.0,
            upper=500.0,
            null=0.0,
            description="isometric torque of the two muscles together",
        ),
        Parameter(
            "max_velocity",
            "v_m",
            "rad/s",
            nominal=15.0,
            lower=0.5,
            upper=200.0,
            description="joint velocity at which the muscles shorten as fast as they can",
        ),
        Parameter(
            "asymmetry",
            "a_H",
            "1",
            nominal=0.0,
            lower=-1.0,
            upper=1.0,
            plain=0.0,
            description="difference between the two muscles' torques over their sum",
        ),
    )
    references = (
        "Hill 1938, Proc R Soc B 126: 136-195",
        "Katz 1939, J Physiol 96: 45-64 (lengthening)",
        "Zajac 1989, Crit Rev Biomed Eng 17: 359-411",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the two muscles beyond their isometric balance."""
        strength, fastest, asymmetry = p
        velocity = motion.velocity / fastest
        stretched, shortened = _force_change(velocity), _force_change(-velocity)
        return 0.5 * strength * ((1 + asymmetry) * stretched - (1 - asymmetry) * shortened)

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate of the damping at rest, which a fast motion takes away."""
        strength, fastest = values[f"{self.key}.strength"], values[f"{self.key}.max_velocity"]
        return strength * (1 + 1 / _CURVATURE) / (fastest * values["I"])
