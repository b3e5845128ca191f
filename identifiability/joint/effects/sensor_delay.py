"""Recorded channels that are out of step."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect
from identifiability.joint.parameters import Parameter


class SensorDelay(Effect):
    """The response is recorded late: y(t - d); negative where the imposed signal is the late one.

    Between samples the response is read from the cubic through its four neighbours. It vanishes
    with d = 0.
    """

    key = "sensor_delay"
    title = "a delay between the recorded channels"
    place = "sensor"
    linear = True
    reads_between = True
    confused_with = ("sensor_lowpass", "series_tendon", "stretch_reflex")
    parameters = (
        Parameter(
            "delay",
            r"d_\mathrm{s}",
            "s",
            nominal=0.003,
            lower=-0.05,
            upper=0.05,
            null=0.0,
            description="lag of the recorded response behind the recorded input",
            is_delay=True,
        ),
    )
    references = ("Ljung 1999, System Identification: Theory for the User, 2nd ed., ch. 14",)

    def record(self, p: Sequence[Array], response: Array, interval: ArrayLike) -> Array:
        """Response as recorded, at rest before its first sample."""
        last = response.shape[0] - 1
        place = jnp.arange(last + 1) - p[0] / interval
        base = jnp.floor(jax.lax.stop_gradient(place)).astype(int)
        s = place - base

        def at(offset: int) -> Array:
            return response[jnp.clip(base + offset, 0, last)]

        return (
            -at(-1) * s * (s - 1) * (s - 2) / 6
            + at(0) * (s + 1) * (s - 1) * (s - 2) / 2
            - at(1) * (s + 1) * s * (s - 2) / 2
            + at(2) * (s + 1) * s * (s - 1) / 6
        )
