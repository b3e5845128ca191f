"""Fits of long records are begun on fewer samples, and end no worse than those of all samples."""

from dataclasses import replace

import numpy as np
import pytest

from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial

JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
HIDDEN = {
    "torque": {"cubic_stiffness.coefficient": 40.0, "cubic_stiffness.centre": 0.0},
    "angle": {"maxwell_branch.stiffness": 15.0, "maxwell_branch.time_constant": 0.1},
}
SECONDS = {"torque": 18, "angle": 48}  # of an angle fewer samples a second are compared


def record(driven):
    """A record of many pieces, and the model it was made with."""
    time = np.arange(1000 * SECONDS[driven]) / 1000
    key = next(iter(HIDDEN[driven])).split(".")[0]
    model = KBI() + EFFECTS[key]()
    rng = np.random.default_rng(5)
    steps = np.repeat(rng.uniform(-1, 1, time.size // 150), 150)
    if driven == "torque":
        given = 20 * steps
        drive = SampledTorque(given).drive(time)
    else:
        smooth = np.convolve(steps, np.hanning(81) / np.hanning(81).sum(), mode="same")
        given = 0.1 * np.convolve(smooth, np.hanning(41) / np.hanning(41).sum(), mode="same")
        drive = imposed_motion(time, given)
    response = simulate(model, model.vector(JOINT | HIDDEN[driven]), drive)
    noisy = response + 1e-3 * np.std(response) * rng.standard_normal(time.size)
    pair = (given, noisy) if driven == "torque" else (noisy, given)
    return Trial(time, *pair, driven=driven, name="long"), model


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_fit_that_was_begun_on_fewer_samples_is_no_worse(driven):
    trial, model = record(driven)
    evaluator = evaluator_of(band_of([trial], []), JOINT)
    assert evaluator.coarse is not None
    assert evaluator.coarse.band.n_samples < 0.5 * evaluator.band.n_samples
    whole = replace(evaluator, coarse=None)
    starts = starting_values(model, JOINT, wide=True)
    one, other = (e.evaluate(model, starts, resolved=False) for e in (evaluator, whole))
    one = evaluator.evaluate(model, [one.values], noise=one.weights)
    assert one.log_evidence > other.log_evidence - 0.5
    for name, sd in one.sds.items():
        assert abs(one.values[name] - (JOINT | HIDDEN[driven])[name]) < 5 * sd
    # Fewer samples know less: the rest of the record has had its say.
    assert evaluator.coarse.evaluate(model, starts).sds["K"] > 1.3 * one.sds["K"]


def test_short_trials_are_fitted_as_they_are():
    trial, _ = record("torque")
    time, torque, angle = (x[:3000] for x in (trial.time, trial.torque, trial.angle))
    short = [replace(trial, time=time, torque=torque, angle=angle)]
    assert evaluator_of(band_of(short, []), JOINT).coarse is None
