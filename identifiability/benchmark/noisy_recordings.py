"""Recordings of joints that are exactly K, B and I, with noise of every kind.

By other means than the library's: responses to a torque by SciPy's simulation of a linear system,
torques of an imposed motion from its derivatives in closed form. What varies from recording to
recording is the joint, the perturbation, the sampling rate (100 to 1,000 Hz), the level of the
noise, and whether several short trials or one long record are taken.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import signal

from identifiability.benchmark.motion import Motion
from identifiability.measurement.trials import Trial

KINDS = (
    "white",
    "AR 0.9",
    "AR 0.99",
    "random walk",
    "hum",
    "differenced",
    "encoder",
    "both channels",
)
"""Kinds of noise. That of the response, but for the last two."""

_RATES = (100, 200, 500, 1000)
MAINS_HZ = 50.0


def recording(
    kind: str, imposed: Literal["torque", "angle"], seed: np.random.SeedSequence
) -> tuple[list[Trial], np.ndarray]:
    """Simulate the trials of a joint, and return them with its K, B and I.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    imposed : {"torque", "angle"}
    seed : SeedSequence
    """
    random = np.random.default_rng(seed)
    joint = _joint(random)
    rate = int(random.choice(_RATES[1:] if kind == "hum" else _RATES))
    long = bool(random.random() < 0.5)
    lengths = [int(8.0 * rate)] if long else [int(0.8 * rate)] * 6
    clean = []
    for n in lengths:
        time = np.arange(n) / rate
        clean.append((time, *(_pushed if imposed == "torque" else _moved)(joint, time, random)))
    response = 2 if imposed == "torque" else 1
    size = float(np.sqrt(np.mean([np.var(signals[response]) for signals in clean])))
    stroke = max(float(np.ptp(signals[2])) for signals in clean)
    level = random.uniform(0.01, 0.05)
    trials = []
    for i, (time, torque, angle) in enumerate(clean):
        noise = level * size * noise_of(kind, time.size, rate, random)
        if kind == "encoder":
            step = stroke / 400
            angle = step * np.round(angle / step)
            noise = noise if imposed == "angle" else np.zeros(time.size)
        elif kind == "both channels":
            if imposed == "torque":
                torque = torque + 0.01 * np.std(torque) * random.standard_normal(time.size)
            else:
                angle = angle + stroke / 1000 * random.standard_normal(time.size)
        if imposed == "torque":
            angle = angle + noise
        else:
            torque = torque + noise
        trials.append(Trial(time, torque, angle, driven=imposed, name=f"trial {i + 1}"))
    return trials, joint


def _joint(random: np.random.Generator) -> np.ndarray:
    """K, B and I of a joint between wrist and knee: 1.5 to 6 Hz, damped by 0.2 to 0.8."""
    inertia = 10 ** random.uniform(-2, -0.5)
    pace = 2 * np.pi * random.uniform(1.5, 6.0)
    return np.array([inertia * pace**2, 2 * random.uniform(0.2, 0.8) * inertia * pace, inertia])


def _pushed(
    joint: np.ndarray, time: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Torque and angle, torque imposed: from rest pulses and steps, or random steps at length."""
    stiffness, damping, inertia = joint
    torque = np.zeros(time.size)
    if time[-1] < 2:
        ends = 0.1 + random.uniform(0.03, 0.25), 0.1 + random.uniform(0.3, 0.5)
        torque[(time >= 0.1) & (time < ends[0])] = 1.0
        torque[(time >= ends[0]) & (time < ends[1])] = random.choice([0.0, -1.0, 0.5])
    else:
        holds = random.uniform(-1, 1, time.size)
        every = max(1, round(random.uniform(0.1, 0.3) / (time[1] - time[0])))
        torque = np.repeat(holds, every)[: time.size]
        torque[time < 0.3] = 0.0
    torque *= random.choice([-1, 1]) * random.uniform(0.03, 0.08) * stiffness
    system = signal.lti([1.0], [inertia, damping, stiffness])
    _, angle, _ = signal.lsim(system, torque, time)
    return torque, angle


def _moved(
    joint: np.ndarray, time: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Torque and angle, angle imposed: smooth steps, whose derivatives are known."""
    pace = min(100.0, 0.6 / (time[1] - time[0]))
    hold = random.uniform(0.15, 0.3)
    onsets = np.arange(0.1, time[-1] - 0.1, hold)
    heights = np.diff(random.uniform(-0.04, 0.04, onsets.size), prepend=0.0)
    motion = Motion(onsets, heights, pace).at(time)
    return joint @ motion, motion[0]


def noise_of(kind: str, n: int, rate: int, random: np.random.Generator) -> np.ndarray:
    """Noise of one trial, of about unit size."""
    white = random.standard_normal(n)
    if kind.startswith("AR"):
        rho = float(kind.split()[1])
        run = random.standard_normal(n + 3000)
        coloured: np.ndarray = signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], run)[3000:]
        return coloured
    if kind == "random walk":
        return np.asarray(np.cumsum(white) * 2 / np.sqrt(n))
    if kind == "hum":
        phase = 2 * np.pi * (MAINS_HZ * np.arange(n) / rate + random.random())
        return np.asarray(np.sqrt(2) * np.sin(phase) + 0.2 * white)
    if kind == "differenced":
        return np.asarray(np.diff(np.append(random.standard_normal(), white)) / np.sqrt(2))
    return white
