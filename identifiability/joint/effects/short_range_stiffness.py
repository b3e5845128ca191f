"""Short-range stiffness: cross-bridges that stretch, then slip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_TINY = 1e-6  # share of the limit below which nothing yields: its logarithm stays finite


class ShortRangeStiffness(Effect):
    r"""Elastic-plastic stiffness: elastic for small motion, yielding beyond it.

    .. math:: T = K_s z, \qquad
              \dot z = \dot\theta\,[1 - H(z \dot\theta)\,(|z| / z_c)^n] - r_s z

    z is the stretch of the attached cross-bridges. While it grows (H is the unit step) they yield,
    the more suddenly the larger the sharpness n, and z cannot pass z_c; when the motion turns back
    they are elastic again. r_s is the rate at which they renew at rest (0 in the plain form). It is
    the hysteresis of Bouc and Wen with beta = gamma, and vanishes with K_s = 0.
    """

    key = "short_range_stiffness"
    title = "short-range stiffness"
    place = "muscle"
    linear = False
    n_states = 1
    confused_with: ClassVar[tuple[str, ...]] = (
        "coulomb_friction",
        "hill_force_velocity",
        "cubic_stiffness",
        "maxwell_branch",
    )
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "stiffness",
            r"K_\mathrm{s}",
            "Nm/rad",
            nominal=20.0,
            lower=0.0,
            upper=5000.0,
            null=0.0,
            description="stiffness for small motion",
        ),
        Parameter(
            "range",
            r"z_\mathrm{c}",
            "rad",
            nominal=0.03,
            lower=0.005,
            upper=0.5,
            description="stretch at which it yields",
        ),
        Parameter(
            "sharpness",
            "n",
            "1",
            nominal=2.0,
            lower=1.0,
            upper=10.0,
            plain=2.0,
            description="suddenness of the yielding",
        ),
        Parameter(
            "renewal",
            r"r_\mathrm{s}",
            "1/s",
            nominal=0.0,
            lower=0.0,
            upper=200.0,
            plain=0.0,
            description="rate at which the stretch is forgotten at rest",
        ),
    )
    references: ClassVar[tuple[str, ...]] = (
        "Rack & Westbury 1974, J Physiol 240: 331-350",
        "De Groote, Allen & Ting 2017, J Biomech 55: 71-77",
        "Wen 1976, J Eng Mech Div ASCE 102: 249-263 (the elastic-plastic form)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the stretched cross-bridges."""
        return p[0] * states[0]

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Stretch of the cross-bridges."""
        stretch = states[0]
        growing = jnp.where(stretch * motion.velocity > 0, motion.velocity, 0.0)
        change = motion.velocity - growing * self._yielding(p, states) - p[3] * stretch
        return jnp.reshape(change, (1,))

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate at which the cross-bridges yield at 1 rad/s."""
        return values[f"{self.key}.sharpness"] / values[f"{self.key}.range"]

    @staticmethod
    def _yielding(p: Sequence[Array], states: Array) -> Array:
        """Share of the motion that the stretch does not follow while it grows."""
        # A step may end a little beyond the limit, from where it shall not be thrown back.
        return jnp.clip(jnp.abs(states[0]) / p[1], _TINY, 1.0) ** p[2]
