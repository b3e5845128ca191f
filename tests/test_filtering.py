"""The low-pass filter of imposed angles: it cuts off what is noise, and the inertia stays."""

import numpy as np
import pytest
from scipy import signal

from identifiability.errors import InputError
from identifiability.inference.fitting import fit
from identifiability.inference.problem import Prior
from identifiability.inference.recordings import recording_problem, whole
from identifiability.investigation.split import gather
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.filtering import (
    HIGHEST_HZ,
    cutoff,
    noise_cutoff,
    settled,
    stride,
)
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.prepared import prepare
from identifiability.measurement.trials import Trial

JOINT = (3.0, 0.2, 0.15)
COARSE = 3e-3  # rad: a coarse encoder


def swing(n=6000, rate=500.0, seed=1, until=5.0):
    """A motion of up to so many Hz in eighth-order noise, and the torque that K, B, I need."""
    random = np.random.default_rng(seed)
    sos = signal.butter(8, until, fs=rate, output="sos")
    angle = signal.sosfiltfilt(sos, random.standard_normal(n + 2000))[1000:-1000]
    angle *= 0.5 / angle.std()
    velocity = np.gradient(angle, 1 / rate)
    torque = JOINT[0] * angle + JOINT[1] * velocity + JOINT[2] * np.gradient(velocity, 1 / rate)
    torque += 0.02 * random.standard_normal(n)
    return Trial(np.arange(n) / rate, torque, angle, driven="angle")


def with_angle(trial, angle):
    return Trial(trial.time, trial.torque, angle, driven="angle")


def rounded(trial, step=COARSE):
    return with_angle(trial, step * np.round(trial.angle / step))


def inertia(prepared):
    """I by least squares."""
    problem = recording_problem(
        [prepared], [whole(prepared)], model=KBI(), prior=Prior.physical(KBI())
    )
    return fit(problem, np.array([JOINT])).values[2]


def test_an_angle_without_noise_keeps_the_usual_cutoff():
    assert noise_cutoff([swing()]) == HIGHEST_HZ


def test_the_cutoff_is_where_the_spectrum_meets_the_noise():
    # White noise of known density; the motion falls with the fourth power of the frequency, so
    # where it equals the noise is known in closed form.
    rate, n, corner = 1000.0, 200_000, 3.0
    random = np.random.default_rng(2)
    sos = signal.butter(2, corner, fs=rate, output="sos")
    angle = signal.sosfilt(sos, random.standard_normal(n))  # density 2 / rate in the band
    meets = 18.0
    noise = np.sqrt(1 / (1 + (meets / corner) ** 4))
    noisy = angle + noise * random.standard_normal(n)
    trial = Trial(np.arange(n) / rate, random.standard_normal(n), noisy, driven="angle")
    # In bands of a third of an octave, and where signal and noise are equal.
    assert meets / 2 ** (1 / 3) < noise_cutoff([trial]) < meets * 2 ** (1 / 3)


@pytest.mark.parametrize("rate", [60.0, 100.0, 1000.0])
def test_a_motion_that_falls_to_half_the_sampling_rate_is_no_noise(rate):
    # Steps of velocity: the slowest fall that inertia allows. The filter keeps room above.
    random = np.random.default_rng(3)
    velocity = np.cumsum(random.standard_normal(4000) * (random.random(4000) < 0.05))
    angle = np.cumsum(velocity - velocity.mean())
    angle *= 0.3 / angle.std()
    trial = Trial(np.arange(4000) / rate, random.standard_normal(4000), angle, driven="angle")
    assert noise_cutoff([trial]) == min(HIGHEST_HZ, 0.4 * rate)
    assert prepare([trial])[0].interval > 0


def test_the_noise_of_few_short_trials_is_seen():
    # Eight of 0.8 s at 100 Hz: what is flat scatters, and the slowest fall must still not be flat.
    rate, n, trials = 100.0, 80, 8
    seen = {"noise": 0, "motion": 0}
    for seed in range(200):
        random = np.random.default_rng((7, seed))
        found = {"noise": [], "motion": []}
        for _ in range(trials):
            fast = np.cumsum(np.cumsum(random.standard_normal(20 * n)))[::20] / 20
            found["motion"].append(0.3 * (fast - np.linspace(fast[0], fast[-1], n)) / np.ptp(fast))
            slow = swing(n, rate, int(random.integers(1 << 31)))
            found["noise"].append(slow.angle + 3e-3 * random.standard_normal(n))
        for what, angles in found.items():
            time = np.arange(n) / rate
            records = [Trial(time, np.cos(time), angle, driven="angle") for angle in angles]
            seen[what] += noise_cutoff(records) < 0.4 * rate
    assert seen["noise"] > 190
    assert seen["motion"] < 20


