"""The published calibration of probabilities: page and README say what the record says."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from identifiability.benchmark import calibration
from identifiability.benchmark.blind import TIERS, blind_cases
from identifiability.benchmark.calibration import BlindScore, outcome_of, same, score_from, share
from identifiability.benchmark.score import wilson
from identifiability.benchmark.seeds import together
from identifiability.cli.main import main
from identifiability.report.calibration import calibration_page

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def record():
    return json.loads((ROOT / "results" / "calibration.json").read_text(encoding="utf-8"))


def test_the_page_is_that_of_the_record(record):
    page = (ROOT / "results" / "calibration.md").read_text(encoding="utf-8")
    assert page == calibration_page(record)


def test_the_record_counts_its_cases(record):
    by_seed = {run["seed"]: [score_from(one) for one in run["scores"]] for run in record["runs"]}
    assert list(by_seed) == record["seeds"]
    found = json.loads(json.dumps(together(by_seed, n=record["cases"])))
    for part in ("tiers", "claims", "reliability", "joint"):
        assert found[part] == record[part]
        for one, other in zip(found["runs"], record["runs"], strict=True):
            assert one[part] == other[part]
    for seed, scores in by_seed.items():
        expected = {
            spec.name
            for tier in TIERS
            for spec in blind_cases(tier, seed, share(tier, record["cases"]))
        }
        assert {s.name for s in scores} == expected


SEEN = {193}  # seeds that were worked on before the run that is published


@pytest.mark.parametrize("page", ["README.md", "docs/how_well_it_decides.md"])
def test_what_is_written_quotes_the_record(record, page):
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    fresh = [run for run in record["runs"] if run["seed"] not in SEEN]
    scores = [one for run in fresh for one in run["scores"]]
    named, right = (sum(run["claims"][part] for run in fresh) for part in ("n", "right"))
    seeds = " and ".join(str(run["seed"]) for run in fresh)
    assert f"seed{'s' * (len(fresh) > 1)} {seeds} that nobody had worked on" in text
    assert f"named effects in {named} of {len(scores)} cases, {right} of them rightly" in text
    low, high = wilson(right, named)
    assert f"{100 * low:.0f} to {100 * high:.0f} %" in text
    if page == "README.md":
        return
    for tier in TIERS:
        mine = [s for s in scores if s["tier"] == tier]
        count = sum(s["outcome"] == "right" for s in mine)
        assert f"{count} of {len(mine)} {tier}" in text
    (likely,) = (one for one in record["reliability"] if one["from"] == 0.8)
    assert f"80 to 95 %, {likely['true']} of {likely['n']} were the truth" in text


@pytest.mark.parametrize(
    ("truth", "claim", "sets", "expected"),
    [
        ((), "nothing", (), "right"),
        ((), "unknown", (), "wrong"),
        ((), "effects", (("gravity",),), "wrong"),
        (None, "unknown", (), "right"),
        (None, "nothing", (), "abstained"),
        (None, "effects", (("gravity",),), "wrong"),
        (("gravity",), "effects", (("cubic_stiffness", "gravity"),), "right"),
        (("gravity",), "effects", (("cubic_stiffness",),), "wrong"),
        (("gravity",), "unknown", (), "abstained"),
        (("gravity", "second_mass"), "effects", (("gravity",),), "partly"),
        (("gravity",), "effects", (("gravity",), ("second_mass",)), "wrong"),
    ],
)
def test_a_claim_is_held_to_every_name(truth, claim, sets, expected):
    assert outcome_of(truth, claim, sets) == expected


def test_only_effects_of_one_form_are_the_same():
    assert same(("series_tendon", "gravity"), ("gravity", "maxwell_branch"))
    assert not same(("gravity",), ("stretch_reflex",))
    assert not same(("gravity",), ("gravity", "second_mass"))
    assert not same((), None)


def a_score(rows, truth):
    case = ("case", "singles", "torque", "white", 1e-4, False)
    return BlindScore(*case, truth, "effects", (), 0.0, rows, "right", 0.0)


def test_intervals_are_counted_where_the_truth_was_claimed():
    nothing = replace(
        a_score((((), 1.0),), ()), joint=(("K", 30.0, 31.0, 0.6), ("I", 0.1, 0.1, 0.0))
    )
    named = replace(
        a_score(((("gravity",), 1.0),), ("gravity",)), joint=(("I", 0.1, 0.103, 0.001),)
    )
    wrong = replace(nothing, outcome="wrong")
    without, with_effects = calibration.record([nothing, named, wrong], n=3, seed=1)["joint"]
    # One at a bound has no interval.
    assert (without["n"], without["covered"]) == (1, 1)
    assert (with_effects["n"], with_effects["covered"]) == (1, 0)
    assert with_effects["error"] == pytest.approx(0.03)


def test_scores_are_best_for_who_is_sure_and_right():
    sure = a_score(((("maxwell_branch",), 1.0),), ("series_tendon",))
    assert (sure.of_truth, sure.brier, sure.log_score) == (1.0, 0.0, 0.0)
    wrong = a_score(((("gravity",), 1.0),), None)
    assert wrong.brier == 2.0
    assert wrong.log_score > 20
    open_ = a_score((((), 0.5), (None, 0.5)), None)
    assert open_.brier == pytest.approx(0.5)


def test_bad_options_are_one_sentence(capsys, tmp_path):
    out = str(tmp_path / "out")
    for options in (["--cases", "0"], ["--seed", "-2"]):
        assert main(["benchmark", "calibration", *options, "--out", out]) == 2
        assert capsys.readouterr().err.count("\n") == 1
