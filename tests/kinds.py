"""The effects that are held to the contract, and how they are run."""

import numpy as np

from identifiability.joint.effects import (
    EFFECTS,
    RelaxationSpectrum,
    StiffeningHysteresis,
)
from identifiability.joint.effects.base import Effect
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import SampledTorque, imposed_motion


class ParallelSpring(Effect):
    """A second spring over the joint, the same in both directions: what one's own effect needs."""

    key = "parallel_spring"
    title = "a second spring"
    place = "joint"
    linear = True
    parameters = (
        Parameter("stiffness", "k", "Nm/rad", 5.0, 0.0, 100.0, "parallel stiffness", null=0.0),
    )
    references = ("Hooke 1678, De Potentia Restitutiva",)

    def torque(self, p, motion, states, delayed):
        return p[0] * motion.angle


DESCRIPTIONS = (RelaxationSpectrum, StiffeningHysteresis)
KINDS = EFFECTS | {kind.key: kind for kind in (*DESCRIPTIONS, ParallelSpring)}
LINEAR = [key for key in sorted(KINDS) if KINDS[key].linear]

TIME = np.arange(201) * 1e-3
BUMP = np.where(TIME < 0.1, np.sin(np.pi * TIME / 0.1) ** 4, 0.0)
TORQUE = 10 * BUMP
DRIVES = {
    "torque": SampledTorque(TORQUE).drive(TIME),
    "angle": imposed_motion(TIME, 0.05 * BUMP),
}
KBI_VALUES = {"K": 50.0, "B": 2.0, "I": 0.1}

# Values away from the plain form, and from where a response bends as a function of a parameter:
# an asymmetry or a threshold of 0, a delay of whole samples; and where all of them show.
GENERIC = {
    "backlash": {"place": 0.9, "rounding": 0.3, "stickiness": 0.3},
    "coulomb_friction": {
        "velocity": 0.07,
        "damping": 0.5,
        "breakaway": 0.3,
        "breakaway_velocity": 0.2,
        "asymmetry": 0.2,
    },
    "cubic_stiffness": {"centre": -0.05},
    "damping_by_angle": {"middle": 0.02},
    "end_stop": {"side": 0.3, "middle": 0.01, "rounding": 0.004},
    "hill_force_velocity": {"asymmetry": 0.3},
    "nonlinear_tendon": {"asymmetry": 0.3, "bypass_stiffness": 4.0, "bypass_damping": 0.2},
    "quadratic_stiffness": {"hardening": 3.0},
    "sensor_delay": {"delay": 0.0033},
    "sensor_drift": {"bend": 0.1, "twist": 0.1},
    "sensor_lowpass": {"shape": 0.3},
    "series_tendon": {"bypass_stiffness": 4.0, "bypass_damping": 0.2},
    "short_range_stiffness": {"renewal": 5.0, "sharpness": 3.0},
    "stiffening_hysteresis": {"renewal": 5.0, "sharpness": 3.0, "reversal": -0.5},
    "stretch_reflex": {
        "asymmetry": 0.3,
        "threshold": 0.2,
        "off_ratio": 1.7,
        "damping_ratio": 0.8,
        "delay": 0.0203,
    },
}


def values_of(model, **changes):
    """Parameter vector: the KBI above, effects at generic values, some changed by name."""
    values = dict(zip(model.parameter_names, model.nominal, strict=True)) | KBI_VALUES
    for key in model.effect_keys:
        values |= {f"{key}.{name}": value for name, value in GENERIC.get(key, {}).items()}
    return model.vector(values | changes)


def nulls_of(effect):
    return {f"{effect.key}.{p.name}": p.null for p in effect.parameters if p.null is not None}


def respond(model, values, drive, order=4):
    """Integrated responses with one step a sample, shape (..., 201)."""
    return simulate(model, values, drive, scheme=Scheme(1, order))
