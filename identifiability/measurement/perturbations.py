"""Torques that are imposed on a joint, in a form that can be integrated exactly.

Every perturbation is the output of a small autonomous linear system, ``w' = G w``,
``u = g . w``, whose state ``w`` jumps at samples of the time grid, plus torque impulses at such
samples. A step holds a constant, a sinusoid is an oscillator, a sampled signal is a ramp that
is reset at every sample. A linear joint driven by it is again an autonomous linear system, so
its response is exact at the samples, whatever the sampling interval.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
import scipy.interpolate

from identifiability.errors import InputError

Hold = Literal["first-order", "zero-order", "smooth"]
_FEWEST = 6  # samples of a spline
MOTION_DEGREE = 7
"""Of the spline through an imposed angle: see `imposed_motion`."""


@dataclass(frozen=True, eq=False)
class Drive:
    """An imposed signal on a uniform time grid, ready for exact integration.

    Attributes
    ----------
    interval : float
        Sampling interval [s].
    generator : array, shape (m, m)
        G of ``w' = G w`` [1/s].
    readout : array, shape (q, m)
        The imposed signals are ``readout @ w``: the torque [Nm] (q = 1), or angle [rad],
        velocity [rad/s] and acceleration [rad/s²] (q = 3).
    states : array, shape (n, m)
        w at each sample, after its jump.
    impulses : array, shape (n,)
        Torque impulse [Nms] at each sample.
    """

    interval: float
    generator: np.ndarray
    readout: np.ndarray
    states: np.ndarray
    impulses: np.ndarray

    @property
    def imposed(self) -> Literal["torque", "angle"]:
        """What is imposed."""
        return "torque" if len(self.readout) == 1 else "angle"

    @property
    def curved(self) -> bool:
        """Whether an imposed torque bends between its samples."""
        return self.imposed == "torque" and len(self.generator) > 2

    @property
    def signals(self) -> np.ndarray:
        """Imposed signals at the samples, shape (n, q)."""
        return self.states @ self.readout.T


class Perturbation(ABC):
    """A torque imposed on a joint that is at rest before it."""

    key: ClassVar[str]

    @abstractmethod
    def drive(self, time: np.ndarray) -> Drive:
        """Put the perturbation on a uniform time grid.

        Parameters
        ----------
        time : array, shape (n,)
            Sample times [s].

        Raises
        ------
        InputError
            Where one of the perturbation's edges lies between two samples.
        """


def _uniform_interval(time: np.ndarray) -> float:
    time = np.asarray(time, float)
    if time.ndim != 1 or time.size < 2:
        raise InputError(f"found a time grid of shape {time.shape}, expected at least two samples")
    interval = (time[-1] - time[0]) / (time.size - 1)
    if interval <= 0 or not np.allclose(np.diff(time), interval, rtol=1e-6, atol=0):
        raise InputError("the time grid is not uniform and increasing; resample it to one interval")
    return float(interval)


def _sample_of(instant: float, time: np.ndarray, what: str) -> int | None:
    """Index of the sample at `instant`, ``None`` after the end of the grid."""
    interval = _uniform_interval(time)
    position = (instant - time[0]) / interval
    index = round(position)
    if abs(position - index) > 1e-6:
        raise InputError(
            f"the {what} at {instant:g} s lies between two samples {interval:g} s apart; "
            "choose an interval that divides it"
        )
    if index < 0:
        raise InputError(f"the {what} at {instant:g} s lies before the grid starts ({time[0]:g} s)")
    return index if index < time.size else None


def propagator(generator: np.ndarray, time: float) -> np.ndarray:
    """What makes of a generator's states those some time later, shape (m, m).

    By its Taylor series, which ends where the states are derivatives of a polynomial. Padé's
    approximation is as exact as its largest entries only, and the smallest meet the largest states.

    Parameters
    ----------
    generator : array, shape (m, m)
        In 1/s.
    time : float
        In s; short beside the generator's periods.
    """
    total = term = np.eye(len(generator))
    order = 1
    while np.any(np.abs(term) > np.finfo(float).eps * np.abs(total)):
        term = term @ generator * (time / order)
        total = total + term
        order += 1
    return total


def _propagate(generator: np.ndarray, jumps: np.ndarray, interval: float) -> np.ndarray:
    """Generator states after each sample's jump, shape (n, m)."""
    step = propagator(generator, interval)
    states = np.zeros_like(jumps)
    states[0] = jumps[0]
    for n in range(1, len(jumps)):
        states[n] = step @ states[n - 1] + jumps[n]
    return states


