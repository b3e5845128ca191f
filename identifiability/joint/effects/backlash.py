"""Play between what is driven and measured and the limb."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Motion
from identifiability.joint.effects.soft_coupling import LINK, SoftCoupling
from identifiability.joint.parameters import Parameter

_TINY = 1e-6  # rad: keeps the slope finite where there is no gap
_CLEAR = 5.0  # standard deviations of a recorded angle that a gap must have, to be seen in it


class Backlash(SoftCoupling):
    r"""Play of handle, cuff or gear: a link with a gap.

    .. math::
        T = k\,(\sigma(s + s_0) - \sigma(s_0) + \tau\, \sigma'(s + s_0)\, \dot s), \qquad
        \sigma(x) = x + \frac{1}{2}\left[\sqrt{(x - g)^2 + r^2} - \sqrt{(x + g)^2 + r^2}\right],
        \qquad r = \rho g, \quad s_0 = p\,g

    with the bodies of a soft coupling, which it is without its gap g to either side. Contact comes
    over a part of the gap, a tenth in the plain form. At the operating point the link is s_0 away
    from the middle of its play: less than the gap where the limb hangs free, more where gravity or
    muscle press it against one side. Play vanishes with the gap, and with it the link as its
    stiffness goes to infinity.
    """

    key = "backlash"
    title = "play (backlash) before the limb"
    linear = False
    confused_with = ("second_mass", "soft_coupling", "coulomb_friction")
    refines = ("soft_coupling",)
    parameters = (
        *LINK[:2],
        # Lighter bodies bounce faster than steps of a sample follow.
        replace(LINK[2], lower=0.05),
        Parameter(
            "gap",
            "g",
            "rad",
            nominal=0.01,
            lower=0.0,
            upper=0.1,
            null=0.0,
            description="play to either side",
        ),
        Parameter(
            "rounding",
            r"\rho",
            "1",
            nominal=0.1,
            lower=0.02,
            upper=1.0,
            plain=0.1,
            description="stretch over which the contact comes, over the gap",
            ends_form=True,
        ),
        Parameter(
            "place",
            "p",
            "1",
            nominal=0.0,
            lower=-4.0,
            upper=4.0,
            description="stretch of the link at the operating point, from the middle, over the gap",
        ),
    )
    references = (
        "Nordin & Gutman 2002, Automatica 38: 1633-1649 (mechanical systems with backlash)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the link at a stretch of ``motion.angle`` rad."""
        stiffness, time, _, gap, rounding, place = p
        at_rest, width = place * gap, rounding * gap
        pressed, touch = _pressed(motion.angle + at_rest, gap, width)
        beyond = pressed - _pressed(at_rest, gap, width)[0]
        return stiffness * (beyond + time * touch * motion.velocity)

    def pace(self, values: Mapping[str, float]) -> float:
        """Fastest rate [1/s] of the two bodies in contact."""
        stiffness, time, share = (values[f"{self.key}.{p.name}"] for p in LINK)
        omega = math.sqrt(stiffness / (values["I"] * share * (1 - share)))
        return omega * (1 + time * omega)

    def blurred(self, values: Mapping[str, float], noise: float) -> str:
        """Whether the gap is no larger than the noise: it then only hides it from the joint."""
        gap = values[f"{self.key}.gap"]
        if gap >= _CLEAR * noise:
            return ""
        return (
            f"a gap of {1e3 * gap:.2g} mrad would be no play, but hide the noise of the angle, of "
            f"{1e3 * noise:.2g} mrad"
        )


def _pressed(stretch: ArrayLike, gap: Array, rounding: Array) -> tuple[Array, Array]:
    """How far a link is pressed beyond its gap, and its slope."""
    stretch, corner = jnp.asarray(stretch), rounding**2 + _TINY**2
    ahead = jnp.sqrt((stretch - gap) ** 2 + corner)
    behind = jnp.sqrt((stretch + gap) ** 2 + corner)
    pressed = stretch + 0.5 * (ahead - behind)
    return pressed, 1 + 0.5 * ((stretch - gap) / ahead - (stretch + gap) / behind)
