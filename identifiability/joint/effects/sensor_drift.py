"""A recorded response that drifts."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect
from identifiability.joint.parameters import Parameter


class SensorDrift(Effect):
    """The recorded response drifts alike in every trial: a ramp, refined by a cubic.

    In units of the response: rad, or Nm where the angle is imposed. It vanishes with all
    coefficients 0.
    """

    key = "sensor_drift"
    title = "a drift of the recording"
    place = "sensor"
    linear = True
    confused_with = ("quadratic_stiffness", "gravity")
    parameters = (
        Parameter(
            "rate",
            r"r_\mathrm{d}",
            "rad/s",
            nominal=0.01,
            lower=-50.0,
            upper=50.0,
            null=0.0,
            description="drift per time since the start of the trial",
        ),
        Parameter(
            "bend",
            r"q_\mathrm{d}",
            "rad/s²",
            nominal=0.0,
            lower=-500.0,
            upper=500.0,
            null=0.0,
            plain=0.0,
            description="drift per squared time",
        ),
        Parameter(
            "twist",
            r"c_\mathrm{d}",
            "rad/s³",
            nominal=0.0,
            lower=-5000.0,
            upper=5000.0,
            null=0.0,
            plain=0.0,
            description="drift per cubed time: a swing of which a trial shows one turn or less",
        ),
    )
    references = ("Ljung 1999, System Identification: Theory for the User, 2nd ed., ch. 14",)

    def record(self, p: Sequence[Array], response: Array, interval: ArrayLike) -> Array:
        """Response with its drift, which is 0 at the first sample."""
        time = interval * jnp.arange(response.shape[0])
        return response + ((p[2] * time + p[1]) * time + p[0]) * time