def _piecewise_constant(time: np.ndarray, edges: list[tuple[float, float]]) -> Drive:
    """Drive of a torque that changes by `height` at each `instant` of `edges`."""
    time = np.asarray(time, float)
    jumps = np.zeros((time.size, 1))
    for instant, height in edges:
        index = _sample_of(instant, time, "edge")
        if index is not None:
            jumps[index] += height
    return Drive(
        _uniform_interval(time),
        np.zeros((1, 1)),
        np.ones((1, 1)),
        np.cumsum(jumps, axis=0),
        np.zeros(time.size),
    )


@dataclass(frozen=True)
class Impulse(Perturbation):
    """Torque impulse of `size` [Nms] at `onset` [s]."""

    size: float = 1.0
    onset: float = 0.0
    key = "impulse"

    def drive(self, time: np.ndarray) -> Drive:  # noqa: D102
        impulses = np.zeros(np.size(time))
        index = _sample_of(self.onset, time, "impulse")
        if index is not None:
            impulses[index] = self.size
        n = np.size(time)
        return Drive(
            _uniform_interval(time), np.zeros((0, 0)), np.zeros((1, 0)), np.zeros((n, 0)), impulses
        )


@dataclass(frozen=True)
class Step(Perturbation):
    """Torque step of `amplitude` [Nm] at `onset` [s]."""

    amplitude: float = 1.0
    onset: float = 0.0
    key = "step"

    def drive(self, time: np.ndarray) -> Drive:  # noqa: D102
        return _piecewise_constant(time, [(self.onset, self.amplitude)])


@dataclass(frozen=True)
class Pulse(Perturbation):
    """Rectangular torque pulse of `amplitude` [Nm] and `duration` [s] from `onset` [s]."""

    amplitude: float = 20.0
    duration: float = 0.01
    onset: float = 0.0
    key = "pulse"

    def drive(self, time: np.ndarray) -> Drive:  # noqa: D102
        end = self.onset + self.duration
        return _piecewise_constant(time, [(self.onset, self.amplitude), (end, -self.amplitude)])


@dataclass(frozen=True)
class DoublePulse(Perturbation):
    """Two rectangular pulses of opposite sign, one right after the other.

    Each has `amplitude` [Nm] and `duration` [s]; the first begins at `onset` [s].
    """

    amplitude: float = 20.0
    duration: float = 0.01
    onset: float = 0.0
    key = "double_pulse"

    def drive(self, time: np.ndarray) -> Drive:  # noqa: D102
        a, d = self.amplitude, self.duration
        edges = [(self.onset, a), (self.onset + d, -2 * a), (self.onset + 2 * d, a)]
        return _piecewise_constant(time, edges)


@dataclass(frozen=True)
class Sinusoid(Perturbation):
    """Sinusoidal torque from rest, `amplitude` [Nm] and `period` [s], from `onset` [s] on.

    The defaults are those of Kistemaker & Rozendaal (2011), after Popescu et al. (2003).
    """

    amplitude: float = 20.0
    period: float = 0.03
    onset: float = 0.0
    key = "sinusoid"

    def drive(self, time: np.ndarray) -> Drive:  # noqa: D102
        time = np.asarray(time, float)
        w = 2 * np.pi / self.period
        generator = np.array([[0.0, w], [-w, 0.0]])
        jumps = np.zeros((time.size, 2))
        index = _sample_of(self.onset, time, "onset")
        if index is not None:
            jumps[index, 1] = self.amplitude
        interval = _uniform_interval(time)
        states = _propagate(generator, jumps, interval)
        return Drive(interval, generator, np.array([[1.0, 0.0]]), states, np.zeros(time.size))


@dataclass(frozen=True, eq=False)
class SampledTorque(Perturbation):
    """A torque known at samples.

    Attributes
    ----------
    values : array, shape (n,)
        Torque [Nm] at the samples of the grid it will be put on.
    hold : {"first-order", "zero-order", "smooth"}
        Linear between samples (the default), held, or a cubic spline through them: straight lines
        lose (w h)²/12 of what a frequency w has that is sampled at intervals h.
    """

    values: np.ndarray = field(repr=False)
    hold: Hold = "first-order"
    key = "sampled"

    def __post_init__(self) -> None:
        values = np.array(self.values, float)
        if values.ndim != 1 or not np.all(np.isfinite(values)):
            raise InputError("a sampled torque must be one row of finite numbers")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def drive(self, time: np.ndarray) -> Drive:
        """Put the samples on the time grid; their number must be the grid's."""
        interval = _uniform_interval(time)
        if np.size(time) != self.values.size:
            raise InputError(
                f"found {self.values.size} torque samples for {np.size(time)} times; "
                "give one for each"
            )
        if self.hold == "smooth":
            return self._smooth(np.asarray(time, float), interval)
        slopes = np.zeros(self.values.size)
        if self.hold == "first-order":
            slopes[:-1] = np.diff(self.values) / interval
        generator = np.array([[0.0, 1.0], [0.0, 0.0]])
        states = np.column_stack([self.values, slopes])
        return Drive(
            interval, generator, np.array([[1.0, 0.0]]), states, np.zeros(self.values.size)
        )

    def _smooth(self, time: np.ndarray, interval: float) -> Drive:
        if time.size < _FEWEST:
            raise InputError(f"found {time.size} samples for a spline, expected at least {_FEWEST}")
        spline = scipy.interpolate.make_interp_spline(time, self.values, k=3)
        states = np.column_stack([spline(time, nu) for nu in range(4)])
        return Drive(interval, np.eye(4, k=1), np.eye(4)[:1], states, np.zeros(time.size))


