"""Trials of joints with hidden effects, short ones from rest and a record without rest."""

import numpy as np

from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial

TIME = np.arange(500) / 1000
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}


def torque(kind: str, size: float) -> np.ndarray:
    if kind == "pulse":
        return size * ((TIME > 0.05) & (TIME <= 0.1))
    return size * (TIME > 0.05)


def trials(model, values, seed=1, noise=1e-3, conditions=None):
    """Torque-driven trials of a model of the library, with white noise of a relative size."""
    conditions = conditions or [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6)]
    rng = np.random.default_rng(seed)
    theta = model.vector(values)
    out = []
    for i, (kind, size) in enumerate(conditions):
        drive = SampledTorque(torque(kind, size)).drive(TIME)
        angle = simulate(model, theta, drive)
        sd = noise * np.sqrt(np.mean(angle**2))
        noisy = angle + sd * rng.standard_normal(angle.size)
        out.append(Trial(TIME, torque(kind, size), noisy, name=f"t{i}", condition=kind))
    return out


HELD = [("pulse", -8), ("step", 6)]


def record_that_grows(model, values, seed=1, noise=1e-3):
    """One record without rest: a torque that switches at random, ever larger."""
    t = np.arange(4000) / 1000
    rng = np.random.default_rng(seed)
    u = 8 * t / t[-1] * np.repeat(rng.choice([-1.0, 1.0], 200), 20)
    angle = simulate(model, model.vector(values), SampledTorque(u).drive(t))
    sd = noise * np.sqrt(np.mean(angle**2))
    return Trial(t, u, angle + sd * rng.standard_normal(t.size), name="growing")
