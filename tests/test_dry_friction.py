"""Dry friction whose contact gives, by equations of its own: in either causality it is friction."""

import numpy as np
import pytest
from levels import moved, weighed

from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.effects import BristleFriction, CoulombFriction
from identifiability.benchmark.joints import Joint
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.measurement.trials import Trial

ANATOMY = Anatomy(0.1, 5.0, 0.25, 25.0, 0.75)
BRISTLES = BristleFriction(0.4, 0.45, 0.2, stiffness=400.0, damping=0.2)  # which give by 1 mrad
KEYS = ("coulomb_friction", "short_range_stiffness", "soft_coupling")
RATE, HOLD = 500, 0.25
NOISE = 0.005  # of the response


def record(friction, driven, seconds=2, seed=1):
    """Random levels that are held for a while, of torque or angle."""
    rng = np.random.default_rng(seed)
    joint, time = Joint(ANATOMY, (friction,)), np.arange(RATE * seconds) / RATE
    onsets = np.arange(0.2, seconds - HOLD, HOLD)
    if driven == "torque":
        levels = rng.uniform(-4.0, 4.0, onsets.size)
        knots = np.sort(np.r_[onsets, onsets + 0.03])
        torque = np.interp(time, knots, np.r_[0.0, np.repeat(levels, 2)][: knots.size])
        angle = joint.respond(torque, 1 / RATE)
        angle = angle + NOISE * angle.std() * rng.standard_normal(time.size)
    else:
        levels = rng.uniform(-0.08, 0.08, onsets.size)
        angle, torque = moved(joint, time, onsets, levels, NOISE, rng)
    return Trial(time, torque, angle, driven=driven, name="levels")


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_contact_that_gives_is_friction_and_no_cuff(driven):
    study, found = weighed(record(BRISTLES, driven), KEYS)
    claim = study.claim(found)
    assert claim.kind == "effects"
    assert claim.effects == ("coulomb_friction",)
    values = found.sets["coulomb_friction",].candidate.values
    for name, value in (("K", 30.0), ("B", 1.0), ("I", 0.1)):
        assert values[name] == pytest.approx(value, rel=0.03)
    assert values["coulomb_friction.torque"] == pytest.approx(0.4, rel=0.1)
    assert values["coulomb_friction.range"] == pytest.approx(1e-3, rel=0.3)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_as_a_function_of_the_velocity_alone_it_would_not_be(driven):
    alone = {"coulomb_friction.range": (2e-5, 2.1e-5), "coulomb_friction.velocity": (0.02, 0.3)}
    trial, model = record(BRISTLES, driven, seconds=4), KBI() + EFFECTS["coulomb_friction"]()
    giving, rigid = (
        Investigation([trial], bounds=bounds).fit(model, refined=True).fitted.error
        for bounds in ({}, alone)
    )
    assert giving < 1.2 * NOISE**2
    assert rigid > 4 * giving


def test_friction_that_reverses_at_once_holds_what_it_held():
    """Its angle is held by a servo that creeps to each level, ever more slowly."""
    friction = CoulombFriction(0.4, 0.4, 0.2, "sign")
    _, found = weighed(record(friction, "angle", seconds=4), ("coulomb_friction",))
    assert found.present("coulomb_friction") > 0.99
    torque = found.sets["coulomb_friction",].candidate.values["coulomb_friction.torque"]
    assert torque == pytest.approx(0.4, rel=0.1)
