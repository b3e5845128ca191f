"""The published coverage of intervals: page and README say what the record says."""

import json
from pathlib import Path

import pytest

from identifiability.benchmark import coverage
from identifiability.benchmark.score import wilson
from identifiability.cli.main import main
from identifiability.report.coverage import coverage_page

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def record():
    return json.loads((ROOT / "results" / "coverage.json").read_text(encoding="utf-8"))


def test_the_page_is_that_of_the_record(record):
    page = (ROOT / "results" / "coverage.md").read_text(encoding="utf-8")
    assert page == coverage_page(record)


def test_every_kind_is_there_in_both_causalities(record):
    found = {(r["kind"], r["imposed"], r["name"]) for r in record["rows"]}
    assert found == {
        (kind, imposed, name)
        for kind in coverage.KINDS
        for imposed in ("torque", "angle")
        for name in coverage.NAMES
    }
    for r in record["rows"]:
        assert r["n"] + r["failed"] == record["recordings"]
        assert tuple(r["interval"]) == wilson(r["covered"], r["n"])


def test_what_is_written_quotes_the_record(record):
    readme, page = (
        " ".join((ROOT / name).read_text(encoding="utf-8").split())
        for name in ("README.md", "docs/your_own_data.md")
    )
    rows = record["rows"]
    covered, n = (sum(r[key] for r in rows) for key in ("covered", "n"))
    for text in (readme, page):
        assert f"{100 * covered / n:.1f} % of {n} intervals" in text
    low, high = record["mark"]
    inside = sum(low <= r["covered"] / r["n"] <= high for r in rows)
    assert f"{inside} of {len(rows)} rows" in page


def test_what_is_not_covered_is_marked(record):
    low = {**record["rows"][0], "covered": 10, "n": 100, "interval": (0.06, 0.17)}
    page = coverage_page({**record, "rows": [low]})
    assert "| 10 % **off** |" in page
    assert "1 lie outside" in page


def test_bad_options_are_one_sentence(capsys, tmp_path):
    out = str(tmp_path / "out")
    for options in (["--recordings", "1"], ["--seed", "-2"]):
        assert main(["benchmark", "coverage", *options, "--out", out]) == 2
        assert capsys.readouterr().err.count("\n") == 1