def test_trials_share_one_cutoff():
    quiet, coarse = swing(), rounded(swing(seed=2))
    assert cutoff([quiet, coarse], "auto") == noise_cutoff([quiet, coarse])
    notes = [r.trial.notes for r in gather([quiet, coarse], lowpass_hz="auto").fitted]
    notes += [r.trial.notes for r in gather([quiet, coarse], lowpass_hz="auto").held_out]
    assert len({note for all_ in notes for note in all_ if "low-pass" in note}) == 1


def test_settings():
    trial = swing()
    assert cutoff([trial], None) is None
    assert cutoff([trial], 30) == 30.0
    assert stride(trial, 50.0) == 2
    assert stride(trial, 400.0) == 1
    with pytest.raises(InputError, match="low-pass of 250 Hz, expected less than half"):
        cutoff([trial], 250.0)


def test_rounding_of_a_coarse_encoder_no_longer_makes_the_inertia_too_small():
    trial = rounded(swing(until=1.0))
    assert noise_cutoff([trial]) < 20
    by_itself, usual = (inertia(prepare([trial], lowpass_hz=hz)[0]) for hz in ("auto", HIGHEST_HZ))
    assert by_itself == pytest.approx(JOINT[2], rel=0.1)
    assert usual < 0.5 * JOINT[2]  # what rounding does to it otherwise


def test_records_too_short_or_too_smooth_for_a_spectrum_keep_the_usual_cutoff():
    ramp = np.arange(200.0)
    for n in (3, 5, 20, 60, 200):
        angle = 1e-3 * ramp[:n]
        trial = Trial(ramp[:n] / 1000, np.cos(ramp[:n]), angle, driven="angle")
        assert noise_cutoff([trial]) == HIGHEST_HZ


def test_the_ends_of_the_filter_are_not_compared():
    # A joint that is K, B and I, moving at the end of the record.
    time = np.arange(300) / 1000
    torque = np.where((time > 0.05) & (time <= 0.06), 20.0, 0.0)
    joint = np.array([30.0, 1.0, 0.1])
    angle = simulate(KBI(), joint, SampledTorque(torque).drive(time))
    trial = Trial(time, torque, angle, driven="angle")
    ready = gather([trial, trial], lowpass_hz=50.0).fitted[0]
    assert ready.first == 0  # it begins at rest
    assert ready.last * ready.drive.interval == pytest.approx(0.3 - 2 / 50, abs=0.005)
    (prepared,) = prepare([trial], lowpass_hz=50.0)
    by_all = prepared.part(0, prepared.response.size)
    assert residual(prepared, joint) < 1e-5
    assert residual(by_all, joint) > 1e-3  # what the ends would add


def test_a_noisy_record_that_begins_at_rest_keeps_its_beginning():
    # A push 50 ms after the start, seen by a sensor with a hundredth of the motion as noise.
    time = np.arange(800) / 1000
    torque = np.where((time > 0.05) & (time <= 0.06), 20.0, 0.0)
    angle = simulate(KBI(), np.array([30.0, 1.0, 0.1]), SampledTorque(torque).drive(time))
    for seed in range(20):
        noise = 0.01 * angle.std() * np.random.default_rng(seed).standard_normal(time.size)
        trial = Trial(time, torque, angle + noise, driven="angle")
        assert settled(trial, 25.0) == (0, 720)


def test_a_record_that_begins_in_motion_loses_both_ends():
    trial = swing(n=500)
    assert settled(trial, 50.0) == (20, 480)
    assert settled(trial, 5.0) == (0, 375)  # a quarter is lost at most


def residual(prepared, values):
    """E at known K, B and I, but for the level."""
    selection = whole(prepared)
    problem = recording_problem([prepared], [selection], model=KBI(), prior=Prior.physical(KBI()))
    response = prepared.response[selection.samples]
    missed = response - problem.responses(values)[0][selection.samples]
    return np.var(missed) / np.var(response)
