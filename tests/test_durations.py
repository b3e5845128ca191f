"""The benchmark of durations: what it times, what it hears, and its page."""

import json
from dataclasses import replace

import numpy as np
import pytest

from identifiability.benchmark import durations
from identifiability.benchmark.durations import SIZES, Row, Size, Timed, measured, recordings, timed
from identifiability.cli.main import main
from identifiability.report.durations import durations_page

TINY = Size("tiny", 2, 150, 250.0, "torque")
FAST = Timed(20.0, 4.0, "comparing", {"probabilities": 15.0, "widths": 3.0}, ["effects", "gravity"])


@pytest.mark.parametrize("imposed", ["torque", "angle"])
def test_recordings_are_noisy_in_both_channels_and_alike_by_alike_seeds(imposed):
    size = replace(TINY, imposed=imposed)
    trials = recordings(size, 3)
    assert [trial.shape for trial in trials] == [(150, 3)] * 2
    time, *channels = trials[0].T
    np.testing.assert_allclose(np.diff(time), 1 / 250)
    assert all(np.ptp(channel[time < 0.09]) > 0 for channel in channels)
    np.testing.assert_array_equal(trials, recordings(size, 3))
    assert not np.array_equal(trials, recordings(size, 4))


def test_a_command_that_fails_is_quoted_and_waits_for_no_compiler(tmp_path):
    """Compiling takes most of a minute: of a command that cannot be run nothing was."""
    with pytest.raises(RuntimeError, match=r"fit nowhere --out out: .*nowhere"):
        timed(["fit", "nowhere", "--out", "out"], tmp_path, tmp_path / "cache")
    assert (tmp_path / "cache").is_dir()
    assert not [path for path in (tmp_path / "cache").rglob("*.nb*") if path.is_file()]


@pytest.mark.long
@pytest.mark.parametrize("imposed", ["torque", "angle"])
def test_the_command_is_timed_and_listened_to(imposed):
    row = measured(replace(TINY, imposed=imposed), 3)
    for one in (row.empty, row.full):
        assert 0 < one.silence < one.seconds
        assert one.before
        assert 0 < sum(one.timings.values()) < one.seconds
        assert one.found[0] in ("effects", "clue", "nothing", "unknown", "undecided")
    # An empty cache has all to compile.
    assert row.full.seconds < row.empty.seconds
    assert row.fits == row.full.seconds / row.fit.seconds
    assert json.loads(json.dumps(durations.record([row], seed=3)))["rows"][0]["fits"] == row.fits


def test_what_is_too_slow_or_too_silent_is_marked():
    slow = replace(FAST, seconds=50.0, silence=12.0)
    rows = [Row(SIZES[0], FAST, slow, FAST), Row(SIZES[-1], FAST, FAST, FAST)]
    page = durations_page(durations.record(rows, seed=3))
    assert "| six trials | torque | 6 | 500 | **50** | 40 | 20 | 25 | 1.0 | **12** |" in page
    assert "| a minute | angle | 1 | 60,000 | 20 | | 20 | | 1.0 | 4 | gravity |" in page
    assert "probabilities 15 s, widths 3 s" in page


def test_bad_options_are_one_sentence(capsys, tmp_path):
    assert main(["benchmark", "durations", "--seed", "-2", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
