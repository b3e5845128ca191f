"""What is done to a hidden joint, and how it is recorded: 1 kHz, 50 ms quiet, from rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy import signal

from identifiability.benchmark.joints import RTOL, Joint
from identifiability.measurement.trials import Trial

INTERVAL = 1e-3
"""Sampling interval (s)."""

LEAD = 50
"""Samples of quiet before the torque begins."""

MAINS = 50.0
"""Frequency (Hz) of the hum."""

DWELL = 25
"""Samples between possible switches of a pseudo-random binary torque."""


@dataclass(frozen=True, eq=False)
class Load:
    """A torque to apply.

    Attributes
    ----------
    kind : str
        Kind of perturbation.
    amplitude : float
        Largest torque (Nm), with the sign of the first.
    torque : array, shape (n,)
        Torque (Nm) at the samples, linear between them: an edge ramps over one interval.
    """

    kind: str
    amplitude: float
    torque: np.ndarray = field(repr=False)

    def __post_init__(self) -> None:
        self.torque.flags.writeable = False

    @property
    def name(self) -> str:
        """Kind and amplitude."""
        return f"{self.kind} {self.amplitude:+g}"


@dataclass(frozen=True)
class Protocol:
    """Torques of the trials to fit and of those held out."""

    fit: tuple[Load, ...]
    held_out: tuple[Load, ...]


@dataclass(frozen=True)
class Recorder:
    """What a recording adds to the truth.

    Attributes
    ----------
    ratio : float
        Energy of the angle's noise over that of the angle, in every trial.
    correlation : float
        Correlation of the noise from one sample to the next (AR(1)); 0 for white noise.
    hum : float
        Hum of the mains in the angle: its r.m.s. over that of the noise.
    resolution : float
        Step (rad) to which the angle is rounded; 0 for none.
    torque_noise : float
        White noise in the recorded torque: its r.m.s. over that of the torque.
    """

    ratio: float
    correlation: float = 0.0
    hum: float = 0.0
    resolution: float = 0.0
    torque_noise: float = 0.0


def pulse(amplitude: float, milliseconds: int, n_samples: int = 600) -> Load:
    """Rectangular pulse of an amplitude (Nm) and a duration (ms)."""
    torque = np.zeros(n_samples)
    torque[LEAD : LEAD + milliseconds] = amplitude
    return Load(f"pulse{milliseconds}", amplitude, torque)


def step(amplitude: float, n_samples: int = 800) -> Load:
    """Step of an amplitude (Nm)."""
    torque = np.zeros(n_samples)
    torque[LEAD:] = amplitude
    return Load("step", amplitude, torque)


def sinusoid(amplitude: float, n_samples: int = 500) -> Load:
    """Sinusoid of an amplitude (Nm) and a period of 30 ms, as in Kistemaker & Rozendaal (2011)."""
    torque = np.zeros(n_samples)
    torque[LEAD:] = amplitude * np.sin(2.0 * np.pi * np.arange(n_samples - LEAD) / 30.0)
    return Load("sine30", amplitude, torque)


def prbs(amplitude: float, seed: int, n_samples: int = 1000) -> Load:
    """Pseudo-random binary torque of an amplitude (Nm), starting with its positive level."""
    n_levels = -(-(n_samples - LEAD) // DWELL)
    levels = np.random.default_rng(seed).choice([-1.0, 1.0], n_levels)
    torque = np.zeros(n_samples)
    torque[LEAD:] = amplitude * levels[0] * np.repeat(levels, DWELL)[: n_samples - LEAD]
    return Load("prbs", amplitude, torque)


def multisine(amplitude: float, seed: int, n_samples: int = 1000) -> Load:
    """Multisine to 20 Hz, scaled to a peak (Nm); of 200 sets of phases the least peaked."""
    time = np.arange(n_samples - LEAD) * INTERVAL
    n_waves = int(20.0 * time.size * INTERVAL)
    frequencies = np.arange(1, n_waves + 1) / (time.size * INTERVAL)
    rng = np.random.default_rng(seed)
    candidates = (
        np.sin(2.0 * np.pi * np.outer(time, frequencies) + rng.uniform(0, 2 * np.pi, n_waves))
        for _ in range(200)
    )
    sums = (waves.sum(axis=1) for waves in candidates)
    best = min(sums, key=lambda wave: float(np.abs(wave).max() / wave.std()))
    torque = np.zeros(n_samples)
    torque[LEAD:] = amplitude * best / np.abs(best).max()
    return Load("multisine", amplitude, torque)


@cache
def standard() -> Protocol:
    """Ten trials to fit, and six held out, one of them of a larger amplitude than any fitted."""
    return Protocol(
        fit=(
            pulse(60.0, 5),
            pulse(-60.0, 5),
            pulse(4.0, 50),
            pulse(16.0, 50),
            pulse(-16.0, 50),
            step(3.0),
            step(-6.0),
            sinusoid(20.0),
            prbs(1.5, seed=1),
            multisine(5.0, seed=2),
        ),
        held_out=(
            pulse(30.0, 5),
            pulse(-9.6, 50),
            step(6.0),
            sinusoid(-20.0),
            prbs(4.0, seed=3),
            pulse(24.0, 50),
        ),
    )


@cache
def short() -> Protocol:
    """Six trials of half a second to fit, and two held out."""
    return Protocol(
        fit=(
            pulse(8.0, 50, 500),
            pulse(-8.0, 50, 500),
            pulse(16.0, 50, 500),
            step(4.0, 500),
            pulse(40.0, 5, 500),
            multisine(5.0, seed=4, n_samples=500),
        ),
        held_out=(pulse(24.0, 50, 500), prbs(4.0, seed=5, n_samples=500)),
    )


def record(load: Load, angle: np.ndarray, recorder: Recorder, rng: np.random.Generator) -> Trial:
    """Record a trial.

    Parameters
    ----------
    load : Load
        The applied torque.
    angle : array, shape (n,)
        The angle (rad) behind the sensor, without noise (`Joint.respond`).
    recorder : Recorder
    rng : numpy.random.Generator
    """
    n = angle.size
    time = np.arange(n, dtype=np.float64) * INTERVAL
    sd = np.sqrt(recorder.ratio * np.mean(angle**2))
    rho = recorder.correlation
    shocks = rng.standard_normal(n)
    shocks[1:] *= np.sqrt(1.0 - rho**2)  # the first sample has the stationary spread
    noise = sd * signal.lfilter([1.0], [1.0, -rho], shocks)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    noise += recorder.hum * sd * np.sqrt(2.0) * np.sin(2.0 * np.pi * MAINS * time + phase)
    recorded = angle + noise
    if recorder.resolution:
        recorded = recorder.resolution * np.round(recorded / recorder.resolution)
    torque = load.torque
    if recorder.torque_noise:
        rms = np.sqrt(np.mean(torque**2))
        torque = torque + recorder.torque_noise * rms * rng.standard_normal(n)
    return Trial(time, torque, recorded, driven="torque", name=load.name, condition=load.kind)


def responses(joint: Joint, loads: Sequence[Load], rtol: float = RTOL) -> list[np.ndarray]:
    """Angles (rad) without noise under each torque, arrays of shape (n,)."""
    return [joint.respond(load.torque, INTERVAL, rtol) for load in loads]
