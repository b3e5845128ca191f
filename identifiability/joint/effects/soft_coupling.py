"""A link that gives, between what is driven and measured and the limb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

LINK = (
    Parameter(
        "stiffness",
        "k",
        "Nm/rad",
        nominal=500.0,
        lower=1.0,
        upper=1e5,
        null=float("inf"),
        description="stiffness of the link",
    ),
    Parameter(
        "time",
        r"\tau",
        "s",
        nominal=0.002,
        lower=5e-5,
        upper=0.05,
        description="damping of the link over its stiffness",
    ),
    Parameter(
        "share",
        "h",
        "1",
        nominal=0.2,
        lower=0.01,
        # With all inertia before it, it would be a tendon.
        upper=0.6,
        description="part of the inertia I that is before the link: of handle, footplate or motor",
        ends_form=True,
    ),
)
"""Parameters of a link, and of what is before it."""

_STIFFER, _SPREAD = 10.0, 0.8


class SoftCoupling(Effect):
    r"""Compliance of cuff, fixture or soft tissue before the limb.

    .. math::
        h I \ddot\theta + T = \text{torque}, \qquad T = k\,(s + \tau \dot s), \qquad
        s = \theta - \theta_2, \qquad (1 - h)\, I\, \ddot\theta_2 = T - T_\mathrm{limb}

    The angle is that of the body before the link, with the part h of the inertia I; K, B and all
    other effects are the limb's behind it. The link vanishes as its stiffness goes to infinity.
    """

    key = "soft_coupling"
    title = "a compliant cuff or fixture before the limb"
    place = "coupling"
    linear = True
    confused_with: ClassVar[tuple[str, ...]] = (
        "second_mass",
        "series_tendon",
        "maxwell_branch",
        "stretch_reflex",
        "backlash",
    )
    parameters: ClassVar[tuple[Parameter, ...]] = LINK
    references = (
        "Spong 1987, J Dyn Syst Meas Control 109: 310-318 (two inertias and the spring between)",
    )

    def before(self, p: Sequence[Array]) -> ArrayLike:
        """Share of the inertia that is driven and measured."""
        return p[2]

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the link at a stretch of ``motion.angle`` rad."""
        return p[0] * (motion.angle + p[1] * motion.velocity)

    def typical(self, values: Mapping[str, float]) -> Mapping[str, tuple[float, float]]:
        """Stiffness of a link that is there to move the limb.

        Nineteen in twenty are twice to fifty times as stiff as the joint behind. Two bodies of any
        stiffness are what a muscle with its tendon and its reflex look like.
        """
        return {f"{self.key}.stiffness": (_STIFFER * max(values["K"], 1e-9), _SPREAD)}

    def objection(self, values: Mapping[str, float]) -> str:
        """Whether the link would be softer than the joint behind it."""
        if values[f"{self.key}.stiffness"] >= values["K"]:
            return ""
        return "the link would be softer than the joint behind it, as no cuff or fixture is"
