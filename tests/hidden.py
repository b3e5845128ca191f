"""Trials of joints with hidden effects, short ones from rest and a record without rest."""

import numpy as np

from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial

TIME = np.arange(250) / 500
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
CONDITIONS = [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6)]


def torque(time: np.ndarray, kind: str, size: float) -> np.ndarray:
    if kind == "pulse":
        return size * ((time > 0.05) & (time <= 0.1))
    return size * (time > 0.05)


def turned(time: np.ndarray, kind: str, size: float) -> np.ndarray:
    """Angle of a smooth push or step, by a fiftieth of the size."""
    rise = np.clip((time - 0.12) / 0.05, 0, 1)
    back = np.clip((time - 0.2) / 0.05, 0, 1) if kind == "pulse" else 0 * time
    there, again = (10 * s**3 - 15 * s**4 + 6 * s**5 for s in (rise, back))
    return 0.02 * size * (there - again)


def trials(
    model, values, seed=1, noise=1e-3, conditions=None, driven="torque", time=TIME, like=None
):
    """Trials of a model of the library, with white noise of a relative size in the response.

    Or in that of another model and values they are `like`.
    """
    conditions = conditions or CONDITIONS
    rng = np.random.default_rng(seed)
    theta = model.vector(values)
    out = []
    for i, (kind, size) in enumerate(conditions):
        if driven == "torque":
            given = torque(time, kind, size)
            drive = SampledTorque(given).drive(time)
        else:
            given = turned(time, kind, size)
            drive = imposed_motion(time, given)
        response = simulate(model, theta, drive)
        usual = simulate(like[0], like[0].vector(like[1]), drive) if like else response
        sd = noise * np.sqrt(np.mean(usual**2))
        noisy = response + sd * rng.standard_normal(response.size)
        pair = (given, noisy) if driven == "torque" else (noisy, given)
        out.append(Trial(time, *pair, driven=driven, name=f"t{i}", condition=kind))
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


PAIR = JOINT | {
    "cubic_stiffness.coefficient": 120.0,
    "cubic_stiffness.centre": 0.0,
    "sensor_delay.delay": 0.004,
}


def study_of_a_pair(driven, keys):
    """Of a joint with a cubic spring and a delayed sensor, by some of the library."""
    model = KBI() + EFFECTS["cubic_stiffness"]() + EFFECTS["sensor_delay"]()
    size = 1.0 if driven == "torque" else 6.0
    fitted, held = (
        trials(model, PAIR, seed, conditions=c, driven=driven)
        for seed, c in ((3, [(k, size * s) for k, s in CONDITIONS]), (4, HELD))
    )
    return Investigation(fitted, held, library={key: EFFECTS[key] for key in keys})


LONG = {
    "torque": {"cubic_stiffness.coefficient": 40.0, "cubic_stiffness.centre": 0.0},
    "angle": {"maxwell_branch.stiffness": 15.0, "maxwell_branch.time_constant": 0.1},
}
_SECONDS = {"torque": 18, "angle": 48}  # of an angle fewer samples a second are compared


def long_record(driven, smoothing=(81, 41), more=None):
    """A record of random steps, in many pieces, and the model that it was made with.

    The steps of an imposed angle are smoothed by windows of so many samples. `more` are values of
    effects that are there as well.
    """
    time = np.arange(1000 * _SECONDS[driven]) / 1000
    values = LONG[driven] | (more or {})
    model = KBI().plus(EFFECTS[key]() for key in dict.fromkeys(n.split(".")[0] for n in values))
    rng = np.random.default_rng(5)
    steps = np.repeat(rng.uniform(-1, 1, time.size // 150), 150)
    if driven == "torque":
        given = 20 * steps
        drive = SampledTorque(given).drive(time)
    else:
        given = 0.1 * steps
        for n in smoothing:
            given = np.convolve(given, np.hanning(n) / np.hanning(n).sum(), mode="same")
        drive = imposed_motion(time, given)
    response = simulate(model, model.vector(JOINT | values), drive)
    noisy = response + 1e-3 * np.std(response) * rng.standard_normal(time.size)
    pair = (given, noisy) if driven == "torque" else (noisy, given)
    return Trial(time, *pair, driven=driven, name="long"), model
