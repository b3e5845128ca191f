"""A low-pass filter in the recording of the response."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.effects.base import Effect
from identifiability.joint.parameters import Parameter

_LEAST = 1e-6  # [s]; below, nothing is left of a sample at the next, at any rate in use


class SensorLowpass(Effect):
    """The recorded response has passed a low-pass filter: one real pole, or two.

    The second time constant is 0 in the plain form. It vanishes with both 0.
    """

    key = "sensor_lowpass"
    title = "a low-pass filter in the recording"
    place = "sensor"
    linear = True
    confused_with = ("sensor_delay", "series_tendon", "second_mass")
    parameters = (
        Parameter(
            "time_constant",
            r"\tau_f",
            "s",
            nominal=0.004,
            lower=0.0,
            upper=0.1,
            null=0.0,
            description="time constant of the filter, 1/(2 pi cut-off frequency)",
        ),
        Parameter(
            "second_time_constant",
            r"\tau_{f2}",
            "s",
            nominal=0.0,
            lower=0.0,
            upper=0.1,
            null=0.0,
            plain=0.0,
            description="time constant of a second pole",
        ),
    )
    references = ("Oppenheim & Willsky 1997, Signals and Systems, 2nd ed., ch. 6",)

    def record(self, p: Sequence[Array], response: Array, interval: ArrayLike) -> Array:
        """Response as recorded; the filter has settled on the first sample."""
        for time_constant in p:
            response = _filtered(response, time_constant, interval)
        return response


def _filtered(signal: Array, time_constant: Array, interval: ArrayLike) -> Array:
    """One pole, exact for a signal that is linear between samples, also without the pole."""
    ratio = interval / jnp.maximum(time_constant, _LEAST)
    kept = jnp.exp(-ratio)
    mean = -jnp.expm1(-ratio) * time_constant / interval

    def advance(state: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        state = kept * state + (mean - kept) * ends[0] + (1 - mean) * ends[1]
        return state, state

    rest = jax.lax.scan(advance, signal[0], (signal[:-1], signal[1:]))[1]
    return jnp.concatenate([signal[:1], rest])
