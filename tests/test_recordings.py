"""Fits of recordings: known joints are found again, real ones give what they gave elsewhere."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from identifiability.cli.main import main
from identifiability.inference.fitting import fit
from identifiability.inference.problem import Prior
from identifiability.inference.recordings import (
    fit_recordings,
    goodness,
    integrated_autocorrelation,
    prepare,
    recording_problem,
    whole,
    windows,
)
from identifiability.joint.model import KBI
from identifiability.measurement import example
from identifiability.measurement.noise import Noise
from identifiability.measurement.trials import Trial

K, B, INERTIA = 60.0, 1.2, 0.08


def imposed_angle_trial(noise_sd, seed=3):
    """Smooth random steps of the angle, and the torque that K, B and I need for them."""
    time = np.arange(0, 3, 1e-3)
    random = np.random.default_rng(seed)
    angle, velocity, acceleration = np.zeros((3, time.size))
    for onset in np.arange(0.3, 2.8, 0.3):
        size = random.choice([-1, 1]) * random.uniform(0.02, 0.05)
        s = np.clip((time - onset) / 0.04, 0, 1)
        angle += size * (10 * s**3 - 15 * s**4 + 6 * s**5)
        velocity += size * (30 * s**2 - 60 * s**3 + 30 * s**4) / 0.04
        acceleration += size * (60 * s - 180 * s**2 + 120 * s**3) / 0.04**2
    torque = K * angle + B * velocity + INERTIA * acceleration + 3.0
    return Trial(time, torque + noise_sd * random.standard_normal(time.size), angle, driven="angle")


@pytest.fixture(scope="module")
def angle_fit():
    return fit_recordings([imposed_angle_trial(0.05)], window_lengths=[0.1], seed=1)


def test_imposed_angle_gives_the_joint_back(angle_fit):
    for row, truth in zip(angle_fit.widths.rows, (K, B, INERTIA), strict=True):
        assert abs(row.optimum - truth) < max(5 * row.posterior_sd, 2e-3 * truth)
    assert angle_fit.goodness.vaf > 99.5
    assert angle_fit.held_out.goodness_held_out.vaf > 99.5


def test_imposed_angle_windows_agree_with_the_whole(angle_fit):
    window = angle_fit.windows[0]
    assert window.n_windows == 9
    assert window.widths["K"].optimum == pytest.approx(K, rel=0.02)


def test_a_wrong_sign_of_the_torque_is_not_fitted():
    trial = imposed_angle_trial(0.05)
    wrong = Trial(trial.time, -trial.torque, trial.angle, driven="angle")
    prepared = prepare(wrong, KBI())
    problem = recording_problem(
        [prepared], [whole(prepared)], model=KBI(), prior=Prior.physical(KBI())
    )
    best = fit(problem, np.array([[K, B, INERTIA]]))
    assert goodness(problem, best, [whole(prepared)]).vaf < 10


def test_example_trials_are_what_their_generator_writes(tmp_path):
    example.write_example(tmp_path)
    shipped = example.example_trials()
    for trial, name in zip(shipped, example.PULSES, strict=True):
        lines = (tmp_path / f"elbow_{name}.csv").read_text().splitlines()
        made = np.loadtxt(lines[2:], delimiter=",")
        np.testing.assert_allclose(trial.torque, made[:, 1], atol=1e-12)
        # The last printed digit may differ between versions of the integrator.
        np.testing.assert_allclose(trial.angle, made[:, 2], atol=2e-6)


def test_window_selection_skips_windows_that_overlap_the_next_perturbation():
    prepared = prepare(imposed_angle_trial(0.0), KBI())
    fitting = windows(prepared, 0.2)
    assert fitting.stretches == 9
    with pytest.raises(ValueError, match="choose a shorter window"):
        windows(prepared, 0.35)


@pytest.mark.parametrize("time", [0.0, 0.004, 0.02])
def test_integrated_autocorrelation_of_known_noise(time):
    noise = Noise(1.0, time)
    rho = noise.lag_correlation(1e-3)
    expected = (1 + rho) / (1 - rho)
    found = integrated_autocorrelation(noise.draw(200_000, 1e-3, seed=5))
    # The window of the sum leaves out e^-5 of it; the rest is scatter.
    assert found == pytest.approx(expected, rel=0.12)


# Pieces of recordings; whole ones on demand.


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("samples", "vaf", "inertia"),
    [
        pytest.param(5000, (65, 68), (0.0175, 0.0195), id="piece"),
        pytest.param(None, (85, 88.5), (0.015, 0.0175), id="whole", marks=pytest.mark.long),
    ],
)
def test_ankle(shared_data, tmp_path, samples, vaf, inertia):
    record = scipy.io.loadmat(shared_data / "real" / "reklab_ankle_z.mat")
    path = tmp_path / "ankle.mat"
    scipy.io.savemat(path, {"z": record["z"][:samples]})
    options = ["--variable", "z", "--rate", "1000", "--columns", "angle=0:rad", "torque=1:Nm"]
    options += ["--restoring", "--driven", "angle", "--window", "0.1"]
    assert main(["fit", str(path), *options, "--out", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "fit.json").read_text())
    held_out = record["held_out"]
    assert held_out["held_out"] == "the second half"
    assert vaf[0] < held_out["vaf_held_out"] < vaf[1]
    assert inertia[0] < held_out["parameters"]["I"] < inertia[1]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("samples", [500, pytest.param(None, marks=pytest.mark.long)])
def test_pendulum(shared_data, tmp_path, samples):
    header, *lines = (shared_data / "real" / "dfki_pendulum_ddp.csv").read_text().splitlines(True)
    path = str(tmp_path / "swing.csv")
    Path(path).write_text("".join([header, *lines[1500:][:samples]]))
    columns = ["--columns", "time=time:s", "angle=position:rad", "torque=torque:Nm"]
    assert main(["fit", path, *columns, "--window", "0.5", "--out", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "fit.json").read_text())
    # A swing-up is no K, B, I: the fit must say so by its error, not fail.
    assert record["E"] > 0.05
    assert record["trials"][0]["notes"]
