"""The smallest effects that would have been seen: simulated at that size, they are."""

import numpy as np
import pytest

from identifiability.investigation.search.smallest_seen import detectable
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial

TIME = np.arange(500) / 1000
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
NOISE = 1e-3  # share of each trial's root mean square
FITTED = [("pulse", 8), ("pulse", -16), ("step", 4), ("step", -6)]
HELD = [("pulse", -8), ("step", 6)]
QUICK = ("cubic_stiffness", "series_tendon")


def trials(model, values, rng, conditions):
    """Trials of a model of the library with a tenth of a percent of white noise."""
    out = []
    for i, (kind, size) in enumerate(conditions):
        torque = size * (TIME > 0.05) * ((TIME <= 0.1) | (kind == "step"))
        drive = SampledTorque(torque).drive(TIME)
        angle = simulate(model, model.vector(values), drive)
        noisy = angle + NOISE * np.sqrt(np.mean(angle**2)) * rng.standard_normal(angle.size)
        out.append(Trial(TIME, torque, noisy, name=f"t{i}", condition=kind))
    return out


def study_of(model, values, seed, library):
    rng = np.random.default_rng(seed)
    fitted, held = (trials(model, values, rng, c) for c in (FITTED, HELD))
    return Investigation(fitted, held, library=library)


def admitted(key, values, seed):
    """Whether the search admits an effect of these values under one draw of the noise."""
    kind = EFFECTS[key]
    study = study_of(KBI() + kind(), values, seed, {key: kind})
    return study.rank(study.fit(KBI())).ranked[0].passes


def weaker(one, factor):
    """Values with the effect so many times smaller; a tendon so many times stiffer."""
    model = KBI() + EFFECTS[one.key]()
    null = model.parameters[one.parameter].null
    size = null + (one.size - null) / factor if np.isfinite(null) else factor * one.size
    return one.values | {one.parameter: size}


@pytest.fixture(scope="module")
def smallest():
    library = {key: EFFECTS[key] for key in QUICK}
    study = study_of(KBI(), JOINT, 1, library)
    return {d.key: d for d in detectable(study.bench, study.fit(KBI()), library)}


@pytest.mark.parametrize("key", QUICK)
def test_it_is_seen_at_the_stated_size_and_not_at_a_third(smallest, key):
    one = smallest[key]
    assert sum(admitted(key, one.values, seed) for seed in range(10, 16)) >= 5
    assert sum(admitted(key, weaker(one, 3), seed) for seed in range(20, 26)) <= 1


def test_its_record(smallest):
    one = smallest["series_tendon"]
    assert (one.parameter, one.unit) == ("series_tendon.stiffness", "Nm/rad")
    assert one.values["series_tendon.stiffness"] == one.size
    assert one.values["K"] == pytest.approx(JOINT["K"], rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("key", EFFECTS)
def test_nine_of_ten_at_the_stated_size_and_one_of_ten_at_a_third(key):
    library = {key: EFFECTS[key]}
    study = study_of(KBI(), JOINT, 1, library)
    (one,) = detectable(study.bench, study.fit(KBI()), library)
    assert sum(admitted(key, one.values, seed) for seed in range(10, 20)) >= 9
    assert sum(admitted(key, weaker(one, 3), seed) for seed in range(20, 30)) <= 1
