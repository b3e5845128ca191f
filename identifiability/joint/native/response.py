"""Responses of a joint with their first derivatives, one parameter vector at a time."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from itertools import pairwise

import numpy as np

from identifiability.joint.instruments import readings_of
from identifiability.joint.model import Model
from identifiability.joint.native.instruments import kind_of
from identifiability.joint.native.kernel import Kernel, kernel_of
from identifiability.joint.native.responding import ARRAYS, NUMBERS, respond
from identifiability.joint.programs import THREADS
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import Drive, propagator

_WORTH_THREADS = 20_000  # steps from which on threads are worth their start; some ten milliseconds


class Responses:
    """Responses of a model to some drives, with derivatives by some of its parameters.

    Attributes
    ----------
    plan : array of int
        What `respond` needs to know of them.
    width : int
        Of the rows that it writes: a value, its derivatives, and room.
    columns : int
        Those without the room.
    starts : array of int, shape (n_drives + 1,)
        Where in these rows the response to each drive begins, and where the last one ends.
    lanes : array of int, shape (n_parameters,)
        Which derivative is that by each parameter, from 1; 0 if none.
    exact : bool
        Whether it takes no steps.
    """

    def __init__(
        self, kernel: Kernel, drives: Sequence[Drive], scheme: Scheme, sensors: np.ndarray
    ) -> None:
        model, free = kernel.model, kernel.free
        # The kernel's code is called as long as this lives.
        self._made_of = kernel, drives, scheme, sensors
        readings = readings_of(model, max(drive.interval for drive in drives))
        substeps = scheme.between(readings)
        every = [_imposed(drive, readings, max(substeps, 1)) for drive in drives]
        self.lanes = lanes_of(model, free)
        first = every[0]
        alike = all(
            np.array_equal(one[name], first[name])
            for one in every[1:]
            for name in ("intervals", "signals", "generators")
        )
        counts = [0, *(len(drive.states) for drive in drives)]
        self.starts, self.width = np.cumsum(counts), kernel.width
        self.columns = 1 + len(free)
        self.exact = scheme.exact
        numbers = {
            "moving": kernel.moving.address,
            "turning": kernel.turning.address,
            "still": kernel.still.address,
            "alone": not free,
            "angle": drives[0].imposed == "angle",
            "alike": alike,
            "n_parameters": self.lanes.size,
            "n_states": 2 + model.n_internal,
            "n_delays": kernel.n_delays,
            "width": kernel.width,
            "substeps": 0 if scheme.exact else substeps,
            "order": scheme.order,
            "readings": readings,
            "n_sensors": len(sensors),
            "n_drives": len(drives),
            "n_read": first["signals"].shape[1],
            "n_generating": first["states"].shape[1],
        }
        self._arrays = {
            "lanes": self.lanes,
            "sensors": sensors,
            "starts": readings * self.starts,
            **{
                name: np.stack([one[name] for one in every])
                for name in ("intervals", "signals", "generators")
            },
            **{
                name: np.concatenate([one[name] for one in every])
                for name in ("given", "states", "impulses")
            },
        }
        addresses = [self._arrays[name].ctypes.data for name in ARRAYS]
        self.plan = np.array([*(numbers[name] for name in NUMBERS), *addresses], np.int64)

    def at(self, theta: np.ndarray) -> list[np.ndarray]:
        """Responses at a parameter vector.

        Returns
        -------
        list of array, shape (n, 1 + n_free)
            By drive, at its samples: the response, then its derivatives.
        """
        return np.split(self.all_at(theta)[:, : self.columns], self.starts[1:-1])

    def all_at(self, theta: np.ndarray) -> np.ndarray:
        """Responses at a parameter vector, one below the other, shape (n, width)."""
        theta, out = np.ascontiguousarray(theta, float), np.zeros((self.starts[-1], self.width))
        if not self._parts:
            self._write(theta, out)
            return out
        ends = np.cumsum([part.starts[-1] for part in self._parts])[:-1]
        with ThreadPoolExecutor(THREADS) as pool:
            shares = zip(self._parts, np.split(out, ends), strict=True)
            for done in [pool.submit(part._write, theta, share) for part, share in shares]:
                done.result()
        return out

    def _write(self, theta: np.ndarray, out: np.ndarray) -> None:
        respond.ctypes(self.plan.ctypes.data, theta.ctypes.data, out.ctypes.data, None)

    @cached_property
    def _parts(self) -> list[Responses]:
        """Responses to some of the drives for each thread; none where that is not worth it."""
        kernel, drives, scheme, sensors = self._made_of
        alike = len({drive.interval for drive in drives}) == 1
        if self.starts[-1] * scheme.substeps < _WORTH_THREADS or not alike:
            return []
        middles = 0.5 * (self.starts[1:] + self.starts[:-1])
        ends = np.searchsorted(middles, np.linspace(0, self.starts[-1], THREADS + 1))
        shares = [drives[a:b] for a, b in pairwise(ends) if a < b]
        if len(shares) == 1:
            return []
        return [Responses(kernel, share, scheme, sensors) for share in shares]


def lanes_of(model: Model, free: tuple[int, ...]) -> np.ndarray:
    """Which derivative is that by each parameter, from 1; 0 if none. Shape (n_parameters,)."""
    lanes = np.zeros(len(model.parameter_names), np.int64)
    lanes[list(free)] = 1 + np.arange(len(free))
    return lanes


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
    sensors, names = [], list(model.parameter_names)
    for effect in model.effects:
        if effect.place == "sensor":
            kind = kind_of(effect)
            if kind is None:
                return None
            sensors.append((kind, names.index(f"{effect.key}.{effect.parameters[0].name}")))
    kernel = kernel_of(model, free)
    if kernel is None:
        return None
    return Responses(kernel, drives, scheme, np.array(sensors, np.int64).reshape(-1, 2))


def _imposed(drive: Drive, readings: int, substeps: int) -> dict[str, np.ndarray]:
    """A drive as `Imposed` has it, with what instruments see between the samples."""
    interval = drive.interval / readings
    generator = np.asarray(drive.generator, float)
    states, impulses = np.asarray(drive.states, float), np.asarray(drive.impulses, float)
    if readings > 1:
        onward, rows = propagator(generator, interval), [states]
        for _ in range(readings - 1):
            rows.append(rows[-1] @ onward.T)
        states = np.stack(rows, axis=1).reshape(readings * len(states), states.shape[1])
        kicks = np.zeros((len(impulses), readings))
        kicks[:, 0] = impulses
        impulses = kicks.ravel()
    places = 2 * substeps
    onward = propagator(generator, interval / places)
    signals = [np.asarray(drive.readout, float)]
    for _ in range(places):
        signals.append(signals[-1] @ onward)
    return {
        "intervals": np.array(float(interval)),
        "given": states @ signals[0].T,
        "states": states,
        "signals": np.stack(signals),
        "generators": generator,
        "impulses": impulses,
    }
