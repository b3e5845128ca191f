"""Continuous recordings are cut at their perturbations, and two files are laid on one clock."""

import numpy as np
import pytest

from identifiability.cli.main import main, parser
from identifiability.cli.options import read_trials
from identifiability.errors import InputError
from identifiability.measurement.cutting import APART, LEAD, cut_at_onsets, is_cut
from identifiability.measurement.prepared import prepare_whole_band
from identifiability.measurement.readers.two_files import ChannelFile, read_two_files
from identifiability.measurement.trials import Trial, onsets
from identifiability.plots.recording import cut_recordings
from identifiability.report.figures import Figures
from identifiability.report.page import Page

K, B, INERTIA = 60.0, 1.2, 0.08
PACE = 0.1
STARTS = np.array([0.3, 0.9, 1.4, 2.2])


def motion(time):
    """Smooth steps of an angle, with velocity and acceleration."""
    found = np.zeros((3, time.size))
    for start, size in zip(STARTS, (0.04, -0.02, 0.03, -0.05), strict=True):
        s = np.clip((time - start) / PACE, 0, 1)
        found[0] += size * (10 * s**3 - 15 * s**4 + 6 * s**5)
        found[1] += size * (30 * s**2 - 60 * s**3 + 30 * s**4) / PACE
        found[2] += size * (60 * s - 180 * s**2 + 120 * s**3) / PACE**2
    return found


def torque_of(time):
    return np.array([K, B, INERTIA]) @ motion(time) + 3.0


def recording(interval=1e-3, noise=0.02, driven="angle", **names):
    time = np.arange(0, 3, interval)
    random = np.random.default_rng(2)
    torque = torque_of(time) + noise * random.standard_normal(time.size)
    if driven == "angle":
        return Trial(time, torque, motion(time)[0], driven="angle", **names)
    # What is imposed is what rests and moves; the physics does not matter to a cut.
    return Trial(time, motion(time)[0], 0.1 * torque, driven="torque", **names)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_each_trial_has_its_perturbation_and_no_sample_belongs_to_two(driven):
    whole = recording(driven=driven)
    trials = cut_at_onsets(whole)
    found = [t.time[onsets(t)[0]] for t in trials]
    np.testing.assert_allclose(found, STARTS, atol=0.015)
    assert [t.name for t in trials] == [f"trial {i}" for i in (1, 2, 3, 4)]
    starts = [t.time[0] for t in trials]
    np.testing.assert_allclose(np.array(found) - starts, 0.1, atol=2e-3)
    joined = np.concatenate([t.time for t in trials])
    np.testing.assert_array_equal(joined, whole.time[whole.time >= starts[0]])
    np.testing.assert_array_equal(
        np.concatenate([t.angle for t in trials]), whole.angle[-joined.size :]
    )
    assert all(is_cut(t) and "cut at its perturbations" in t.notes[-1] for t in trials)


def test_a_lead_ends_half_way_to_the_perturbation_before():
    trials = cut_at_onsets(recording(), lead=0.4)
    starts = [t.time[0] for t in trials]
    np.testing.assert_allclose(starts, [0.0, 0.6, 1.15, 1.8], atol=0.015)


def test_both_edges_of_a_pulse_are_one_perturbation():
    time = np.arange(0, 2, 1e-3)
    torque = sum(2.0 * ((time > at) & (time < at + 0.15)) for at in (0.3, 1.2))
    angle = np.convolve(torque, np.exp(-np.arange(200) / 40) / 400)[: time.size]
    whole = Trial(time, torque, angle)
    found = [t.time[onsets(t)[0]] for t in cut_at_onsets(whole)]
    np.testing.assert_allclose(found, [0.3, 1.2], atol=2e-3)
    assert len(cut_at_onsets(whole, separation=0.1)) == 4
    with pytest.raises(InputError, match="0 s apart"):
        cut_at_onsets(whole, separation=0)


def test_one_perturbation_is_left_whole():
    whole = recording().between(0.0, 0.8)
    assert cut_at_onsets(whole) == (whole,)
    assert not is_cut(whole)
    with pytest.raises(InputError, match="a lead of -1 s"):
        cut_at_onsets(whole, lead=-1)


def test_trials_of_one_recording_are_shown_together():
    parts = [cut_at_onsets(recording(source=name, sha256=name)) for name in "ab"]
    mixed = [parts[0][2], parts[1][0], parts[0][0], parts[1][1], recording()]
    first, second = cut_recordings(mixed)
    assert [t.source for t in (*first, *second)] == ["a", "a", "b", "b"]
    assert first == [parts[0][0], parts[0][2]]


def columns_text(time, values, header):
    rows = [f"{t!r},{v!r}" for t, v in zip(time.tolist(), values.tolist(), strict=True)]
    return "\n".join([header, *rows]) + "\n"


@pytest.fixture
def two_files(tmp_path):
    """Write the angle at one rate and the torque at another, on clocks of their own."""

    def write(angle_hz, torque_hz, late=0.0, noise=0.0, start=0.0):
        random = np.random.default_rng(5)
        angle, torque = tmp_path / "angle.csv", tmp_path / "torque.csv"
        time = np.arange(0, 3, 1 / angle_hz)
        values = np.rad2deg(motion(time)[0])
        angle.write_text(columns_text(time, values, "time (s),angle (deg)"))
        time = np.arange(start, 3, 1 / torque_hz)
        values = torque_of(time) + noise * random.standard_normal(time.size)
        torque.write_text(columns_text(time - late, values, "time_s,torque_Nm"))
        return angle, torque

    return write


