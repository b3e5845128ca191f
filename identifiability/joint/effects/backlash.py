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

_TINY = 1e-6  # rad: a contact comes over this much where there is no gap
_SHUT = 2e-4  # rad: of a gap much smaller than this both sides touch at once, and hold the limb
_CLEAR = 5.0  # standard deviations of a recorded angle that a gap must have, to be seen in it


class Backlash(SoftCoupling):
    r"""Play of handle, cuff or gear: a link with a gap.

    .. math::
        T = k\,(P(s + s_0, \dot s) - P(-s - s_0, -\dot s) - T_0), \qquad
        P(x, v) = \max(c,\, \alpha c), \quad
        c = d(x - g) + \tau\, d'(x - g)\, v, \quad s_0 = p\,g

    with the bodies of a soft coupling, which it is without its gap g to either side. Either side
    pushes and does not pull, but for a part alpha of its damping where it is sticky. It is pressed
    by d, which is 0 up to -r, the stretch beyond the gap from r on, and smooth between: r is a part
    rho of the gap, a tenth in the plain form. At the operating point, where the link carries T_0,
    it is s_0 away from the middle of its play: less than the gap where the limb hangs free, more
    where gravity or muscle press it against one side. Play vanishes with the gap, for of one much
    smaller than 0.2 mrad both sides hold at once, and with it the link as its stiffness goes to
    infinity.
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
            "stickiness",
            r"\alpha",
            "1",
            nominal=0.0,
            lower=0.0,
            upper=1.0,
            plain=0.0,
            description="part of the damping that pulls where the contact opens",
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
        stiffness, time, _, gap, rounding, stickiness, place = p
        at_rest, width, rate = place * gap, rounding * gap + _TINY, time * motion.velocity
        pulls = 1 - (1 - stickiness) * gap**2 / (gap**2 + _SHUT**2)

        def contact(stretch: Array, rate: Array | float) -> Array:
            ahead = _push(stretch - gap, rate, width, pulls)
            return ahead - _push(-stretch - gap, -rate, width, pulls)

        return stiffness * (
            contact(jnp.asarray(motion.angle) + at_rest, rate) - contact(at_rest, 0.0)
        )

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


def _push(beyond: ArrayLike, rate: ArrayLike, width: Array, pulls: Array) -> Array:
    """Push of one side of a gap, over the link's stiffness, from the stretch beyond the gap."""
    u = jnp.clip(beyond / width, -1.0, 1.0)
    # A cubic's slope from 0 to 1: smooth to the second derivative, and 0 inside the gap.
    depth = width * (1 + u) ** 3 * (3 - u) / 16 + jnp.maximum(beyond - width, 0.0)
    push = depth + (1 + u) ** 2 * (2 - u) / 4 * rate
    return jnp.maximum(push, pulls * push)
