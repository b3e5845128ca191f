import dataclasses
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

from identifiability.errors import InputError
from identifiability.measurement.trials import Trial, extended, onsets, quiet_lead

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def swing(n=1000, dt=1e-3, lead=50, **changes):
    """A torque pulse of 50 ms after a quiet lead, and an angle that answers it."""
    time = np.arange(n) * dt
    torque = np.where((np.arange(n) > lead) & (np.arange(n) <= lead + 50), 4.0, 0.0)
    since = np.clip(time - lead * dt, 0.0, None)
    angle = 0.1 * np.exp(-8.0 * since) * np.sin(20.0 * since)
    return Trial(**{"time": time, "torque": torque, "angle": angle} | changes)


def random_steps(seed=0, n_steps=200, noise=5e-6):
    """Imposed angle: smooth steps of random size, 200-300 ms apart; and their starts."""
    rng = np.random.default_rng(seed)
    starts = 200 + np.cumsum(rng.integers(200, 300, n_steps))
    sizes = rng.uniform(0.006, 0.03, n_steps) * rng.choice([-1, 1], n_steps)
    time = np.arange(starts[-1] + 300) * 1e-3
    angle = np.zeros(time.size)
    for start, size in zip(starts, sizes, strict=True):
        rise = np.clip((np.arange(time.size) - start) / 25.0, 0.0, 1.0)
        angle += size * 0.5 * (1.0 - np.cos(np.pi * rise))
    angle += noise * rng.standard_normal(time.size)
    return Trial(time, 100.0 * angle, angle, driven="angle"), starts


# The record itself


def test_channels_are_copied_as_read_only_floats():
    torque = np.arange(5)
    trial = Trial(np.arange(5), torque, np.arange(5) * 0.1)
    torque[0] = 7
    assert trial.torque[0] == 0.0
    assert trial.torque.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        trial.angle[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trial.name = "other"


def test_sampling_properties():
    trial = swing(n=501, dt=2e-3)
    assert trial.n_samples == 501
    assert trial.duration == pytest.approx(1.0)
    assert trial.dt == pytest.approx(2e-3)
    assert trial.sampling_rate == pytest.approx(500.0)


def test_trial_survives_pickling():
    trial = swing(notes=["read"])
    again = pickle.loads(pickle.dumps(trial))
    np.testing.assert_array_equal(again.angle, trial.angle)
    assert again.notes == ("read",)


def late(values, at, value):
    return np.concatenate([values[:at], [value], values[at + 1 :]])


N = np.arange(10.0)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"torque": N[:7]}, "lengths are time 10, torque 7, angle 10"),
        ({"time": N[:1], "torque": N[:1], "angle": N[:1]}, "at least 3 samples, found 1"),
        ({"time": N[:0], "torque": N[:0], "angle": N[:0]}, "at least 3 samples, found 0"),
        ({"angle": N.reshape(5, 2)}, r"angle must be one-dimensional, but its shape is \(5, 2\)"),
        ({"angle": N + 1j}, "angle must be a sequence of real numbers"),
        ({"torque": ["a"] * 10}, "torque must be a sequence of real numbers"),
        ({"torque": [[1.0], [1.0, 2.0]]}, "torque must be a sequence of real numbers"),
        ({"angle": late(N, 4, np.nan)}, r"angle holds 1 values .* first \(nan\) at sample 4"),
        ({"torque": np.where(N > 6, np.inf, N)}, r"torque holds 3 values .* at sample 7"),
        ({"time": late(N, 6, 5.0)}, "time must increase, but sample 6"),
        ({"time": N[::-1]}, "time must increase, but sample 1"),
        ({"time": np.where(N > 5, N + 0.1, N)}, "uniformly, but the step after sample 5 is 1.1 s"),
        ({"time": [-1.7e308, 1.6e308, 1.7e308], "torque": N[:3], "angle": N[:3]}, "uniformly"),
        ({"angle": np.full(10, 0.3)}, r"angle is constant \(0.3\).*nothing to fit"),
        ({"torque": np.zeros(10)}, r"torque is constant \(0\).*nothing to fit"),
        ({"driven": "force"}, "driven is 'force', but .* 'torque' or 'angle'"),
    ],
)
def test_what_cannot_be_a_recording_is_refused(changes, sentence):
    good = {"time": N, "torque": N, "angle": 0.1 * N}
    Trial(**good)
    with pytest.raises(InputError, match=sentence):
        Trial(**good | changes)


def test_time_may_wander_by_a_millionth_of_a_step():
    wander = np.where(np.arange(10) % 2, 2e-7, 0.0)
    assert Trial(N + wander, N, N / 10).dt == pytest.approx(1.0)
    with pytest.raises(InputError, match="uniformly"):
        Trial(N + 10 * wander, N, N / 10)


