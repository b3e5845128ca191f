"""Example trials that come with the package: a simulated forearm, perturbed about the elbow.

The joint is the paper's musculoskeletal model, so fitting K, B and I to it shows what the paper
warns of. The trials are made by an integrator of their own, SciPy's, and carry measurement noise;
they are simulated and say so.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from identifiability.files import write_text
from identifiability.measurement.readers.trial_file import read_trial
from identifiability.measurement.trials import Trial

K_CE, B_CE, K_SE, INERTIA = 32.0, 3.2, 100.0, 0.1
NOISE_SD, SEED = 3e-4, 20110527
LEAD, DURATION, INTERVAL = 0.05, 0.45, 0.001
# Pulses of 20 ms with flanks of one sample, the torque being linear between samples.
PULSES = {"flexion": 8.0, "extension": -8.0}


def example_trials() -> list[Trial]:
    """Two simulated trials, torque pulses towards flexion and extension, 1 kHz."""
    trials = []
    for name in PULSES:
        with as_file(files("identifiability.measurement") / "data" / f"elbow_{name}.csv") as path:
            trials.append(read_trial(path))
    return trials


def write_example(folder: Path) -> None:
    """Simulate the example trials anew and write them to a folder."""
    time = np.arange(0, DURATION + INTERVAL / 2, INTERVAL)
    seeds = np.random.SeedSequence(SEED).spawn(len(PULSES))
    for (name, amplitude), seed in zip(PULSES.items(), seeds, strict=True):
        torque = np.where((time > LEAD + 5e-4) & (time < LEAD + 0.0205), amplitude, 0.0)
        angle = _simulate(time, torque)
        angle = angle + NOISE_SD * np.random.default_rng(seed).standard_normal(time.size)
        rows = (f"{t:.3f},{m:.4f},{a:.6f}" for t, m, a in zip(time, torque, angle, strict=True))
        text = "\n".join(["# simulated, not measured", "time_s,torque_Nm,angle_rad", *rows]) + "\n"
        write_text(Path(folder) / f"elbow_{name}.csv", text)


def _simulate(time: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Angle [rad] of the musculoskeletal model; states: angle, velocity, contractile element."""

    def rates(t: float, state: np.ndarray) -> list[float]:
        angle, velocity, element = state
        tension = K_SE * (angle - element)
        applied = np.interp(t, time, torque)
        return [velocity, (applied - tension) / INERTIA, (tension - K_CE * element) / B_CE]

    solution = solve_ivp(
        rates, (0.0, time[-1]), np.zeros(3), t_eval=time, rtol=1e-9, atol=1e-12, max_step=INTERVAL
    )
    return solution.y[0]