@pytest.mark.parametrize("rates", [(1000, 1000), (250, 1000), (1000, 250), (200, 1024)])
def test_two_files_are_laid_on_one_clock(two_files, rates):
    angle, torque = two_files(*rates, late=0.25, start=0.1003)
    trial = read_two_files(ChannelFile(angle), ChannelFile(torque), late=0.25, driven="angle")
    assert trial.sampling_rate == pytest.approx(min(rates))
    # Its jerk has steps, of which what would fold back is taken out.
    tolerance = 0.04 * np.ptp(torque_of(trial.time))
    np.testing.assert_allclose(trial.angle, motion(trial.time)[0], atol=2e-4)
    np.testing.assert_allclose(trial.torque, torque_of(trial.time), atol=tolerance)
    assert trial.time[0] == pytest.approx(0.1003, abs=1.01 / min(rates))
    assert "its clock set 0.25 s later" in trial.notes
    # The control: without it the torque is where it was not.
    wrong = read_two_files(ChannelFile(angle), ChannelFile(torque), driven="angle")
    assert np.abs(wrong.torque - torque_of(wrong.time)).max() > 5 * tolerance


def test_what_is_fast_in_one_channel_does_not_fold_back(two_files):
    angle, torque = two_files(200, 1000)
    time, values = np.loadtxt(torque, delimiter=",", skiprows=1).T
    hum = 0.5 * np.sin(2 * np.pi * 330 * time)
    torque.write_text(columns_text(time, values + hum, "time_s,torque_Nm"))
    trial = read_two_files(ChannelFile(angle), ChannelFile(torque), driven="angle")
    inner = slice(20, -20)
    off = (trial.torque - torque_of(trial.time))[inner]
    assert np.sqrt(np.mean(off[:20] ** 2)) < 0.01  # at rest


def test_a_file_without_time_has_a_rate(two_files, tmp_path):
    angle, torque = two_files(500, 500)
    bare = tmp_path / "bare.csv"
    values = np.loadtxt(torque, delimiter=",", skiprows=1)[:, 1]
    bare.write_text("".join(f"{v!r}\n" for v in values.tolist()))
    of_torque = ChannelFile(bare, columns={"torque": (0, "Nm")}, rate=500.0)
    trial = read_two_files(ChannelFile(angle), of_torque, driven="angle")
    np.testing.assert_allclose(trial.torque, torque_of(trial.time), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"late": 9.0}, r"angle\.csv and torque\.csv: .*with 0 samples in both.*--torque-late"),
        ({"late": np.nan}, "late by nan s"),
        ({"torque": ChannelFile("nowhere.csv")}, r"nowhere\.csv: there is no such file"),
    ],
)
def test_files_that_cannot_be_laid_together_are_refused(two_files, change, sentence):
    angle, torque = map(ChannelFile, two_files(500, 500))
    with pytest.raises(InputError, match=sentence):
        read_two_files(**{"angle": angle, "torque": torque} | change)


def test_a_file_that_has_the_other_channel_alone_says_which_is_missing(two_files):
    angle, torque = map(ChannelFile, two_files(500, 500))
    with pytest.raises(InputError, match=r"torque\.csv: the header .* which column is angle"):
        read_two_files(torque, angle)


def options_of(*words):
    return parser().parse_args(list(map(str, words)))


def test_the_command_reads_two_files_and_cuts_them(two_files, tmp_path):
    angle, torque = two_files(500, 1000, late=0.02)
    words = ["investigate", angle, "--torque-from", torque, "--torque-late", 0.02]
    options = options_of(*words, "--driven", "angle", "--cut", "0.2", "--out", tmp_path)
    trials = read_trials(options)
    assert [t.name for t in trials] == [f"angle {i}" for i in (1, 2, 3, 4)]
    np.testing.assert_allclose([t.time[0] for t in trials], STARTS - 0.2, atol=0.015)
    assert all("torque from torque.csv" in t.notes for t in trials)
    usual = options_of("fit", angle, "--cut", "--out", tmp_path)
    assert (usual.cut, usual.cut_apart) == (LEAD, APART)
    assert read_trials(options, []) == []  # of what is held out, where nothing is


def test_the_report_shows_the_cuts_as_they_were_recorded(tmp_path):
    page, trials = Page("Cuts"), cut_at_onsets(recording(noise=0.0))
    figures = Figures(page, tmp_path)
    figures.show_cuts(prepare_whole_band([recording()]))
    assert figures.written == []  # nothing was cut
    figures.show_cuts(prepare_whole_band(trials))
    assert "figures/cuts.svg" in figures.written
    assert "cut into 4 trials" in page.render()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--torque-late", "0.1"], "--torque-late without --torque-from"),
        (["--torque-from", "{torque}", "--resample", "100"], "--resample with --torque-from"),
        (["--torque-from", "{torque}", "{torque}"], "2 files of torque for 1 of angle"),
        (["--cut", "-0.1"], "a lead of -0.1 s"),
        (["--cut", "--cut-apart", "0"], "0 s apart"),
    ],
)
def test_the_command_refuses_what_does_not_fit_together(
    two_files, tmp_path, capsys, words, sentence
):
    angle, torque = two_files(500, 500)
    if "--cut" in words:
        time, values = np.loadtxt(angle, delimiter=",", skiprows=1).T
        rows = np.column_stack([time, values, torque_of(time)])
        np.savetxt(angle, rows, delimiter=",", header="time_s,angle_deg,torque_Nm", comments="")
    words = [word.format(torque=torque) for word in words]
    assert main(["fit", str(angle), *words, "--out", str(tmp_path / "out")]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
