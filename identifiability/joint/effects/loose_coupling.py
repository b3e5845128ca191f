"""Play: a body that is driven, and behind a gap the limb with its own stiffness and damping."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.effects.second_mass import SecondMass
from identifiability.joint.parameters import Parameter

_TINY = 1e-6  # rad: keeps the slope finite where there is no gap


class LooseCoupling(Effect):
    r"""Second body behind a gap, with stiffness and damping of its own.

    .. math::
        T = I_2\,[\omega^2 \sigma(s) + 2 \zeta \omega\, |s| / r\; \dot s], \qquad
        s = \theta - \theta_2, \quad r = \sqrt{s^2 + g^2}, \quad
        \sigma = \operatorname{sgn}(s)\,(r - g),

    .. math:: I_2 \ddot\theta_2 = T - I_2\,(\kappa\,\theta_2 + \beta\,\dot\theta_2)

    Contact comes gradually within the gap g and is that of a spring beyond it. Without gap and
    stiffness of its own it is a second mass. Play of a handle or cuff, in a gear or in the joint
    all have this form: as it names no one of them it is not in the registry, and the investigation
    holds it against a second mass. It vanishes with I_2 = 0.
    """

    key = "loose_coupling"
    title = "play between what is driven and the limb"
    place = "joint"
    linear = False
    n_states = 2
    confused_with = ("second_mass",)
    refines = ("second_mass",)
    parameters = (
        SecondMass.parameters[0],
        # A contact that is not linear is stepped explicitly: no faster than steps of 1 ms follow.
        replace(SecondMass.parameters[1], upper=30.0),
        replace(SecondMass.parameters[2], upper=0.3),
        Parameter(
            "gap",
            "g",
            "rad",
            nominal=0.0,
            lower=0.0,
            upper=0.1,
            plain=0.0,
            description="stretch within which the contact comes",
        ),
        Parameter(
            "own_stiffness",
            r"\kappa",
            "1/s²",
            nominal=0.0,
            lower=0.0,
            upper=2e4,
            plain=0.0,
            description="stiffness that holds the second body, over its inertia",
        ),
        Parameter(
            "own_damping",
            r"\beta",
            "1/s",
            nominal=0.0,
            lower=0.0,
            upper=300.0,
            plain=0.0,
            description="damping that holds the second body, over its inertia",
        ),
    )
    references = (
        "Nordin & Gutman 2002, Automatica 38: 1633-1649 (mechanical systems with backlash)",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] of the contact."""
        return p[0] * self._contact(p, motion, states)

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Motion of the second body."""
        held = p[4] * states[0] + p[5] * states[1]
        return jnp.stack([states[1], self._contact(p, motion, states) - held])

    def pace(self, values: Mapping[str, float]) -> float:
        """Frequency [rad/s] of the two bodies in contact, with its damping."""
        inertia, frequency, damping = (values[f"{self.key}.{p.name}"] for p in self.parameters[:3])
        omega = 2 * math.pi * frequency * math.sqrt(1 + inertia / values["I"])
        return omega * (1 + 2 * damping)

    @staticmethod
    def _contact(p: Sequence[Array], motion: Motion, states: Array) -> Array:
        """Torque of the contact over the second body's inertia."""
        omega, damping, gap = 2 * jnp.pi * p[1], p[2], p[3]
        stretch, slip = motion.angle - states[0], motion.velocity - states[1]
        reach = jnp.sqrt(stretch**2 + gap**2 + _TINY**2)
        touch = jnp.abs(stretch) / reach
        # (r - g) sgn(s) without a corner at s = 0
        pressed = stretch * jnp.abs(stretch) / (reach + gap)
        return omega * (omega * pressed + 2 * damping * touch * slip)
