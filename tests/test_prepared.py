"""One preparation of trials for every command: level, lead, filter, decimation, hold-out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from identifiability.errors import InputError
from identifiability.investigation.split import gather
from identifiability.measurement.noise import Noise
from identifiability.measurement.prepared import LEAD_SAMPLES, NO_LEAD, prepare
from identifiability.measurement.splitting import hold_out
from identifiability.measurement.trials import Trial

JOINT = {"K": 40.0, "B": 1.0, "I": 0.1}
TIME = np.arange(500) / 1000


def servo(n=2400, rate=400.0, seed=1, rest=0.3):
    """A servo's smoothed random steps of the angle after a rest, and the torque of a joint."""
    random = np.random.default_rng(seed)
    quiet = round(rest * rate)
    sizes = random.choice([-0.1, -0.05, 0.05, 0.1], n // 40 + 1)
    steps = np.concatenate([np.zeros(quiet), np.repeat(sizes, 40)[: n - quiet]])
    sos = signal.butter(3, 12.0, fs=rate, output="sos")
    angle = signal.sosfilt(sos, steps) + 0.2
    velocity = np.gradient(angle, 1 / rate)
    torque = JOINT["K"] * (angle - 0.2) + JOINT["B"] * velocity
    torque += JOINT["I"] * np.gradient(velocity, 1 / rate) + 0.05 * random.standard_normal(n)
    angle += 1e-5 * random.standard_normal(n)
    return Trial(np.arange(n) / rate, torque + 3.0, angle, driven="angle", name="servo")


def pulse(lead=0.05, level=0.0, torque_level=0.0, noise=1e-4, seed=1, size=8.0, time=None):
    """A torque pulse after a lead, and a response like a joint's, at a level."""
    time = TIME if time is None else time
    after = np.maximum(time - lead, 0.0)
    torque = size * ((time > lead + 1e-9) & (after <= 0.05))
    angle = 0.01 * size * np.exp(-8 * after) * np.sin(25 * after)
    angle += noise * np.random.default_rng(seed).standard_normal(time.size)
    return Trial(time, torque + torque_level, angle + level)


def test_a_level_that_the_leads_scatter_explains_is_left():
    found = [prepare([pulse(noise=1e-3, seed=seed)])[0] for seed in range(40)]
    # Four standard errors: hardly ever by chance. The control: ten of them are seen always.
    assert sum(p.treatment.angle != 0.0 for p in found) <= 1
    standard_error = 1e-3 / np.sqrt(50)
    moved = [
        prepare([pulse(noise=1e-3, seed=seed, level=10 * standard_error)])[0] for seed in range(40)
    ]
    levels = np.array([p.treatment.angle for p in moved])
    assert np.all(levels != 0.0)
    assert abs(levels.mean() - 10 * standard_error) < 4 * standard_error / np.sqrt(40)
    assert not any(p.has_offset for p in (*found, *moved))


def test_the_levels_taken_off_are_told():
    trial = pulse(level=0.3, torque_level=-2.0)
    (ready,) = prepare([trial])
    assert ready.treatment.level_of == "lead"
    assert ready.treatment.torque == pytest.approx(-2.0)
    assert ready.treatment.angle == pytest.approx(0.3, abs=1e-4)
    np.testing.assert_allclose(ready.response, trial.angle - ready.treatment.angle)
    np.testing.assert_allclose(ready.drive.signals[:, 0], trial.torque + 2.0, atol=1e-12)
    assert len(ready.trial.notes) == 1
    (imposed,) = prepare([servo()], lowpass_hz=30.0)
    # About the posture that it starts from; the level of the torque stays unknown.
    assert imposed.treatment.level_of == "lead"
    assert imposed.treatment.angle == pytest.approx(servo().angle[0], abs=1e-3)
    assert imposed.drive.signals[0, 0] == pytest.approx(0.0, abs=1e-3)
    assert imposed.has_offset
    assert imposed.treatment.lowpass_hz == 30.0
    assert imposed.treatment.decimation == 2
    assert imposed.interval == pytest.approx(2 / 400)
    plain = imposed.record()["preparation"]
    assert (plain["lowpass_hz"], plain["decimation"]) == (30.0, 2)


@pytest.mark.parametrize(("rest", "level_of"), [(0.3, "lead"), (0.095, "record")])
def test_a_hold_among_many_is_no_rest(rest, level_of):
    """An angle that switches every 100 ms, after a longer and after a shorter hold."""
    trial = servo(rest=rest)
    (ready,) = prepare([trial], lowpass_hz=None)
    assert ready.recorded_lead.n_samples > 0
    assert ready.treatment.level_of == level_of
    expected = trial.angle.mean() if level_of == "record" else 0.2
    assert ready.treatment.angle == pytest.approx(expected, abs=1e-3)


def test_an_imposed_angle_is_about_where_it_rests_or_about_one_angle_for_all():
    """At any rate: springs that are not linear act about the same angle in every trial."""
    for rate in (100.0, 400.0):
        trials = [servo(rate=rate, n=round(3 * rate), seed=i, rest=50 / rate) for i in range(3)]
        resting = prepare(trials)
        assert all(p.treatment.level_of == "lead" for p in resting)
        assert all(abs(p.trial.angle[:5]).max() < 1e-3 for p in resting)
    moving = [servo(seed=i, rest=0.0) for i in range(3)]
    (taken,) = {p.treatment.angle for p in prepare(moving)}
    assert taken == pytest.approx(np.mean([trial.angle for trial in moving]))


@pytest.mark.parametrize(("lead", "known"), [(0.03, False), (0.05, True)])
def test_a_short_lead_is_none(lead, known):
    (ready,) = prepare([pulse(lead=lead, level=0.3, time=np.arange(300) / 500)])
    assert 10 < ready.onsets[0] < 30  # about 15 and 25 samples, where 20 are asked for
    assert (ready.lead != NO_LEAD) is known
    assert ready.has_offset is not known
    assert (ready.treatment.level_of == "lead") is known


def test_the_lead_tells_the_noise():
    time = np.arange(2000) / 1000
    white = [pulse(lead=1.0, noise=1e-3, seed=s, time=time) for s in range(10)]
    sds = [p.lead.sd for p in prepare(white)]
    # Of 1000 samples each: sd to 1/sqrt(2000).
    assert np.mean(sds) == pytest.approx(1e-3, rel=4 / np.sqrt(2000 * 10))
    coloured = [
        replace(t, angle=t.angle + Noise(2e-3, 0.01).draw(time.size, 1e-3, seed=i))
        for i, t in enumerate(white)
    ]
    pooled = {p.lead.correlation_time for p in prepare(coloured)}
    assert len(pooled) == 1
    rho = np.exp(-0.1)
    expected = 1 + 0.8 * ((1 + rho) / (1 - rho) - 1)
    assert pooled.pop() == pytest.approx(expected, rel=0.35)


def test_of_an_imposed_angle_the_lead_is_recorded_and_not_taken_for_the_noise():
    trials = [servo(seed=s, rest=1.0) for s in range(4)]
    for hz, sd in ((None, 0.05), (50.0, None)):
        for ready in prepare(trials, lowpass_hz=hz):
            assert ready.recorded_lead.n_samples >= LEAD_SAMPLES
            assert ready.lead == NO_LEAD
            assert ready.has_offset
            if sd is not None:
                assert ready.recorded_lead.sd == pytest.approx(sd, rel=0.2)
            else:
                assert 0.2 * 0.05 < ready.recorded_lead.sd < 0.05  # the filter takes its share
            # Nothing of the motion is in it, spread by the filter.
            quiet = ready.response[: ready.recorded_lead.n_samples]
            assert np.ptp(quiet) < 0.1 * np.ptp(ready.response)
            assert ready.record()["preparation"]["lead"]["is_the_noise"] is False
    split = gather(trials)
    assert not split.has_noise
    assert split.noise_floor() is None


def test_a_record_that_is_perturbed_in_one_half_only_is_not_split():
    trial = pulse(noise=1e-3)
    noisy = replace(
        trial, torque=trial.torque + 0.05 * np.random.default_rng(1).standard_normal(500)
    )
    for one in (trial, noisy):
        parts = hold_out(prepare([one]))
        assert (parts.rule, parts.held_out) == ("nothing", ())
        with pytest.raises(InputError, match="one half only"):
            gather([one])
    assert hold_out(prepare([servo()])).rule == "second half"


def test_named_trials_are_held_out():
    trials = [pulse(size=size) for size in (8.0, 4.0, 2.0)]
    parts = hold_out(prepare(trials), 1)
    assert parts.rule == "named"
    assert [p.trial.torque.max() for p in parts.held_out] == [2.0]
    assert [p.trial.torque.max() for p in hold_out(prepare(trials)).held_out] == [8.0]


def test_trials_of_two_kinds_are_not_prepared_together():
    with pytest.raises(InputError, match="one kind at a time"):
        prepare([pulse(), servo()])
    with pytest.raises(InputError, match="no trials"):
        prepare([])
