"""The smallest effects that would have been seen: simulated at that size, they are."""

import numpy as np
import pytest
from hidden import CONDITIONS, HELD, JOINT, trials
from scipy.stats import binom

from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation
from identifiability.investigation.smallest_seen.hidden import Hidden, Known
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI

QUICK = [
    ("cubic_stiffness", "torque", "Nm/rad³"),
    # An infinite stiffness is none: its size is where it is seen no more.
    ("series_tendon", "angle", "Nm/rad"),
    # A torque with corners passes the filter that the recorded one did; its noise has passed it.
    ("coulomb_friction", "angle", "Nm"),
    pytest.param("series_tendon", "torque", "Nm/rad", marks=pytest.mark.long),
]
NAMES = {
    "cubic_stiffness": "coefficient",
    "series_tendon": "stiffness",
    "coulomb_friction": "torque",
}
ALL = (CONDITIONS, HELD)
SOME = (CONDITIONS[::3], HELD[:1])


def study_of(model, values, seed, library, driven="torque", rules=None, some=ALL):
    """Trials of a model, with the noise that those of K, B and I have."""
    rng = np.random.default_rng(seed)
    fitted, held = (
        trials(model, values, rng, conditions=c, driven=driven, like=(KBI(), JOINT)) for c in some
    )
    return Investigation(fitted, held, library=library, lowpass_hz=None, rules=rules)


def smallest_of(library, driven="torque", draws=None, some=ALL):
    """Smallest effects that trials of K, B and I would have shown, by key."""
    rules = Rules() if draws is None else Rules(noise_draws=draws)
    study = study_of(KBI(), JOINT, 1, library, driven, rules, some)
    return {d.key: d for d in study.smallest_seen(study.baseline)}


def hidden_in(key, driven):
    """An effect that trials of K, B and I may hide."""
    study = study_of(KBI(), JOINT, 1, {key: EFFECTS[key]}, driven)
    evaluator = study._evaluator(1)
    plain = evaluator.evaluate(KBI(), [study.baseline.values])
    known = Known.of(evaluator, plain, [key], study.bench.rules, seed=1)
    return Hidden(known, KBI() + EFFECTS[key](), key)


def claimed(key, values, seed, driven="torque", some=ALL):
    """Whether an effect of these values is claimed under one draw of the noise."""
    kind = EFFECTS[key]
    study = study_of(KBI() + kind(), values, seed, {key: kind}, driven, some=some)
    return study.claim(study.weigh()).kind == "effects"


def weaker(one, factor):
    """Values with the effect so many times smaller; a tendon so many times stiffer."""
    model = KBI() + EFFECTS[one.key]()
    null = model.parameters[one.parameter].null
    size = null + (one.size - null) / factor if np.isfinite(null) else factor * one.size
    return one.values | {one.parameter: size}


@pytest.mark.parametrize(("key", "driven", "unit"), QUICK)
def test_it_is_seen_at_the_stated_size_and_not_at_a_third(key, driven, unit):
    one = smallest_of({key: EFFECTS[key]}, driven, draws=2, some=SOME)[key]
    assert (one.parameter, one.unit) == (f"{key}.{NAMES[key]}", unit)
    assert one.values[one.parameter] == one.size
    assert one.values["K"] == pytest.approx(JOINT["K"], rel=0.01)
    # All of two draws each way are as hard on a size that is wrong as two of three are.
    assert all(claimed(key, one.values, seed, driven, SOME) for seed in (100, 101))
    assert not any(claimed(key, weaker(one, 3), seed, driven, SOME) for seed in (200, 201))


def test_an_error_of_integration_is_no_trace():
    """One step a sample makes a tendon of 20 kNm/rad differ from none; a finer one does not."""
    hidden = hidden_in("nonlinear_tendon", "angle")
    ((gain, _),) = hidden.gained(1 / 20e3)
    assert gain < -2


def test_corners_count_as_far_as_the_compared_band_goes():
    """A recorder that compares up to some frequency does not see the corners of friction."""
    key = "coulomb_friction"
    hidden = hidden_in(key, "angle")
    ((gain, _),) = hidden.gained(0.18)
    values = hidden.values(0.18)
    study = study_of(KBI() + EFFECTS[key](), values, 100, {key: EFFECTS[key]}, "angle")
    there = study.weigh().of([key])
    assert abs(gain - np.log(there / (1 - there) * 0.05 / 0.95)) < 8


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_noise_is_drawn_from_the_order_that_made_it(driven):
    """Trials with white noise; weighed by AICc it would have gaps."""
    order = hidden_in("gravity", driven).known.noise.contenders[0].order
    assert (order.p, order.q) == (0, 0)


@pytest.mark.long
def test_evidence_of_a_slow_trace_grows_less_than_its_square():
    """Where noise may have its colour, and then draws differ less than in known noise."""
    hidden = hidden_in("gravity", "torque")
    weak, strong = (hidden.gained(size, range(1, 7)) for size in (0.19, 0.57))
    likelihoods = [np.median([gain + penalty for gain, penalty in all_]) for all_ in (weak, strong)]
    assert likelihoods[1] < 4 * likelihoods[0]  # 9 times in known noise
    assert np.std([gain for gain, _ in strong]) < 0.7 * np.sqrt(2 * likelihoods[1])


DRAWS = 20

# As they came out. Of 76 bounds at 5 %, four are out by chance alone where every row is right.
FAR = {
    ("stretch_reflex", "torque"): "20 of 20 at the stated size, 5 of 20 at a third",
    # Some torque of the angle, or with hysteresis, is nearly as probable, whatever the size.
    ("gravity", "angle"): "20 of 20 at the stated size, 12 of 20 at a third",
    ("short_range_stiffness", "angle"): "11 of 20 at the stated size, 5 of 20 at a third",
}
CASES = [
    pytest.param(key, driven, marks=[pytest.mark.xfail(reason=why)] if why else [])
    for key in EFFECTS
    if key != "backlash"  # which has no one size
    for driven in ("torque", "angle")
    for why in [FAR.get((key, driven))]
]


@pytest.mark.long
@pytest.mark.parametrize(("key", "driven"), CASES)
def test_nine_of_ten_at_the_stated_size_and_one_of_ten_at_a_third(key, driven):
    one = smallest_of({key: EFFECTS[key]}, driven)[key]
    seen = sum(claimed(key, one.values, seed, driven) for seed in range(100, 100 + DRAWS))
    less = sum(claimed(key, weaker(one, 3), seed, driven) for seed in range(200, 200 + DRAWS))
    print(f"{key}, {driven}: {seen} of {DRAWS} at the stated size, {less} at a third")
    # What so many draws allow.
    assert binom.cdf(seen, DRAWS, 0.9) > 0.05, (seen, less)
    assert binom.sf(less - 1, DRAWS, 0.1) > 0.05, (seen, less)
