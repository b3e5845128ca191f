"""Dry friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_STRIBECK_VELOCITY = 0.1  # [rad/s]


class CoulombFriction(Effect):
    r"""Dry friction: constant torque against the velocity, more where it breaks away (Stribeck).

    .. math:: T = F w\,(1 + a w)\,(1 + s\,e^{-(\dot\theta/0.1)^2}), \quad w = \tanh(\dot\theta/v_0)

    v_0 smooths the jump at rest; with a it is not the same in both directions: while the joint
    moves it feels the constant F a as well, which under an imposed angle is the torque's level.
    s = a = 0 in the plain form. It vanishes with F = 0.
    """

    key = "coulomb_friction"
    title = "dry (Coulomb) friction"
    place = "joint"
    linear = False
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
            lower=0.002,
            upper=0.3,
            description="velocity over which friction reverses",
            ends_form=True,
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
    references = ("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30: 1083-1138",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] against the velocity."""
        force, smooth, breakaway, asymmetry = p
        stribeck = jnp.exp(-((jnp.asarray(motion.velocity) / _STRIBECK_VELOCITY) ** 2))
        way = jnp.tanh(motion.velocity / smooth)
        return force * way * (1 + asymmetry * way) * (1 + breakaway * stribeck)

    def pace(self, values: Mapping[str, float]) -> float:
        """Rate at which friction stops the joint within its smoothing velocity."""
        force, smooth, breakaway, _ = (values[f"{self.key}.{p.name}"] for p in self.parameters)
        return force * (1 + breakaway) / (smooth * values["I"])
