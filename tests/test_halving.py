"""Models that are not linear are seen through the filter that cut off the noise of an angle."""

from dataclasses import replace

import numpy as np
import pytest

from identifiability.inference.problem import Problem
from identifiability.inference.starts import nested_values
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.posterior.halving import _begun_before, halve, without_level
from identifiability.investigation.posterior.noises import raw_residuals
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.trials import Trial

JOINT = {"K": 8.0, "B": 0.3, "I": 0.05}
FRICTION = KBI() + EFFECTS["coulomb_friction"]()
RUBBING = JOINT | {
    "coulomb_friction.torque": 0.3,
    "coulomb_friction.velocity": 0.02,
    "coulomb_friction.range": 2e-5,
    "coulomb_friction.breakaway": 0.0,
    "coulomb_friction.asymmetry": 0.0,
}
ANGLE_SD = 2e-4


def to_and_fro(seconds=10.0, rate=500, *, friction=0.3, seed=0):
    """A joint that is moved slowly to and fro, by equations of its own; both channels noisy."""
    random, time = np.random.default_rng(seed), np.arange(int(rate * seconds)) / rate
    size = 0.2 * np.clip(time, 0.0, 1.0) ** 2 * (3 - 2 * np.clip(time, 0.0, 1.0))
    rise = np.where(time < 1.0, 0.2 * 6 * time * (1 - time), 0.0)
    bend = np.where(time < 1.0, 0.2 * (6 - 12 * time), 0.0)
    w = 2 * np.pi
    wave, slope = np.sin(w * time), w * np.cos(w * time)
    angle, velocity = size * wave, rise * wave + size * slope
    acceleration = bend * wave + 2 * rise * slope - w**2 * angle
    torque = 8.0 * angle + 0.3 * velocity + 0.05 * acceleration
    torque += friction * np.tanh(velocity / 0.02)
    torque += 0.01 * torque.std() * random.standard_normal(time.size)
    angle = angle + ANGLE_SD * random.standard_normal(time.size)
    return Trial(time, torque, angle, driven="angle", name="to and fro")


def left(band, model, values):
    """What a model leaves at given values [Nm], root mean square."""
    problem = band.problem(model)
    parts = without_level(band.residuals(problem, problem.free_vector(values)), band.trial)
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def test_a_linear_model_is_the_same_on_either_side_of_the_filter():
    band = band_of([to_and_fro()], [])
    assert band.whole
    model = KBI()
    by_motion = band.problem(model)
    x = by_motion.free_vector(JOINT)
    before = without_level(
        band.stretches(by_motion.by_observation(by_motion.residuals(x)[:, None])), band.trial
    )
    through = replace(by_motion, observations=[w.observation for w in band._windows])
    rows = through.by_observation(through.residuals(x)[:, None])
    seen = [
        w.compared(r, band.every, w.observation.measured)
        for w, r in zip(band._windows, rows, strict=True)
    ]
    gap = np.abs(np.concatenate(before) - np.concatenate(without_level(seen, band.trial)))
    # But for the end, where both have to guess.
    assert gap[:-2].max() < 5e-5 * band.scale
    assert gap.max() < 0.005 * band.scale


def test_another_response_to_the_same_motion_is_compared_as_it_is():
    """What was recorded has passed the filter: between the compared samples it does not count."""
    band = band_of([to_and_fro()], [])
    problem = band.problem(FRICTION)
    assert band.sees_whole(FRICTION)
    x = problem.free_vector(RUBBING)
    changed = [np.zeros(o.measured.size) for o in problem.observations]
    random = np.random.default_rng(1)
    places = [s + begin for s, begin in zip(band.samples, band.earlier(FRICTION), strict=True)]
    for one, chosen in zip(changed, places, strict=True):
        one[chosen] = random.standard_normal(chosen.size)
    observations = [
        replace(o, measured=o.measured + one)
        for o, one in zip(problem.observations, changed, strict=True)
    ]
    other = replace(problem, observations=observations)
    before, after = (raw_residuals(one, band, x)[0] for one in (problem, other))
    moved = [a - b for a, b in zip(after, before, strict=True)]
    expected = without_level(
        [-one[chosen, None] for one, chosen in zip(changed, places, strict=True)], band.trial
    )
    for one, wanted in zip(moved, expected, strict=True):
        assert one[:, 0] == pytest.approx(wanted[:, 0], abs=1e-9)
        assert np.all(np.abs(one[:, 1:]) < 1e-9)


