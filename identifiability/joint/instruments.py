"""What instruments with a memory make of a response: they see it between the samples as well.

A filter that saw only samples 10 ms apart, joined by straight lines, would record something else
than the filter of a recorder: by more than the noise of a good one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from identifiability.joint.exponentials import matrix_exponential
from identifiability.joint.model import Model

READING_INTERVAL = 1e-3
"""Longest time [s] between what an instrument with a memory sees of the response."""

DriveArrays = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike]
"""A drive's interval, generator, readout, states and impulses."""


def readings_of(model: Model, interval: float) -> int:
    """How often in a sampling interval [s] a model's instruments see the response.

    Returns
    -------
    int
        A power of two: few programs serve all rates.
    """
    if not any(effect.reads_between for effect in model.effects):
        return 1
    return 1 << max(0, math.ceil(math.log2(interval / READING_INTERVAL) - 1e-6))


def recorded(
    model: Model,
    theta: ArrayLike,
    arrays: DriveArrays,
    readings: int,
    respond: Callable[[DriveArrays], Array],
) -> Array:
    """Response as instruments record it, traceable.

    Parameters
    ----------
    model : Model
    theta : array, shape (n_parameters,)
    arrays : tuple
        Of the drive at the samples.
    readings : int
        From `readings_of`.
    respond : callable
        The true response to the arrays of a drive.

    Returns
    -------
    array, shape (n,)
    """
    if readings == 1:
        return model.record(theta, respond(arrays), jnp.asarray(arrays[0]))
    finer = between(arrays, readings)
    response = model.record(theta, respond(finer), jnp.asarray(finer[0]))
    return response.reshape(-1, readings)[:, 0]


def between(arrays: DriveArrays, readings: int) -> DriveArrays:
    """The same drive at so many times as many samples; the last interval too is filled."""
    interval, generator, readout, states, impulses = (jnp.asarray(a) for a in arrays)
    step = interval / readings
    onwards = matrix_exponential(generator * step) if generator.size else generator
    rows = [states]
    for _ in range(readings - 1):
        rows.append(rows[-1] @ onwards.T)
    fine = jnp.stack(rows, axis=1).reshape(readings * states.shape[0], states.shape[1])
    kicks = jnp.zeros((impulses.shape[0], readings)).at[:, 0].set(impulses)
    return step, generator, readout, fine, kicks.reshape(-1)
