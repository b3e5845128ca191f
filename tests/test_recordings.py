"""Fits of recordings: known joints are found again, real ones give what they gave elsewhere."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io

from identifiability.cli.main import main
from identifiability.inference import recordings
from identifiability.inference.consistency import consistency
from identifiability.inference.fitting import explore, fit
from identifiability.inference.problem import Prior
from identifiability.inference.recordings import (
    fit_recordings,
    goodness,
    recording_problem,
    whole,
    windows,
)
from identifiability.inference.records import fit_record as record_of
from identifiability.inference.starts import plain_values
from identifiability.investigation.investigate import Investigation
from identifiability.joint.effects import CubicStiffness, SeriesTendon, StretchReflex
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement import example
from identifiability.measurement.noise import Noise, correlation_time
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.prepared import prepare
from identifiability.measurement.trials import Trial

K, B, INERTIA = 60.0, 1.2, 0.08


def imposed_angle_trial(noise_sd, seed=3):
    """Random steps of the angle, their jerk without jumps, and the torque that they need."""
    time = np.arange(0, 3, 1e-3)
    random = np.random.default_rng(seed)
    angle, velocity, acceleration = np.zeros((3, time.size))
    for onset in np.arange(0.3, 2.8, 0.3):
        size = random.choice([-1, 1]) * random.uniform(0.02, 0.05)
        s = np.clip((time - onset) / 0.04, 0, 1)
        angle += size * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)
        velocity += size * 140 * (s - s**2) ** 3 / 0.04
        acceleration += size * 420 * (s - s**2) ** 2 * (1 - 2 * s) / 0.04**2
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
    assert consistency(angle_fit).kind == "the same"


@pytest.mark.parametrize("driven", ["torque", "angle"])
@pytest.mark.parametrize(
    ("joint", "pace"),
    [
        ({"K": 0.4, "B": 0.006, "I": 6e-5}, 1.0),
        ({"K": 1100.0, "B": 250.0, "I": 75.0}, 0.1),
        ({"K": 9000.0, "B": 40.0, "I": 0.4}, 2.0),
    ],
    ids=["finger", "stance", "robot"],
)
def test_joints_of_every_size_are_within_the_default_bounds(joint, pace, driven):
    """Half of them were beyond the bounds of an elbow, and their K, B, I those of the bound."""
    random = np.random.default_rng(2)
    time = np.arange(2000) * 1e-3 / pace
    held = np.repeat(random.choice([-1.0, 0.0, 1.0], 20), 100)
    torque = 0.03 * joint["K"] * np.convolve(held, np.hanning(21) / np.hanning(21).sum(), "same")
    model = KBI()
    drive = SampledTorque(torque).drive(time)
    angle = simulate(model, model.vector(joint), drive)
    noise = 0.005 * random.standard_normal(time.size)
    if driven == "torque":
        trial = Trial(time, torque, angle + noise * angle.std(), driven="torque")
    else:
        trial = Trial(time, torque + noise * torque.std(), angle, driven="angle")
    found = Investigation([trial]).baseline
    assert found.values == pytest.approx(joint, rel=0.1)
    assert not found.at_bound


def test_a_wrong_sign_of_the_torque_is_not_fitted():
    trial = imposed_angle_trial(0.05)
    wrong = Trial(trial.time, -trial.torque, trial.angle, driven="angle")
    (prepared,) = prepare([wrong])
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


@pytest.fixture(scope="module")
def example_fit():
    return fit_recordings(example.example_trials(), seed=1)


@pytest.mark.parametrize(
    ("trials", "fitted"),
    [(example.example_trials, "example_fit"), (lambda: [imposed_angle_trial(0.05)], "angle_fit")],
    ids=["torque", "angle"],
)
def test_both_commands_see_the_same_numbers(trials, fitted, request):
    fitted = request.getfixturevalue(fitted)
    study = Investigation(trials())
    split = study.split
    parts = (*split.fitted, *split.held_out)
    assert {p.name for p in fitted.prepared} == {p.name for p in parts}
    ours = {p.name: p for p in fitted.prepared}
    for theirs in parts:
        mine = ours[theirs.name]
        np.testing.assert_array_equal(mine.response, theirs.response)
        np.testing.assert_array_equal(mine.drive.states, theirs.drive.states)
        np.testing.assert_array_equal(mine.onsets, theirs.onsets)
        assert mine.interval == theirs.interval
        assert mine.recorded_lead == theirs.recorded_lead
        assert mine.treatment == theirs.treatment
        assert mine.has_offset == theirs.has_offset
    # The same samples are held out, and K, B, I of the others agree: one trial's weight is no
    # matter.
    held = fitted.held_out
    assert held.held_out == split.how_held_out
    (part,) = split.fitted
    assert held.goodness_fitted.n_samples == part.last - part.first
    candidate = study.fit(KBI())
    for name in ("K", "B", "I"):
        assert held.fit[name] == pytest.approx(candidate.values[name], rel=1e-4)
    assert held.goodness_fitted.error == pytest.approx(candidate.fitted.error, rel=1e-6)
    assert held.goodness_held_out.error == pytest.approx(candidate.held_out.error, rel=1e-3)
    # Both write it down, in the same words.
    written = json.loads(json.dumps(record_of(fitted)))["trials"]
    of_part = json.loads(json.dumps(part.record()))
    same = next(t for t in written if t["name"] == part.name)
    assert same["notes"] == of_part["notes"]
    for key in ("level", "lowpass_hz", "decimation", "lead"):
        assert same["preparation"][key] == of_part["preparation"][key]


def pushed(model, values):
    """Two pushes and the response of a model of the library, with a thousandth of noise."""
    time, random = np.arange(300) / 1000, np.random.default_rng(1)
    for size in (12.0, -6.0):
        torque = size * ((time > 0.05) & (time <= 0.1))
        drive = SampledTorque(torque).drive(time)
        angle = simulate(model, model.vector(values), drive)
        noise = 1e-3 * np.sqrt(np.mean(angle**2)) * random.standard_normal(time.size)
        yield Trial(time, torque, angle + noise, name=f"pushed by {size:g} Nm")


@pytest.mark.parametrize(
    ("effect", "own", "within"),
    [
        (SeriesTendon(), {"stiffness": 150.0}, 0.02),
        (CubicStiffness(), {"coefficient": 300.0}, 0.01),
        # Its gains, delay and lag are nearly one curve: standard deviations of 2 to 11 %.
        (StretchReflex(), {"position_gain": 15.0, "velocity_gain": 0.6, "delay": 0.04}, 0.3),
    ],
    ids=["series_tendon", "cubic_stiffness", "stretch_reflex"],
)
def test_any_model_is_fitted(effect, own, within, monkeypatch):
    # What else is known of the parameters has tests of its own; here it is the fit that counts.
    monkeypatch.setattr(recordings, "widths", only_the_fit)
    model = KBI() + effect
    values = dict(zip(model.parameter_names, model.nominal, strict=True)) | plain_values(model)
    values |= {"K": 40.0, "B": 1.5, "I": 0.1}
    values |= {f"{effect.key}.{name}": value for name, value in own.items()}
    result = fit_recordings(list(pushed(model, values)), model=model)
    best = result.widths.fit
    assert set(best.names) == set(values) - set(plain_values(model))
    assert result.goodness.error == pytest.approx(1e-6, rel=0.3)  # the noise, and no more
    for name in best.names:
        assert best[name] == pytest.approx(values[name], rel=0.05 if name in "KBI" else within)
    assert result.held_out.rule == "by amplitude"
    assert result.held_out.goodness_held_out.error < 1e-4


def only_the_fit(problem, *, starts, **options):
    return SimpleNamespace(fit=explore(problem, starts, evaluations=60))


def test_window_selection_skips_windows_that_overlap_the_next_perturbation():
    (prepared,) = prepare([imposed_angle_trial(0.0)])
    fitting = windows(prepared, 0.2)
    assert fitting.stretches == 9
    with pytest.raises(ValueError, match="choose a shorter window"):
        windows(prepared, 0.35)


@pytest.mark.parametrize("time", [0.0, 0.004, 0.02])
def test_correlation_time_of_known_noise(time):
    noise = Noise(1.0, time)
    rho = noise.lag_correlation(1e-3)
    expected = (1 + rho) / (1 - rho)
    found = correlation_time(noise.draw(200_000, 1e-3, seed=5))
    # The window of the sum leaves out e^-5 of it; the rest is scatter.
    assert found == pytest.approx(expected, rel=0.12)


# Pieces of recordings; whole ones on demand.


@pytest.mark.recordings
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
    assert held_out["rule"] == "second half"
    assert vaf[0] < held_out["vaf_held_out"] < vaf[1]
    assert inertia[0] < held_out["parameters"]["I"] < inertia[1]


@pytest.mark.recordings
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
