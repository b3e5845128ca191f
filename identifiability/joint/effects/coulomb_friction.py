"""Dry friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_STRIBECK_VELOCITY = 0.1  # [rad/s]
_RATE = 1000.0  # [1/s] beyond which the contact counts as sliding steadily
_STILL = 1e-3  # of the smoothing velocity, below which a quotient is its limit


class CoulombFriction(Effect):
    r"""Dry friction: a contact that gives a little, then slides under constant torque.

    .. math:: T = F w\,(1 + a w)\,(1 + s\,e^{-(\dot\theta/0.1)^2}), \quad
              w = \frac{z + \tau \dot z}{z_0}, \quad
              \dot z = \dot\theta\left[1 - \frac{z}{z_0 \tanh(\dot\theta/v_0)}\right]

    with w between -1 and 1. The contact's deflection z remembers which way the joint went, so at
    rest friction holds what it held (Dahl; with the damping tau, LuGre), but for a creep at less
    than v_0. With z_0 = 0 it is F tanh(velocity / v_0); what would yield faster than in 1 ms is
    taken for that. More breaks away than slides by s (Stribeck); with a it is not the same in both
    directions: while the joint moves it feels the constant F a as well, which under an imposed
    angle is the torque's level. tau = s = a = 0 in the plain form. It vanishes with F = 0.
    """

    key = "coulomb_friction"
    title = "dry (Coulomb) friction"
    place = "joint"
    linear = False
    n_states = 1
    confused_with = ("short_range_stiffness", "hill_force_velocity")
    parameters = (
        Parameter(
            "torque",
            "F",
            "Nm",
            nominal=0.2,
            lower=0.0,
            upper=100.0,
            null=0.0,
            description="friction torque while sliding",
        ),
        Parameter(
            "velocity",
            "v_0",
            "rad/s",
            nominal=0.003,
            lower=1e-5,
            upper=0.3,
            description="velocity over which friction reverses",
            ends_form=True,
        ),
        Parameter(
            "range",
            "z_0",
            "rad",
            nominal=0.0005,
            lower=2e-5,
            upper=0.005,
            description="how far the contact gives before it slides",
            ends_form=True,
        ),
        Parameter(
            "damping",
            r"\tau",
            "s",
            nominal=0.0,
            lower=0.0,
            upper=2.0,
            plain=0.0,
            description="damping of the contact over its stiffness",
        ),
        Parameter(
            "breakaway",
            "s",
            "1",
            nominal=0.0,
            lower=0.0,
            upper=2.0,
            plain=0.0,
            description="friction at breaking away over that while sliding, minus 1",
        ),
        Parameter(
            "asymmetry",
            "a",
            "1",
            nominal=0.0,
            lower=-0.6,
            upper=0.6,
            plain=0.0,
            description="difference between the frictions of both directions over their sum",
        ),
    )
    references = (
        "Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30: 1083-1138",
        "Dahl 1976, AIAA J 14: 1675-1682",
        "Canudas de Wit, Olsson, Åström & Lischinsky 1995, IEEE Trans Autom Control 40: 419-425",
    )

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] against the velocity."""
        force, smooth, give, damping, breakaway, asymmetry = p
        share, change = self._contact(p, motion, states)
        deflection = share * states[0] / give + (1 - share) * jnp.tanh(motion.velocity / smooth)
        way = jnp.clip(deflection + damping * change / give, -1.0, 1.0)
        stribeck = jnp.exp(-((jnp.asarray(motion.velocity) / _STRIBECK_VELOCITY) ** 2))
        return force * way * (1 + asymmetry * way) * (1 + breakaway * stribeck)

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Deflection of the contact."""
        return jnp.reshape(self._contact(p, motion, states)[1], (1,))

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate at which the contact yields, or as a spring F / z_0 turns the joint round."""
        force, _, give, _, breakaway, _ = (values[f"{self.key}.{p.name}"] for p in self.parameters)
        return max(_RATE, math.sqrt(force * (1 + breakaway) / (give * values["I"])))

    @staticmethod
    def _contact(p: Sequence[Array], motion: Motion, states: Array) -> tuple[Array, Array]:
        """Share of the yielding that is followed, and rate [rad/s] of the deflection."""
        _, smooth, give, *_ = p
        velocity = jnp.asarray(motion.velocity)
        ratio = velocity / smooth
        moves = jnp.abs(ratio) > _STILL
        moving = jnp.where(moves, ratio, 1.0)
        yielding = jnp.where(moves, moving / jnp.tanh(moving), 1.0) * smooth / give
        share = 1 / jnp.sqrt(1 + (yielding / _RATE) ** 2)
        return share, share * (velocity - yielding * states[0])
