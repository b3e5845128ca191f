"""Responses of a joint with their first derivatives, one parameter vector at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
import scipy.linalg
from jax import Array

from identifiability.joint.effects.base import Effect
from identifiability.joint.instruments import readings_of
from identifiability.joint.model import Model
from identifiability.joint.native.kernel import Kernel, kernel_of
from identifiability.joint.native.steps import Imposed, exact, integrated
from identifiability.joint.programs import compiled, roomy
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import Drive


class Responses:
    """Responses of a model to some drives, with derivatives by some of its parameters.

    Attributes
    ----------
    kernel : Kernel
    scheme : Scheme
    """

    def __init__(self, kernel: Kernel, drives: Sequence[Drive], scheme: Scheme) -> None:
        self.kernel, self.scheme = kernel, scheme
        self._readings = readings_of(kernel.model, max(drive.interval for drive in drives))
        self._imposed = [_imposed(drive, self._readings, scheme) for drive in drives]

    def at(self, theta: np.ndarray) -> list[np.ndarray]:
        """Responses at a parameter vector.

        Returns
        -------
        list of array, shape (n, 1 + n_free)
            By drive, at its samples: the response, then its derivatives.
        """
        machine = self.kernel.at(theta)
        sensors = [e for e in self.kernel.model.effects if e.place == "sensor"]
        found = []
        steps = self.scheme.between(self._readings)
        for imposed in self._imposed:
            out = np.zeros((len(imposed.states), self.kernel.width))
            if self.scheme.exact:
                exact(machine, imposed, out)
            else:
                integrated(machine, imposed, steps, self.scheme.order, out)
            for sensor in sensors:
                out = _recorded(self.kernel, sensor, machine.theta, out, imposed.interval)
            found.append(out[:: self._readings, : 1 + len(self.kernel.free)])
        return found


def responses_of(
    model: Model, free: tuple[int, ...], drives: Sequence[Drive], scheme: Scheme
) -> Responses | None:
    """Responses of a model by machine code; none of a model that JAX has to compute.

    Parameters
    ----------
    model : Model
    free : tuple of int
        Parameters by which derivatives are wanted.
    drives : sequence of Drive
        All of torques, or all of angles.
    scheme : Scheme
    """
    kernel = kernel_of(model, free)
    return None if kernel is None else Responses(kernel, drives, scheme)


def _imposed(drive: Drive, readings: int, scheme: Scheme) -> Imposed:
    """A drive as the steps need it, with what instruments see between the samples."""
    interval = drive.interval / readings
    generator = np.ascontiguousarray(drive.generator, float)
    states, impulses = np.asarray(drive.states, float), np.asarray(drive.impulses, float)
    if readings > 1:
        onward, rows = scipy.linalg.expm(generator * interval), [states]
        for _ in range(readings - 1):
            rows.append(rows[-1] @ onward.T)
        states = np.stack(rows, axis=1).reshape(-1, states.shape[1])
        kicks = np.zeros((len(impulses), readings))
        kicks[:, 0] = impulses
        impulses = kicks.ravel()
    places = 2 * max(scheme.between(readings), 1)
    onward = scipy.linalg.expm(generator * interval / places) if generator.size else generator
    signals = [np.asarray(drive.readout, float)]
    for _ in range(places):
        signals.append(signals[-1] @ onward)
    return Imposed(
        float(interval),
        drive.imposed == "angle",
        np.ascontiguousarray(states),
        np.ascontiguousarray(signals),
        generator,
        np.ascontiguousarray(impulses),
    )


class _Sensor(NamedTuple):
    """What a compiled function is specialised to."""

    model: Model
    effect: Effect


def _recorded(
    kernel: Kernel, effect: Effect, theta: np.ndarray, response: np.ndarray, interval: float
) -> np.ndarray:
    """What one instrument makes of a response and its derivatives."""
    model = Model((effect,))
    names = list(kernel.model.parameter_names)
    own = [names.index(name) for name in model.parameter_names[3:]]
    n, width = response.shape
    # Of few shapes. An instrument that reads beyond the end finds what was last.
    signal = np.zeros((roomy(n), width))
    signal[:n] = response
    signal[n:] = signal[n - 1]
    turned = np.zeros((width - 1, len(own)))
    for t, i in enumerate(kernel.free):
        if i in own:
            turned[t, own.index(i)] = 1.0
    found = _seen(_Sensor(model, effect), theta[own], signal, turned, np.array(interval))
    return np.ascontiguousarray(np.asarray(found)[:n])


@compiled
def _seen(sensor: _Sensor, values: Array, signal: Array, turned: Array, interval: Array) -> Array:
    def record(p: Array, response: Array) -> Array:
        return sensor.effect.record(list(p), response, interval)

    def along(direction: Array, slope: Array) -> tuple[Array, Array]:
        return jax.jvp(record, (values, signal[:, 0]), (direction, slope))

    seen, slopes = jax.vmap(along, out_axes=(None, 1))(turned, signal[:, 1:].T)
    return jax.numpy.concatenate([seen[:, None], slopes], axis=1)
