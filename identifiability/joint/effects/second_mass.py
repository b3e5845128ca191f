"""A second mass: soft tissue or a cuff that moves on the segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.parameters import Parameter

_SHARE, _SHARE_SPREAD = 0.5, 1.0
_DAMPING, _DAMPING_SPREAD = 0.3, 1.0


class SecondMass(Effect):
    r"""A mass that wobbles on the segment, held by a spring and a damper.

    .. math::
        T = k(\theta - \theta_2) + c(\dot\theta - \dot\theta_2), \qquad I_2\ddot\theta_2 = T,
        \qquad k = I_2 (2\pi f)^2, \quad c = 2\zeta I_2\, 2\pi f

    It vanishes with I_2 = 0.
    """

    key = "second_mass"
    title = "a second mass (soft tissue, a loose cuff)"
    place = "joint"
    linear = True
    n_states = 2
    confused_with = ("activation_lag", "maxwell_branch", "sensor_lowpass", "soft_coupling")
    parameters = (
        Parameter(
            "inertia",
            "I_2",
            "kg m²",
            nominal=0.02,
            lower=0.0,
            upper=100.0,
            null=0.0,
            description="inertia of the mass about the joint",
        ),
        Parameter(
            "frequency",
            "f_2",
            "Hz",
            nominal=12.0,
            lower=0.5,
            upper=100.0,
            description="frequency at which it wobbles on a segment that is held",
        ),
        Parameter(
            "damping_ratio",
            r"\zeta_2",
            "1",
            nominal=0.2,
            lower=0.005,
            upper=3.0,
            description="damping of the wobble over critical damping",
        ),
    )
    references = ("Gruber, Ruder, Denoth & Schneider 1998, J Biomech 31: 439-444 (wobbling mass)",)

    def torque(
        self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion
    ) -> ArrayLike:
        """Torque [Nm] that moves the second mass."""
        inertia, frequency, damping = p
        omega = 2 * jnp.pi * frequency
        stretch, slip = motion.angle - states[0], motion.velocity - states[1]
        return inertia * omega * (omega * stretch + 2 * damping * slip)

    def rates(self, p: Sequence[Array], motion: Motion, states: Array, delayed: Motion) -> Array:
        """Motion of the second mass."""
        _, frequency, damping = p
        omega = 2 * jnp.pi * frequency
        stretch, slip = motion.angle - states[0], motion.velocity - states[1]
        return jnp.stack([states[1], omega * (omega * stretch + 2 * damping * slip)])

    def typical(self, values: Mapping[str, float]) -> Mapping[str, tuple[float, float]]:
        """Inertia beside the joint's, and damping of what wobbles.

        Soft tissue has from a fifth of a segment's mass to twice that of its bones, and its wobble
        fades within some periods (Gruber et al. 1998); in a cuff the heavier part may be the limb.
        Nineteen in twenty have a fourteenth to three and a half times the joint's inertia. One with
        nearly all inertia, held by a damper alone, is no mass that wobbles, but what a filter of
        the torque looks like.
        """
        return {
            f"{self.key}.inertia": (_SHARE * values["I"], _SHARE_SPREAD),
            f"{self.key}.damping_ratio": (_DAMPING, _DAMPING_SPREAD),
        }