def multisine(
    time: np.ndarray,
    *,
    amplitude: float,
    frequencies: np.ndarray,
    seed: int,
    hold: Hold = "first-order",
) -> SampledTorque:
    """Random-phase multisine torque.

    Parameters
    ----------
    time : array, shape (n,)
        Sample times [s].
    amplitude : float
        Root-mean-square torque [Nm].
    frequencies : array, shape (f,)
        Frequencies [Hz], equal power in each.
    seed : int
        Seed of the phases.
    hold : {"first-order", "zero-order", "smooth"}
        How the torque goes between samples.
    """
    time, frequencies = np.asarray(time, float), np.asarray(frequencies, float)
    nyquist = 0.5 / _uniform_interval(time)
    if frequencies.size == 0 or np.any(frequencies <= 0) or np.any(frequencies >= nyquist):
        raise InputError(f"multisine frequencies must lie between 0 and {nyquist:g} Hz")
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, frequencies.size)
    waves = np.sin(2 * np.pi * np.outer(time - time[0], frequencies) + phases)
    return SampledTorque(amplitude * np.sqrt(2 / frequencies.size) * waves.sum(axis=1), hold)


def prbs(time: np.ndarray, *, amplitude: float, dwell: float, seed: int) -> SampledTorque:
    """Pseudo-random binary torque, +/- `amplitude` [Nm], redrawn every `dwell` [s] and held.

    Parameters
    ----------
    time : array, shape (n,)
        Sample times [s].
    amplitude : float
        Torque level [Nm].
    dwell : float
        Shortest time between switches [s], a multiple of the sampling interval.
    seed : int
        Seed of the levels.
    """
    time = np.asarray(time, float)
    interval = _uniform_interval(time)
    held = round(dwell / interval)
    if held < 1 or abs(held - dwell / interval) > 1e-6:
        raise InputError(
            f"found a dwell of {dwell:g} s, expected a multiple of the interval of {interval:g} s"
        )
    levels = np.random.default_rng(seed).integers(0, 2, -(-time.size // held)) * 2.0 - 1.0
    return SampledTorque(amplitude * np.repeat(levels, held)[: time.size], hold="zero-order")


def imposed_motion(time: np.ndarray, angle: np.ndarray) -> Drive:
    """Drive of an imposed angle: angle, velocity and acceleration of its spline of degree seven.

    A cubic spline would do for the angle, but its second derivative falls short by (w h)²/12 at a
    frequency w sampled at intervals h, and the fitted inertia with it. At four samples a cycle that
    of degree five is out by 1.3 %, enough to pass for a late and filtered sensor where there is
    little noise; this one by 0.13 %.

    Parameters
    ----------
    time : array, shape (n,)
        Sample times [s].
    angle : array, shape (n,)
        Imposed angle [rad], at least eight samples.

    Returns
    -------
    Drive
        With three signals: angle [rad], velocity [rad/s], acceleration [rad/s²].

    Raises
    ------
    InputError
        With fewer than eight samples, or samples that are not uniform in time.
    """
    time, angle = np.asarray(time, float), np.asarray(angle, float)
    interval = _uniform_interval(time)
    n = MOTION_DEGREE + 1
    if time.size < n:
        raise InputError(f"found an imposed angle of {time.size} samples, expected at least {n}")
    # From where it begins: a posture's digits would be lost to its derivatives.
    spline = scipy.interpolate.make_interp_spline(time, angle - angle[0], k=MOTION_DEGREE)
    states = np.column_stack([spline(time, nu) for nu in range(n)])
    states[:, 0] += angle[0]
    # A polynomial's derivatives chain into each other: phi' = w1, w1' = w2 and so on.
    return Drive(interval, np.eye(n, k=1), np.eye(n)[:3], states, np.zeros(time.size))


PERTURBATIONS: dict[str, type[Perturbation]] = {
    cls.key: cls for cls in (Impulse, Pulse, DoublePulse, Step, Sinusoid)
}

WINDOWS = (0.05, 0.1, 0.2)
"""Times T [s] after a perturbation in which Kistemaker & Rozendaal (2011) compare."""