def test_an_angle_in_degrees_is_hinted_at():
    with pytest.warns(UserWarning, match=r"reaches 9 rad.*looks like degrees"):
        Trial(N, N, N)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Trial(N, N, N / 9 * 6.28)


# New trials from a trial


def test_between_keeps_the_time_axis_and_both_ends():
    part = swing().between(0.04, 0.06)
    assert part.n_samples == 21
    assert part.time[[0, -1]] == pytest.approx([0.04, 0.06])
    assert part.notes == ("cut to 0.04-0.06 s",)


@pytest.mark.parametrize(
    ("start", "stop", "sentence"),
    [
        (-0.1, 0.5, "outside the record, which runs from 0 s to 0.999 s"),
        (0.5, 1.2, "outside the record"),
        (0.5, 0.4, "empty"),
        (float("nan"), 0.4, "empty"),
        (0.05, 0.051, "holds 2 samples, where at least 3"),
        (0.2, 0.5, "torque is constant"),
    ],
)
def test_between_refuses(start, stop, sentence):
    with pytest.raises(InputError, match=sentence):
        swing().between(start, stop)


def test_halves_share_no_sample_and_lose_none():
    trial, _ = random_steps(n_steps=3)
    first, second = trial.halves()
    np.testing.assert_array_equal(np.r_[first.angle, second.angle], trial.angle)
    assert first.time[-1] < second.time[0]
    assert (first.notes, second.notes) == (("first half",), ("second half",))


def test_lowpass_keeps_slow_and_drops_fast_without_delay():
    time = np.arange(2000) * 1e-3
    slow, fast = np.sin(2 * np.pi * 3 * time), np.sin(2 * np.pi * 200 * time)
    smooth = Trial(time, slow + fast, slow + 0.1 * fast).lowpass(40.0)
    inner = slice(200, -200)
    np.testing.assert_allclose(smooth.torque[inner], slow[inner], atol=1e-4)
    np.testing.assert_allclose(smooth.angle[inner], slow[inner], atol=1e-4)
    assert "low-pass filtered at 40 Hz" in smooth.notes[-1]


def test_lowpass_halves_the_cutoff_frequency():
    time = np.arange(4000) * 1e-3
    wave = np.sin(2 * np.pi * 40 * time)
    smooth = Trial(time, wave, wave).lowpass(40.0, order=2)
    assert np.abs(smooth.angle[1000:3000]).max() == pytest.approx(0.5, abs=0.01)


def test_lowpass_works_on_a_short_record():
    assert swing(n=60).lowpass(100.0).n_samples == 60
    assert Trial(N[:3], N[:3], N[:3]).lowpass(0.2).n_samples == 3


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((500.0,), "500 Hz must lie between 0.0005 Hz and the Nyquist frequency, 500 Hz"),
        ((0.0,), "must lie between 0.0005"),
        ((float("nan"),), "must lie between 0.0005"),
        ((50.0, 0), "order of the filter is 0"),
    ],
)
def test_lowpass_refuses(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        swing().lowpass(*arguments)


def test_decimate_keeps_every_third_sample():
    trial = swing()
    coarse = trial.decimate(3)
    np.testing.assert_array_equal(coarse.torque, trial.torque[::3])
    assert coarse.dt == pytest.approx(3e-3)
    assert coarse.notes == ("one sample in 3 kept",)


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [(0, "whole number"), (1.5, "whole number"), (999, "at least 3 samples, found 2")],
)
def test_decimate_refuses(factor, sentence):
    with pytest.raises(InputError, match=sentence):
        swing().decimate(factor)


def test_centring_on_the_baseline_recovers_the_deviations():
    trial = swing()
    shifted = swing(torque=trial.torque + 2.5, angle=trial.angle - 0.7)
    centred = shifted.centred("baseline")
    np.testing.assert_allclose(centred.torque, trial.torque, atol=1e-12)
    np.testing.assert_allclose(centred.angle, trial.angle, atol=1e-12)
    assert "50 quiet samples" in centred.notes[-1]
    assert "2.5 Nm, -0.7 rad" in centred.notes[-1]


def test_centring_on_the_mean_or_on_nothing():
    trial = swing()
    assert trial.centred("mean").angle.mean() == pytest.approx(0.0, abs=1e-12)
    assert trial.centred("none") is trial


