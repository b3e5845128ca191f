"""Records of a joint that is moved from level to level, and what an investigation makes of one."""

import numpy as np

from identifiability.benchmark.motion import Motion, reaction
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS


def moved(joint, time, onsets, levels, noise, rng):
    """Angle and torque of a joint that a servo moves to levels of angle; both channels noisy."""
    motion = Motion(onsets, np.diff(np.r_[0.0, levels]), 60.0)
    angle, torque = motion.at(time)[0], reaction(joint, motion, time)
    torque = torque + noise * torque.std() * rng.standard_normal(time.size)
    return angle + 2e-6 * rng.standard_normal(time.size), torque


def weighed(trial, keys, **options):
    """An investigation by few effects, and their probabilities."""
    study = Investigation([trial], library={key: EFFECTS[key] for key in keys}, **options)
    return study, study.weigh()
