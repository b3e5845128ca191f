"""Hysteresis that stiffens on reversal: what short-range stiffness is not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array

from identifiability.joint.effects.base import Motion
from identifiability.joint.effects.short_range_stiffness import ShortRangeStiffness
from identifiability.joint.parameters import Parameter


class StiffeningHysteresis(ShortRangeStiffness):
    r"""Hysteresis of Bouc and Wen beyond yielding: stiffer than elastic when the motion turns back.

    .. math:: \dot z = \dot\theta\,[1 - H(z \dot\theta)\,(|z| / z_c)^n
              - g\,H(-z \dot\theta)\,(|z| / z_c)^n] - r_s z, \qquad g \le 0

    In Bouc and Wen's terms :math:`g = (\gamma - \beta) / (\gamma + \beta)`. At g = 0 it is
    short-range stiffness, whose cross-bridges turn back elastically. As it names no mechanism of a
    joint it is not in the registry: the investigation holds it against short-range stiffness.
    """

    key = "stiffening_hysteresis"
    title = "a hysteresis that stiffens at every reversal (yielding cross-bridges do not)"
    confused_with = ("short_range_stiffness",)
    refines = ("short_range_stiffness",)
    parameters = (
        *ShortRangeStiffness.parameters,
        Parameter(
            "reversal",
            "g",
            "1",
            nominal=0.0,
            lower=-10.0,
            upper=0.0,
            plain=0.0,
            description="0: it turns back elastically; below, the more stiffly the more stretched",
        ),
    )
    references = (
        "Wen 1976, J Eng Mech Div ASCE 102: 249-263",
        "Erlicher & Point 2004, C R Mecanique 332: 51-57 (bounds of its shape)",
    )

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Stretch of the element."""
        back = jnp.where(states[0] * motion.velocity < 0, motion.velocity, 0.0)
        return super().rates(p, motion, states, delayed) - p[4] * back * self._yielding(p, states)

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate at which it yields or stiffens at 1 rad/s."""
        return super().pace(values) * (1 + abs(values[f"{self.key}.reversal"]))