@pytest.mark.parametrize(
    ("trial", "how", "sentence"),
    [
        (swing(), "median", "centring is 'median', but must be"),
        (swing(lead=0), "baseline", "begins at sample 0, so there is no quiet lead"),
    ],
)
def test_centring_refuses(trial, how, sentence):
    with pytest.raises(InputError, match=sentence):
        trial.centred(how)


def test_notes_accumulate_and_the_source_stays():
    trial = swing(source="a.csv", sha256="00", condition="tonic", name="one", notes=("read",))
    changed = trial.lowpass(100.0).decimate(2).centred("mean")
    assert [note.split()[0] for note in changed.notes] == ["read", "low-pass", "one", "operating"]
    assert (changed.source, changed.sha256, changed.condition) == ("a.csv", "00", "tonic")
    assert trial.notes == ("read",)


# Onsets

I = np.arange(1000)
PERTURBATIONS = {
    "pulse": np.where((I > 50) & (I <= 100), 4.0, 0.0),
    "short pulse": np.where((I > 50) & (I <= 55), -60.0, 0.0),
    "impulse": np.where(I == 51, 1000.0, 0.0),
    "step": np.where(I > 50, 3.0, 0.0),
    "sinusoid": np.where((I > 50) & (I <= 80), np.sin(2 * np.pi * (I - 50) / 30), 0.0),
    "sinusoid to the end": np.where(I > 50, np.sin(2 * np.pi * (I - 50) / 30), 0.0),
}


@pytest.mark.parametrize("torque", PERTURBATIONS.values(), ids=PERTURBATIONS)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_perturbation_after_a_lead_of_50_samples(torque, noise):
    jitter = noise * np.ptp(torque) * np.random.default_rng(1).standard_normal(torque.size)
    trial = swing(torque=torque + jitter + 0.3)
    assert onsets(trial).tolist() == [50]
    assert quiet_lead(trial) == 50


# A step cut at its onset is a constant torque, which a trial refuses.
@pytest.mark.parametrize(
    ("kind", "cut"),
    [(kind, cut) for kind in PERTURBATIONS for cut in (50, 51) if (kind, cut) != ("step", 51)],
)
def test_a_perturbation_that_begins_at_once(kind, cut):
    whole, torque = swing(), PERTURBATIONS[kind]
    trial = Trial(whole.time[:900], torque[cut : cut + 900], whole.angle[50:950])
    assert onsets(trial)[0] == 0
    assert quiet_lead(trial) == 0


def test_movements_within_the_separation_are_one():
    torque = np.where((I > 100) & (I <= 180) | (I > 400), 5.0, 0.0)
    trial = swing(torque=torque, lead=100)
    assert onsets(trial).tolist() == [100, 400]
    assert onsets(trial, separation=0.05).tolist() == [100, 180, 400]
    assert onsets(trial, separation=0.5).tolist() == [100]


@pytest.mark.parametrize(("noise", "lag"), [(0.0, 0), (5e-6, 3), (2e-4, 10)])
@pytest.mark.parametrize("seed", range(3))
def test_all_steps_of_a_random_staircase_are_found(seed, noise, lag):
    trial, starts = random_steps(seed, noise=noise)
    found = onsets(trial)
    assert found.size == starts.size
    assert np.abs(found - starts).max() <= lag


def test_noise_alone_has_no_onset():
    rng = np.random.default_rng(3)
    assert onsets(swing(torque=rng.standard_normal(1000))).tolist() == [0]


def test_the_shortest_trial_has_an_onset():
    assert onsets(Trial(N[:3], [0.0, 0.0, 1.0], N[:3])).tolist() == [0]


@pytest.mark.skipif(not (DATA / "practice").is_dir(), reason="needs ../shared/data/practice")
def test_practice_trials_start_after_50_quiet_samples():
    files = sorted((DATA / "practice" / "p01").glob("trial_*.csv"))
    assert files
    for file in files:
        time, torque, angle = np.loadtxt(file, delimiter=",", skiprows=1, unpack=True)
        assert quiet_lead(Trial(time, torque, angle)) == 50, file.name


def test_beyond_an_end_at_rest_a_recording_stays_and_beyond_one_in_motion_it_goes_on():
    time = np.arange(100) / 100
    angle = np.where(time < 0.5, 0.0, time - 0.5)  # rests, then moves to the end
    torque = 3.0 * angle + 0.1 * (time == 0)  # the first sample is off by noise
    around = extended(torque, 8, angle)
    np.testing.assert_array_equal(around[8:-8], torque)
    np.testing.assert_array_equal(around[:8], torque[0])
    np.testing.assert_allclose(np.diff(around[-9:]), 0.03)
    np.testing.assert_allclose(np.diff(extended(torque[::-1], 8, angle[::-1])[:9]), -0.03)
