"""The published coverage of blind joints that miss nothing, and how it is counted."""

import json
from pathlib import Path

import numpy as np
import pytest

from identifiability.benchmark import nulls
from identifiability.benchmark.blind import blind_cases
from identifiability.benchmark.score import wilson
from identifiability.cli.main import main
from identifiability.report.nulls import nulls_page

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def record():
    return json.loads((ROOT / "results" / "nulls.json").read_text(encoding="utf-8"))


def of(record, **what):
    return [r for r in record["rows"] if all(r[key] == value for key, value in what.items())]


def total(rows, key):
    return sum(r[key] for r in rows)


def test_the_page_is_that_of_the_record(record):
    assert (ROOT / "results" / "nulls.md").read_text(encoding="utf-8") == nulls_page(record)


def test_every_case_is_counted(record):
    assert total(of(record, way="auto"), "n") == 3 * record["cases"]
    assert total(of(record, way="straight"), "n") == total(
        of(record, way="auto", imposed="torque"), "n"
    )
    for r in record["rows"]:
        assert tuple(r["interval"]) == wilson(r["covered"], r["n"])


def test_intervals_hold_the_truth_and_the_control_fails(record):
    for imposed in ("torque", "angle"):
        rows = of(record, way="auto", imposed=imposed)
        low, high = wilson(total(rows, "covered"), total(rows, "n"))
        assert low < 0.95 < high
    straight = of(record, way="straight")
    assert wilson(total(straight, "covered"), total(straight, "n"))[1] < 0.9
    assert total(straight, "far") > 5 * total(of(record, way="auto"), "far")


def test_what_is_written_quotes_the_record(record):
    own = of(record, way="auto")
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    share = 100 * total(own, "covered") / total(own, "n")
    assert f"{share:.1f} % of {total(own, 'n')}" in readme


def test_a_torque_that_ran_smooth_is_told_by_coloured_noise():
    """Least squares see no difference; straight lines are many standard deviations off."""
    spec = next(
        s
        for s in blind_cases("nulls", 2027, 6)
        if s.name.startswith("nulls-002") and s.noise == "random walk"
    )
    found = nulls.errors(spec)
    off = np.abs(found["error"] / found["sd"])
    assert off[0].max() < 3
    assert off[1].min() > 5


def test_a_run_is_written_and_bad_options_are_one_sentence(tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["benchmark", "nulls", "--cases", "2", "--seed", "4", "--out", out]) == 0
    made = json.loads((tmp_path / "out" / "nulls.json").read_text(encoding="utf-8"))
    assert total(of(made, way="auto"), "n") == 6
    capsys.readouterr()
    for options in (["--cases", "1"], ["--seed", "1", "2"]):
        assert main(["benchmark", "nulls", *options, "--out", out]) == 2
        assert capsys.readouterr().err.count("\n") == 1
