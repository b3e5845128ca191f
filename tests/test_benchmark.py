"""The benchmark: its cases are judged as recorded; its record, its page and the README agree.

The cases come from a simulator that shares no equation with the package. The whole benchmark is
``identifiability benchmark investigation``; a few of its cases are computed here in every session,
and one of each sort in a small form (the tier "quick") on demand.
"""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from identifiability.benchmark.cases import hidden_cases
from identifiability.benchmark.page import page, summary
from identifiability.benchmark.run import WHOLE, score
from identifiability.benchmark.score import NAMING, Score, outcome_of
from identifiability.plots.benchmark import confusion_figure

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"


@pytest.fixture(scope="module")
def record():
    return json.loads((RESULTS / "investigation.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def scores(record):
    return [Score.from_dict(case) for case in record["cases"]]


def test_the_page_is_that_of_the_record(record):
    assert (RESULTS / "investigation.md").read_bytes() == page(record).encode()


def test_the_rates_are_those_of_the_cases(record, scores):
    again = summary(scores, seed=record["seed"], tried=record["cases_in_tiers"])
    assert json.loads(json.dumps(again)) == record | {"package": again["package"]}


def test_the_cases_are_those_of_the_tiers(record, scores):
    specs = {(t, s.name) for t in WHOLE for s in hidden_cases(t, record["seed"])}
    assert {(s.tier, s.name) for s in scores} <= specs
    assert record["cases_in_tiers"] == len(specs)
    assert {s.tier for s in scores} == set(WHOLE)


def test_the_figure_counts_every_hidden_effect(scores):
    drawn = confusion_figure(scores).axes[0].texts
    named = [len(s.named) if s.verdict in NAMING else 0 for s in scores]
    expected = sum(max(1, len(s.truth), n) for s, n in zip(scores, named, strict=True))
    assert sum(int(t.get_text()) for t in drawn) == expected
    assert (RESULTS / "investigation" / "confusion.png").stat().st_size > 10_000


def test_the_readme_quotes_the_page(record):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    table = [line for line in page(record).splitlines() if line.startswith("|")]
    for line in table[: 2 + len(record["tiers"])]:
        assert line in readme
    assert f"{record['cases_run']} of {record['cases_in_tiers']} cases" in readme
    minutes = sum(case["seconds"] for case in record["cases"]) / 60
    assert f"some {10 * round(minutes / 10)} minutes" in readme


def test_the_figure_has_a_row_for_what_no_effect_of_the_library_is():
    case = Score(
        *("a", "unknown", "unknown", ("backlash",), False, 1e-4, "explained"),
        *((("second_mass",),), "wrong", None, 0.9, 10.0),
    )
    axes = confusion_figure([case]).axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["backlash"]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["second mass"]
    # What is named beyond what is hidden is shown too.
    two = replace(case, named=(("second_mass",), ("gravity",)))
    axes = confusion_figure([two]).axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["backlash", "nothing more"]


# Coloured noise in which there is nothing to find, and an effect of the joint; on demand an effect
# of the instruments, and a joint that is not the same in every trial.
AGAIN = (
    "controls-86-ar1",
    "singles-33-second_mass",
    pytest.param("singles-37-sensor_delay", marks=pytest.mark.long),
    pytest.param("unknown-10-time_varying_stiffness", marks=pytest.mark.long),
)
RIGHT = ("right", "right among others")


@pytest.mark.parametrize("name", AGAIN)
def test_a_case_is_scored_as_recorded(name, record, scores):
    tier = name.split("-")[0]
    spec = next(s for s in hidden_cases(tier, record["seed"]) if s.name == name)
    published = next(s for s in scores if s.name == name)
    ours = score(tier, spec)
    assert ours.outcome in RIGHT
    assert (ours.verdict, ours.named, ours.outcome) == (
        published.verdict,
        published.named,
        published.outcome,
    )
    for (key, *errors), (expected, *others) in zip(ours.rungs, published.rungs, strict=True):
        assert key == expected
        assert errors == pytest.approx(others, rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("spec", hidden_cases("quick", 1), ids=lambda spec: spec.name)
def test_one_of_each_sort_is_judged_rightly(spec):
    found = score("quick", spec)
    assert not found.failure
    assert found.outcome in RIGHT, (found.verdict, found.named)


def test_the_score_does_not_forgive_a_wrong_name():
    """Negative control: the same verdict scored against another truth."""
    assert outcome_of("known", ("gravity",), "explained", [["coulomb_friction"]]) == "wrong"
    assert outcome_of("none", (), "explained", [["coulomb_friction"]]) == "wrong"
