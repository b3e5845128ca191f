"""A tendon that stiffens under stretch, in series with the muscle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.effects.bypass import BYPASS, bypass_torque
from identifiability.joint.parameters import Parameter

_TYPICAL_VELOCITY = 1.0  # rad/s
_TYPICAL = 0.05  # rad, a stretch that tendons undergo
_HARDENING = 30.0
"""Spread [1/rad]: the toe's 100 to 150 by strain (Zajac 1989) times moment arm over slack length is
25, 16, 18, 15, 8 and 4 of soleus, gastrocnemius, biceps, triceps, wrist and finger."""


class NonlinearTendon(Effect):
    r"""Tendons of an antagonist pair, each exponential in its stretch, seen as one at the joint.

    .. math:: T(x) = K_{SE}\left[\frac{\sinh h x}{h} + a\,\frac{\cosh h x - 1}{h}\right]

    with the stretch x = theta - theta_CE. The asymmetry a is 1 or -1 for a single muscle and 0 for
    a balanced pair; with h = 0 it is the linear tendon. It vanishes with infinite stiffness.

    Ligaments, capsule and skin act beside muscle and tendon: refined, it has such a path, of torque
    :math:`K_P\theta + B_P\dot\theta`.
    """

    key = "nonlinear_tendon"
    title = "a tendon that stiffens with stretch"
    place = "series"
    linear = False
    confused_with = (
        "series_tendon",
        "quadratic_stiffness",
        "hill_force_velocity",
        "maxwell_branch",
    )
    refines = ("series_tendon",)
    parameters = (
        Parameter(
            "stiffness",
            r"K_\mathrm{SE}",
            "Nm/rad",
            nominal=200.0,
            lower=1.0,
            upper=20000.0,
            null=float("inf"),
            description="stiffness of the tendon at the operating point",
        ),
        Parameter(
            "hardening",
            "h",
            "1/rad",
            nominal=10.0,
            lower=0.0,
            upper=60.0,
            spread=_HARDENING,
            description="relative growth of tension with stretch",
        ),
        Parameter(
            "asymmetry",
            "a",
            "1",
            nominal=0.0,
            lower=-1.0,
            upper=1.0,
            description="difference between the two muscles' tendons",
            ends_form=True,
        ),
        *BYPASS,
    )
    references = (
        "Zajac 1989, Crit Rev Biomed Eng 17: 359-411 (exponential toe of the tendon)",
        "Millard, Uchida, Seth & Delp 2013, J Biomech Eng 135: 021005",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the tendons at a stretch of ``motion.angle`` rad."""
        stiffness, hardening, asymmetry = p[:3]
        # Powers of e beyond 30 are no tendon, but an optimiser may ask for them.
        exponent = jnp.clip(hardening * motion.angle, -30.0, 30.0)
        odd, even = _sinhc(exponent), jnp.sinh(0.5 * exponent) * _sinhc(0.5 * exponent)
        return stiffness * motion.angle * (odd + asymmetry * even)

    def bypass(self, p: Sequence[Array], motion: Motion) -> ArrayLike:
        """Torque [Nm] of what acts beside muscle and tendon."""
        return bypass_torque(p, motion)

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate by which a typical stretch quickens the muscle behind the tendon.

        The tendon bears what the muscle does: the stiffer it is the less it is stretched.
        """
        stiffness, hardening = values[f"{self.key}.stiffness"], values[f"{self.key}.hardening"]
        borne = values["K"] * _TYPICAL + values["B"] * _TYPICAL_VELOCITY
        stretch = min(_TYPICAL, borne / stiffness)
        hardened = math.cosh(min(hardening * stretch, 30.0)) - 1
        return hardened * stiffness / max(values["B"], 1e-9)


def _sinhc(x: Array) -> Array:
    """sinh(x)/x, with its derivatives also at 0."""
    small = jnp.abs(x) < 1e-3
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 + x**2 / 6 + x**4 / 120, jnp.sinh(safe) / safe)
