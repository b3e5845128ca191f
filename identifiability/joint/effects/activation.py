"""Activation of muscle falls more slowly than it rises (Thelen 2003, J Biomech Eng 125: 70)."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.parameters import Parameter


def off_ratio(symbol: str) -> Parameter:
    """Parameter of how much longer deactivation takes, which refines an effect."""
    return Parameter(
        "off_ratio",
        symbol,
        "1",
        nominal=1.0,
        lower=1.0,
        upper=6.0,
        plain=1.0,
        description="time constant of deactivation over that of activation",
    )


def approach(gap: Array, time_constant: ArrayLike, ratio: ArrayLike) -> Array:
    """Rate [1/s of the gap's unit] at which activation closes a gap above or below it."""
    return gap / jnp.where(gap > 0, time_constant, jnp.asarray(time_constant) * ratio)


def kink(key: str, values: Mapping[str, float]) -> float:
    """Difference [1/s] between the rates of activation and deactivation of an effect."""
    return (1 - 1 / values[f"{key}.off_ratio"]) / values[f"{key}.time_constant"]
