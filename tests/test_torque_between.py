"""A torque between its samples: straight or smooth, as the response tells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from identifiability.inference.between import joined
from identifiability.inference.fitting import fit
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.investigation.session import Investigation
from identifiability.joint.effects.cubic_stiffness import CubicStiffness
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.prepared import prepare
from identifiability.measurement.trials import Trial

RATE, FINER = 100, 20
TIME = np.arange(300) / RATE
FINE = np.arange((TIME.size - 1) * FINER + 1) / (RATE * FINER)
JOINT = np.array([80.0, 0.5, 0.02])  # resonant at 10 Hz
WHITE = 2e-4
K_B_I = KBI()


def waves(time: np.ndarray, seed: int) -> np.ndarray:
    """Torque of up to 15 Hz, from 0.3 s on."""
    random = np.random.default_rng(seed)
    since = np.maximum(time - 0.3, 0.0)
    frequencies = np.arange(0.5, 15.0, 0.5)
    phases = random.uniform(0, 2 * np.pi, frequencies.size)
    rising = 1 - np.exp(-((since / 0.1) ** 4))
    return rising * np.sin(2 * np.pi * np.outer(since, frequencies) + phases).sum(axis=1)


def steps(time: np.ndarray, seed: int) -> np.ndarray:
    """Random steps that change at samples, each ramping over one interval."""
    levels = np.random.default_rng(seed).uniform(-3, 3, 40).repeat(8)
    at_samples = np.where(TIME >= 0.3, levels[: TIME.size], 0.0)
    return np.interp(time, TIME, at_samples)


def trial(torque: np.ndarray, model=K_B_I, values=JOINT, seed=0) -> Trial:
    """A trial at 100 Hz of a joint to which this torque was applied, known at `FINE`."""
    angle = simulate(model, values, SampledTorque(torque).drive(FINE))[::FINER]
    noise = np.random.default_rng(seed).normal(0, WHITE, TIME.size)
    return Trial(TIME, torque[::FINER], angle + noise, name=f"trial {seed}")


TRUTHS = {
    "smooth": waves(FINE, 1),
    "straight": np.interp(FINE, TIME, waves(TIME, 1)),
    "steps": steps(FINE, 1),
    "slow": np.interp(FINE, TIME, 3 * np.exp(-(((TIME - 1.5) / 0.4) ** 2))),
}


def fitted(prepared) -> np.ndarray:
    problem = Problem(
        KBI(),
        [observe(p.drive, p.response, Noise(WHITE)) for p in prepared],
        Prior.recorded(KBI()),
    )
    return fit(problem, JOINT[None]).values


@pytest.mark.parametrize("truth", TRUTHS)
def test_the_response_tells_how_the_torque_ran(truth):
    for seed in range(3):
        prepared = prepare([trial(TRUTHS[truth], seed=seed)])
        chosen = joined(prepared)
        how = chosen[0].treatment.torque_between
        assert chosen[0].record()["preparation"]["torque_between"] == how
        smooth = tuple(p.smooth() for p in prepared)
        if truth == "slow":
            # Either will do: the responses differ by less than the noise.
            either = (simulate(KBI(), JOINT, q[0].drive) for q in (prepared, smooth))
            assert np.max(np.abs(np.subtract(*either))) < WHITE
            continue
        assert how == ("smooth" if truth == "smooth" else "straight")
        # Either mistake would show in the parameters.
        np.testing.assert_allclose(fitted(chosen), JOINT, rtol=0.005)
        wrong = prepared if how == "smooth" else smooth
        assert np.max(np.abs(fitted(wrong) / JOINT - 1)) > 0.01


def test_an_imposed_angle_is_left_alone():
    torque = TRUTHS["smooth"][::FINER]
    angle = simulate(KBI(), JOINT, SampledTorque(torque).drive(TIME))
    prepared = prepare([Trial(TIME, torque, angle, driven="angle")])
    assert joined(prepared) == prepared


def test_a_smooth_torque_is_the_spline_through_its_samples():
    torque = TRUTHS["smooth"][::FINER]
    drive = SampledTorque(torque, hold="smooth").drive(TIME)
    finer = make_interp_spline(TIME, torque, k=3)(FINE)
    np.testing.assert_allclose(drive.signals[:, 0], torque, atol=1e-12)
    exact = simulate(KBI(), JOINT, drive)
    by_lines = simulate(KBI(), JOINT, SampledTorque(finer).drive(FINE))[::FINER]
    assert np.max(np.abs(exact - by_lines)) < 3e-4 * np.ptp(exact)
    # The control: straight lines between the samples are another torque.
    straight = simulate(KBI(), JOINT, SampledTorque(torque).drive(TIME))
    assert np.max(np.abs(exact - straight)) > 1e-2 * np.ptp(exact)


def test_steps_of_second_order_see_only_the_ends_of_a_curve():
    model = KBI() + CubicStiffness()
    values = model.vector(
        {**dict(zip("KBI", JOINT, strict=True)), "cubic_stiffness.coefficient": 20.0}
    )
    drive = SampledTorque(TRUTHS["smooth"][::FINER], hold="smooth").drive(TIME)
    assert drive.curved
    assert not SampledTorque(TRUTHS["smooth"][::FINER]).drive(TIME).curved
    assert not imposed_motion(TIME, TRUTHS["smooth"][::FINER]).curved
    converged = simulate(model, values, drive)

    def error(scheme: Scheme) -> float:
        off = simulate(model, values, drive, scheme=scheme) - converged
        return float(np.sum(off**2) / np.sum(converged**2))

    suited = Scheme.for_model(model, values, 1 / RATE, curved=True)
    assert suited.order == 4
    assert error(suited) < 1e-5
    assert error(Scheme.for_model(model, values, 1 / RATE)) > 10 * error(suited)


def test_an_effect_is_found_with_the_right_parameters():
    """A joint with a cubic spring; and the same joint, were the torque taken to be straight."""
    truth = {**dict(zip("KBI", JOINT, strict=True)), "cubic_stiffness.coefficient": 60.0}
    model = KBI() + CubicStiffness()
    values = model.vector(truth)
    trials = [trial(3 * waves(FINE, s), model, values, s) for s in range(2)]

    library = {"cubic_stiffness": CubicStiffness}
    smooth = Investigation(trials[:1], trials[1:], library=library)
    assert {p.treatment.torque_between for p in smooth.split.fitted} == {"smooth"}
    found = smooth.weigh(most=1)
    assert smooth.claim(found).sets == (("cubic_stiffness",),)
    assert found.values == pytest.approx(
        truth | {"cubic_stiffness.centre": 0.0}, rel=0.01, abs=0.01
    )
    # What straight lines lose is taken for something unknown; then the other way is likelier.
    study = Investigation(trials[:1], trials[1:], library=library, torque_between="straight")
    by_lines = study.weigh(most=1)
    assert study.claim(by_lines).sets == ()
    other = study.otherwise(by_lines)
    assert other.torque_between == "smooth"
    assert any("smooth between its samples" in remark for remark in other.remarks)
    assert other.otherwise(found) is None


def test_a_smooth_torque_is_told_by_colour_where_least_squares_do_not_see_it():
    """In slow noise: the misfits differ by little, the likelihoods by much."""
    slow = np.cumsum(np.random.default_rng(5).standard_normal(TIME.size)) * 3e-4
    clean = trial(TRUTHS["smooth"])
    prepared = prepare([replace(clean, angle=clean.angle + slow)])
    assert joined(prepared)[0].treatment.torque_between == "smooth"
    steps_too = trial(TRUTHS["steps"])
    prepared = prepare([replace(steps_too, angle=steps_too.angle + slow)])
    assert joined(prepared)[0].treatment.torque_between == "straight"
