"""Dry friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_RATE = 1000.0  # [1/s] beyond which the contact counts as sliding steadily
_BEYOND = 0.1  # of the torque, that damping adds at most; a sharper limit takes steps as short
_STILL = 1e-3  # of the smoothing velocity, below which a quotient is its series


class CoulombFriction(Effect):
    r"""Dry friction: a contact that gives a little, then slides under constant torque.

    .. math:: T = F g\,w\,(1 + a w), \quad w = \frac{z}{g z_0} + \frac{d \dot z}{g}, \quad
              \dot z = \dot\theta\left[1 - \frac{z}{g z_0 \tanh(\dot\theta/v_0)}\right], \quad
              g = 1 + s\,e^{-(\dot\theta/v_s)^2}

    with w, where it is beyond 1, limited smoothly to 1.1. The contact's deflection z remembers
    which way the joint went, so at rest friction holds what it held (Dahl; with the damping d,
    LuGre), but for a creep at less than v_0. With z_0 = 0 it is F tanh(velocity / v_0); what would
    yield faster than in 1 ms is taken for that. More breaks away than slides by s (Stribeck); with
    a it is not the same in both directions: while the joint moves it feels the constant F a as
    well, which under an imposed angle is the torque's level. d = s = a = 0 in the plain form. It
    vanishes with F = 0.
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
            nominal=0.03,
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
            "d",
            "s/rad",
            nominal=0.0,
            lower=0.0,
            upper=500.0,
            plain=0.0,
            description="damping of the contact over its torque",
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
            "breakaway_velocity",
            "v_s",
            "rad/s",
            nominal=0.1,
            lower=0.01,
            upper=0.5,
            plain=0.1,
            description="velocity over which breaking away becomes sliding",
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
        force, smooth, give, damping, *_, asymmetry = p
        most, share, change = self._contact(p, motion, states)
        steady = jnp.tanh(motion.velocity / smooth)
        way = (share * states[0] / give + damping * change) / most + (1 - share) * steady
        beyond = way - jnp.clip(way, -1.0, 1.0)
        way = way - beyond + _BEYOND * jnp.tanh(beyond / _BEYOND)
        return force * most * way * (1 + asymmetry * way)

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Deflection of the contact."""
        return jnp.reshape(self._contact(p, motion, states)[2], (1,))

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate at which the contact yields, or turns the joint round by its spring or damper.

        It yields at `_RATE` at most, of which steps of half that pace do for E = 1e-6.
        """
        force, _, give, damping, breakaway, *_ = (
            values[f"{self.key}.{p.name}"] for p in self.parameters
        )
        most = force * (1 + breakaway) / values["I"]
        return max(0.5 * _RATE, math.sqrt(most / give), most * damping)

    def settling(self, values: Mapping[str, float]) -> float:
        """Rate at which the contact yields at most; how it yields, the velocity alone says."""
        return _RATE

    @staticmethod
    def _contact(p: Sequence[Array], motion: Motion, states: Array) -> tuple[Array, Array, Array]:
        """Its torque over that while sliding, share of yielding that is followed, and rate [rad/s].

        What yields is followed up to `_RATE`; beyond, the contact counts as sliding steadily.
        """
        _, smooth, give, _, breakaway, slow, _ = p
        velocity = jnp.asarray(motion.velocity)
        most = 1 + breakaway * jnp.exp(-((velocity / slow) ** 2))
        ratio = velocity / smooth
        moves = jnp.abs(ratio) > _STILL
        moving = jnp.where(moves, ratio, 1.0)
        away = jnp.where(moves, moving / jnp.tanh(moving), 1 + ratio**2 / 3)
        yielding = away * smooth / (give * most)
        share = 1 / jnp.sqrt(1 + (yielding / _RATE) ** 2)
        return most, share, share * (velocity - yielding * states[0])