@pytest.mark.parametrize("seconds", [4.0, 60.0])
def test_what_is_seen_is_the_filtered_torque_in_pieces_as_in_one(seconds):
    """At the ends of pieces too, beyond which the filter reaches."""
    band = band_of([to_and_fro(seconds)], [])
    model, (whole,) = FRICTION, band.whole
    problem = band.problem(model)
    assert (len(problem.observations) > 1) is (seconds > 10)
    ahead = band.earlier(model)[0]
    drive = _begun_before(whole, ahead)
    torque = simulate(model, model.vector(RUBBING), drive, scheme=problem.integration)
    expected = halve(torque, whole.trial.angle)[ahead:]
    responses = band.responses(problem, problem.free_vector(RUBBING))
    for span, response in zip(band.spans, responses, strict=True):
        assert response == pytest.approx(expected[span], abs=1e-6)


def test_frictions_corners_are_not_made_of_the_motion_below_the_cut_off():
    band = band_of([to_and_fro()], [])
    halved = replace(band, whole=())
    assert left(band, FRICTION, RUBBING) < 0.5 * left(halved, FRICTION, RUBBING)
    # K, B and I leave the same.
    assert left(band, KBI(), JOINT) == left(halved, KBI(), JOINT)


def test_friction_is_named_where_the_angle_is_noisy():
    """It stood beside something unknown, of its own corners' making."""
    library = {key: EFFECTS[key] for key in ("coulomb_friction", "cubic_stiffness")}
    study = Investigation([to_and_fro(6.0)], library=library)
    found = study.weigh()
    assert ("coulomb_friction",) in study.claim(found).sets
    assert found.none_of_these < 0.01
    values = found.sets["coulomb_friction",].candidate.values
    for name in ("K", "B", "I", "coulomb_friction.torque"):
        assert values[name] == pytest.approx(RUBBING[name], rel=0.1)


def test_a_joint_without_friction_is_said_to_have_none():
    library = {key: EFFECTS[key] for key in ("coulomb_friction", "cubic_stiffness")}
    study = Investigation([to_and_fro(friction=0.0)], library=library)
    assert study.claim(study.weigh()).kind == "nothing"


def test_halves_and_chosen_trials_keep_their_whole_motions():
    trials = [to_and_fro(3.0, seed=seed) for seed in range(3)]
    several = band_of(trials, []).without("by amplitude", [1])
    assert [w.name for w in several.whole] == [p.name for p in several.prepared]
    assert len(several.whole) == 2
    half = band_of(trials[:1], []).without("second half", [])
    assert [(w.first, w.last) for w in half.whole] == [(p.first, p.last) for p in half.prepared]
    assert isinstance(half.problem(FRICTION), Problem)
    assert np.isfinite(left(half, FRICTION, RUBBING))


def test_beside_the_noise_of_an_angle_an_effect_of_no_size_is_as_likely_as_none():
    """What noise of the angle adds where the record begins is the same for both."""
    gravity = KBI() + EFFECTS["gravity"]()
    band = band_of([to_and_fro(4.0, friction=0.0)], [])
    assert band.sees_whole(gravity)
    for seed in range(3):
        evaluator = evaluator_of(band, JOINT, seed=seed)
        without = evaluator.evaluate(KBI(), [JOINT])
        problem = band.problem(gravity, probes=evaluator.reference.probes_of(gravity))
        x = problem.free_vector(nested_values(gravity, without.values))
        nothing = evaluator.evaluated(problem, x, without.weights)
        assert nothing.log_likelihood == pytest.approx(without.log_likelihood, abs=0.5)
