"""A path beside muscle and tendon: ligaments, capsule and skin, which refine a tendon."""

from __future__ import annotations

from collections.abc import Sequence

from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Motion
from identifiability.joint.parameters import Parameter

BYPASS = (
    Parameter(
        "bypass_stiffness",
        r"K_\mathrm{P}",
        "Nm/rad",
        nominal=0.0,
        lower=0.0,
        upper=2000.0,
        null=0.0,
        plain=0.0,
        description="stiffness of a path beside muscle and tendon",
    ),
    Parameter(
        "bypass_damping",
        r"B_\mathrm{P}",
        "Nms/rad",
        nominal=0.0,
        lower=0.0,
        upper=50.0,
        null=0.0,
        plain=0.0,
        description="damping of a path beside muscle and tendon",
    ),
)
"""Last of the parameters of a tendon."""


def bypass_torque(p: Sequence[Array], motion: Motion) -> ArrayLike:
    """Torque [Nm] of what acts beside muscle and tendon.

    Parameters
    ----------
    p : sequence of scalars
        A tendon's parameters, of which the last are `BYPASS`.
    motion : Motion
        Of the joint.
    """
    return p[-2] * motion.angle + p[-1] * motion.velocity
