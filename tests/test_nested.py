"""The choice is made again without the held-out trials, whose errors are quoted."""

import numpy as np
import pytest
from hidden import HELD, JOINT, trials

from identifiability.investigation.session import Investigation
from identifiability.investigation.verdict.judge import _without_held_out
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.measurement.trials import Trial

KEY = "cubic_stiffness"
LARGE = [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6)]
SMALL = [(kind, size / 100) for kind, size in LARGE]
COEFFICIENT = {"torque": 60.0, "angle": 1000.0}


def study_of(driven, conditions):
    model = KBI() + EFFECTS[KEY]()
    values = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT
    values["cubic_stiffness.coefficient"] = COEFFICIENT[driven]
    rng = np.random.default_rng(3)
    fitted, held_out = (
        trials(model, values, rng, conditions=c, driven=driven) for c in (conditions, HELD)
    )
    return Investigation(fitted, held_out, library={KEY: EFFECTS[KEY]}, lowpass_hz=None)


@pytest.mark.parametrize(
    ("driven", "conditions", "kind"),
    [("torque", LARGE, "chosen alike"), ("angle", SMALL, "chosen with")],
)
def test_it_says_whether_held_out_trials_had_a_say(driven, conditions, kind):
    """A cubic stiffness is in all trials, or shows in those alone that are held out."""
    study = study_of(driven, conditions)
    posterior = study.weigh()
    claim = study.claim(posterior)
    assert claim.sets == (("cubic_stiffness",),)
    nested = study.weigh_nested(posterior)
    reason = _without_held_out(claim, nested, study.split)
    assert reason.kind == kind
    assert reason.numbers["probability"] == nested.claim([["cubic_stiffness"]])


def test_half_of_one_record_is_left_out():
    t = np.arange(3000) / 500
    rng = np.random.default_rng(5)
    given = 4 * np.repeat(rng.choice([-1.0, 1.0], 150), 20)
    (record,) = trials(KBI(), JOINT, time=t, conditions=[("step", 1.0)])
    study = Investigation([Trial(t, given, record.angle, driven="torque", name="one")])
    band = study._evaluator(1).band
    half = band.without(study.split.held_out_rule, study.split.held_out_numbers)
    (whole,), (part,) = band.prepared, half.prepared
    assert (part.first, part.last) == (whole.first, (whole.first + whole.last) // 2)
    assert half.n_samples == pytest.approx(band.n_samples / 2, abs=1)
