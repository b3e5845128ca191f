"""Play before a limb that leans against one side of it, by equations of its own."""

import numpy as np
import pytest
from levels import moved, weighed

from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.effects import Backlash
from identifiability.benchmark.joints import Joint
from identifiability.measurement.trials import Trial

LIMB = Anatomy(0.08, 4.0, 0.2, 20.0, 1.0)
PLAY = Backlash(900.0, 1.5, 0.02, LIMB, 0.005)
JOINT, LINK = {"K": 24.0, "B": 1.2, "I": 0.1}, {"backlash.gap": 0.005, "backlash.share": 0.2}
RATE, SECONDS, HOLD, NOISE = 500, 4, 0.3, 0.002
LOAD, SETTLED = 1.5, 1.0  # Nm, and s before a record of torque begins


def record(driven, seed=3):
    """Random levels, of torque about a load, or of angle without a lead: the limb leans."""
    rng = np.random.default_rng(seed)
    joint, time = Joint(PLAY.handle(), (PLAY,)), np.arange(RATE * SECONDS) / RATE
    if driven == "torque":
        time = np.arange(RATE * (SECONDS + SETTLED)) / RATE
        onsets = np.arange(SETTLED + 0.2, time[-1], HOLD)
        knots = np.sort(np.r_[onsets, onsets + 0.05])
        levels = LOAD + rng.uniform(-3.0, 1.5, onsets.size)
        torque = np.interp(time, knots, np.r_[LOAD, np.repeat(levels, 2)][: knots.size])
        angle = joint.respond(torque, 1 / RATE)
        kept = time >= SETTLED
        time, torque, angle = time[kept] - SETTLED, torque[kept], angle[kept]
        angle = angle + NOISE * angle.std() * rng.standard_normal(time.size)
    else:
        onsets = np.arange(0.0, SECONDS, HOLD)
        levels = rng.uniform(-0.06, 0.12, onsets.size)
        angle, torque = moved(joint, time, onsets, levels, NOISE, rng)
    return Trial(time, torque, angle, driven=driven, name="levels")


@pytest.mark.parametrize(("driven", "level_of"), [("torque", "lead"), ("angle", "record")])
def test_play_in_which_the_limb_leans_is_play_and_no_stop(driven, level_of):
    trial = record(driven)
    study, found = weighed(trial, ("backlash", "end_stop"))
    assert study.split.fitted[0].treatment.level_of == level_of
    assert study.claim(found).effects == ("backlash",)
    leaning = found.sets["backlash",]
    values = leaning.candidate.values
    # Its contact comes at once, which the plain form makes of a wider gap.
    for name, value in (JOINT | LINK).items():
        assert values[name] == pytest.approx(value, rel=0.02 if name in JOINT else 0.15), name
    assert 1.0 < abs(values["backlash.place"]) < 1.5
    # A limb that hangs in the middle would not have left it so.
    _, hanging = weighed(trial, ("backlash",), bounds={"backlash.place": (0.0, 1e-3)})
    assert leaning.log_evidence > hanging.sets["backlash",].log_evidence + 100
