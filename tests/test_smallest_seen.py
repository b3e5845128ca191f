"""The smallest effects that would have been seen: simulated at that size, they are."""

import numpy as np
import pytest
from scipy.stats import binom

from identifiability.investigation.search.smallest_seen import _Hidden, detectable
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial

TIME = np.arange(500) / 1000
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
NOISE = 1e-3  # share of each trial's root mean square
FITTED = [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6)]
HELD = [("pulse", -8), ("step", 6)]
QUICK = [
    ("cubic_stiffness", "torque"),
    ("series_tendon", "torque"),
    ("quadratic_stiffness", "angle"),
]


def imposed(kind, size):
    """Torque of a push or a step, or, where the angle is imposed, its smooth counterpart."""
    rise = np.clip((TIME - 0.12) / 0.05, 0, 1)
    back = np.clip((TIME - 0.2) / 0.05, 0, 1) if kind == "pulse" else 0 * TIME
    smooth = [10 * s**3 - 15 * s**4 + 6 * s**5 for s in (rise, back)]
    return {
        "torque": size * (TIME > 0.05) * ((TIME <= 0.1) | (kind == "step")),
        "angle": 0.02 * size * (smooth[0] - smooth[1]),
    }


def trials(model, values, rng, conditions, driven):
    """Trials of a model of the library with a tenth of a percent of white noise."""
    out = []
    for i, (kind, size) in enumerate(conditions):
        given = imposed(kind, size)[driven]
        drive = SampledTorque(given).drive(TIME)
        if driven == "angle":
            drive = imposed_motion(TIME, given)
        response = simulate(model, model.vector(values), drive)
        sd = NOISE * np.sqrt(np.mean(response**2))
        noisy = response + sd * rng.standard_normal(response.size)
        torque, angle = (given, noisy) if driven == "torque" else (noisy, given)
        out.append(Trial(TIME, torque, angle, driven=driven, name=f"t{i}", condition=kind))
    return out


def study_of(model, values, seed, library, driven="torque"):
    rng = np.random.default_rng(seed)
    fitted, held = (trials(model, values, rng, c, driven) for c in (FITTED, HELD))
    return Investigation(fitted, held, library=library, lowpass_hz=None)


def smallest_of(library, driven="torque"):
    """Smallest effects that trials of K, B and I would have shown, by key."""
    study = study_of(KBI(), JOINT, 1, library, driven)
    return {d.key: d for d in detectable(study.bench, study.fit(KBI()), library)}


def admitted(key, values, seed, driven="torque"):
    """Whether the search admits an effect of these values under one draw of the noise."""
    kind = EFFECTS[key]
    study = study_of(KBI() + kind(), values, seed, {key: kind}, driven)
    return study.rank(study.fit(KBI())).ranked[0].passes


def weaker(one, factor):
    """Values with the effect so many times smaller; a tendon so many times stiffer."""
    model = KBI() + EFFECTS[one.key]()
    null = model.parameters[one.parameter].null
    size = null + (one.size - null) / factor if np.isfinite(null) else factor * one.size
    return one.values | {one.parameter: size}


@pytest.mark.parametrize(("key", "driven"), QUICK)
def test_it_is_seen_at_the_stated_size_and_not_at_a_third(key, driven):
    one = smallest_of({key: EFFECTS[key]}, driven)[key]
    assert sum(admitted(key, one.values, seed, driven) for seed in range(100, 106)) >= 5
    assert sum(admitted(key, weaker(one, 3), seed, driven) for seed in range(200, 206)) <= 1


def test_an_error_of_integration_is_no_trace():
    """One step a sample makes a tendon of 20 kNm/rad differ from none; a finer one does not."""
    key = "nonlinear_tendon"
    study = study_of(KBI(), JOINT, 1, {key: EFFECTS[key]}, "angle")
    hidden = _Hidden(study.bench, study.baseline, KBI() + EFFECTS[key](), key)
    trace = hidden.trace(1 / 20e3, hidden.model_free_start)
    assert sum(trace.expected) < 1
    assert not trace.seen


def test_its_record():
    key = "series_tendon"
    one = smallest_of({key: EFFECTS[key]})[key]
    assert (one.parameter, one.unit) == ("series_tendon.stiffness", "Nm/rad")
    assert one.values["series_tendon.stiffness"] == one.size
    assert one.values["K"] == pytest.approx(JOINT["K"], rel=0.01)


DRAWS = 20


@pytest.mark.long
@pytest.mark.parametrize("driven", ["torque", "angle"])
@pytest.mark.parametrize("key", EFFECTS)
def test_nine_of_ten_at_the_stated_size_and_one_of_ten_at_a_third(key, driven):
    one = smallest_of({key: EFFECTS[key]}, driven)[key]
    seen = sum(admitted(key, one.values, seed, driven) for seed in range(100, 100 + DRAWS))
    less = sum(admitted(key, weaker(one, 3), seed, driven) for seed in range(200, 200 + DRAWS))
    # What so many draws allow for one of twice as many effects.
    assert binom.cdf(seen, DRAWS, 0.9) > 0.001, (seen, less)
    assert binom.sf(less - 1, DRAWS, 0.1) > 0.001, (seen, less)
