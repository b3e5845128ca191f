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
    r"""The recorded response has passed a low-pass filter of first or second order.

    .. math:: H(s) = \frac{1}{1 + \tau s + \beta \tau^2 s^2}

    The shape is 0 in the plain form, one pole; 1/4 gives two equal poles and 1/2 the Butterworth
    filter. It vanishes with a time constant of 0.
    """

    key = "sensor_lowpass"
    title = "a low-pass filter in the recording"
    place = "sensor"
    linear = True
    reads_between = True
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
            "shape",
            r"\beta_f",
            "1",
            nominal=0.0,
            lower=0.0,
            upper=1.0,
            plain=0.0,
            description="second-order part of the filter: 0 one pole, 1/2 Butterworth",
        ),
    )
    references = ("Oppenheim & Willsky 1997, Signals and Systems, 2nd ed., ch. 6",)

    def record(self, p: Sequence[Array], response: Array, interval: ArrayLike) -> Array:
        """Response as recorded; the filter has settled on the first sample."""
        # By partial fractions into two poles, a complex pair if the shape exceeds 1/4. Just at
        # 1/4 the root has no derivative.
        time_constant, shape = p
        inner = 1 - 4 * shape
        root = jnp.sqrt(jnp.where(jnp.abs(inner) < 1e-9, 1e-9, inner) + 0j)
        slow, fast = 0.5 * time_constant * (1 + root), 0.5 * time_constant * (1 - root)
        parts = (1 + root) * _filtered(response, slow, interval) - (1 - root) * _filtered(
            response, fast, interval
        )
        return jnp.real(parts / (2 * root))


def _filtered(signal: Array, time_constant: Array, interval: ArrayLike) -> Array:
    """One pole, exact for a signal that is linear between samples, also without the pole."""
    ratio = interval / jnp.where(jnp.abs(time_constant) < _LEAST, _LEAST, time_constant)
    kept = jnp.exp(-ratio)
    mean = -jnp.expm1(-ratio) * time_constant / interval

    def advance(state: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        state = kept * state + (mean - kept) * ends[0] + (1 - mean) * ends[1]
        return state, state

    rest = jax.lax.scan(advance, signal[0] + 0j, (signal[:-1], signal[1:]))[1]
    return jnp.concatenate([signal[:1] + 0j, rest])
