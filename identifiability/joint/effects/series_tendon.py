"""A linear tendon in series with the muscle."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.effects.bypass import BYPASS, bypass_torque
from identifiability.joint.parameters import Parameter


class SeriesTendon(Effect):
    r"""Elastic tendon between the contractile element and the skeleton.

    With it K and B become those of the contractile element, and the joint is the third-order
    musculoskeletal model of Kistemaker & Rozendaal (2011), Eq. 1:

    .. math:: Z(s) = \frac{(K + B s) K_{SE}}{K + B s + K_{SE}} + I s^2

    The tendon vanishes as its stiffness goes to infinity.

    Ligaments, capsule and skin act beside muscle and tendon: refined, it has such a path, of torque
    :math:`K_P\theta + B_P\dot\theta`. Behind a linear muscle no torque and angle tells it from K
    and B: the joint is then that of a Maxwell branch, which has a parameter less.
    """

    key = "series_tendon"
    title = "a tendon in series with the muscle"
    place = "series"
    linear = True
    confused_with = ("maxwell_branch", "nonlinear_tendon", "sensor_lowpass")
    equivalent = ("maxwell_branch",)
    parameters = (
        Parameter(
            "stiffness",
            r"K_\mathrm{SE}",
            "Nm/rad",
            nominal=200.0,
            lower=1.0,
            upper=20000.0,
            null=float("inf"),
            description="stiffness of the tendon as seen at the joint",
        ),
        *BYPASS,
    )
    references = ("Kistemaker & Rozendaal 2011, PLoS ONE 6(5): e19568, Eq. 1",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the tendon at a stretch of ``motion.angle`` rad."""
        return p[0] * motion.angle

    def bypass(self, p: Sequence[Array], motion: Motion) -> ArrayLike:
        """Torque [Nm] of what acts beside muscle and tendon."""
        return bypass_torque(p, motion)

    def refinable(self, others: Collection[Effect]) -> bool:
        """Whether something in the muscle tells a path beside it from the muscle's K and B."""
        return any(effect.place == "muscle" for effect in others)
