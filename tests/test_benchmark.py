"""The benchmark: its cases are judged as recorded; its record, its page and the README agree.

The cases come from a simulator that shares no equation with the package. The whole benchmark is
``identifiability benchmark investigation``; a few of its cases are computed here in every session,
and one of each sort in a small form (the tier "quick") on demand.
"""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from identifiability.benchmark.cases import hidden_cases
from identifiability.benchmark.record import benchmark_record, recorded_scores
from identifiability.benchmark.run import WHOLE, run_benchmark, score
from identifiability.benchmark.score import NAMING, Score, outcome_of
from identifiability.errors import InputError
from identifiability.plots.benchmark import confusion_figure
from identifiability.provenance import read_record
from identifiability.report.benchmark import page

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"


@pytest.fixture(scope="module")
def record():
    return read_record(RESULTS / "investigation.json").record


@pytest.fixture(scope="module")
def by_seed(record):
    return {run["seed"]: [Score.from_dict(case) for case in run["cases"]] for run in record["runs"]}


@pytest.fixture(scope="module")
def scores(by_seed):
    return [score for of_seed in by_seed.values() for score in of_seed]


def test_the_page_is_that_of_the_record(record):
    assert (RESULTS / "investigation.md").read_bytes() == page(record).encode()


def test_the_rates_are_those_of_the_cases(record, by_seed):
    again = json.loads(
        json.dumps(benchmark_record(by_seed, tried=record["cases_in_tiers"]), allow_nan=False)
    )
    for key in ("schema", "cases_run", "cases_in_tiers", "runs", "together"):
        assert again[key] == record[key]


def test_the_cases_are_those_of_the_tiers(record, by_seed):
    tried = 0
    for seed, scores in by_seed.items():
        specs = {(t, s.name) for t in WHOLE for s in hidden_cases(t, seed)}
        assert {(s.tier, s.name) for s in scores} <= specs
        assert {s.tier for s in scores} == set(WHOLE)
        tried += len(specs)
    assert record["cases_in_tiers"] == tried


def test_the_figure_counts_every_hidden_effect(scores):
    drawn = confusion_figure(scores).axes[0].texts
    named = [len(s.named) if s.verdict in NAMING else 0 for s in scores]
    expected = sum(max(1, len(s.truth), n) for s, n in zip(scores, named, strict=True))
    assert sum(int(t.get_text()) for t in drawn) == expected
    assert (RESULTS / "investigation" / "confusion.png").stat().st_size > 10_000


def test_the_readme_quotes_the_page(record, scores):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first_table = next(block for block in page(record).split("\n\n") if block.startswith("|"))
    assert first_table in readme
    assert f"{record['cases_run']} of {record['cases_in_tiers']} cases" in readme
    minutes = sum(score.seconds or 0.0 for score in scores) / 60
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
    "controls-64-ar1",
    "singles-32-gravity",
    pytest.param("singles-40-sensor_lowpass", marks=pytest.mark.long),
    pytest.param("unknown-00-time_varying_stiffness", marks=pytest.mark.long),
)
RIGHT = ("right", "right among others")


@pytest.mark.parametrize("name", AGAIN)
def test_a_case_is_scored_as_recorded(name, by_seed):
    tier, (seed, scores) = name.split("-")[0], next(iter(by_seed.items()))
    spec = next(s for s in hidden_cases(tier, seed) if s.name == name)
    published = next(s for s in scores if s.name == name)
    ours = score(tier, spec)
    assert ours.outcome in RIGHT
    assert (ours.verdict, ours.named, ours.outcome) == (
        published.verdict,
        published.named,
        published.outcome,
    )
    assert ours.warnings == ()
    for (key, *errors), (expected, *others) in zip(ours.rungs, published.rungs, strict=True):
        assert key == expected
        assert errors == pytest.approx(others, rel=1e-3)


# The run, with an investigation that is made up


def made_up(tier, spec):
    """Score that says which case it is of; two cases fail."""
    if spec.stream[1] == 2:
        raise InputError("no luck")
    if spec.stream[1] == 3 and spec.kind == "known":
        raise ArithmeticError("and none here")
    named = tuple((key,) for key in spec.keys)
    kind = "explained" if named else "nothing_missing"
    # Of the seed, so that a mix-up shows.
    share = spec.seed / 1000 if named else None
    return Score(
        *(spec.name, tier, spec.kind, spec.keys, False, spec.recorder.ratio, kind, named),
        *("right", True if named else None, share, 1.5, (("", 0.5, float(spec.stream[1])),)),
    )


@pytest.fixture
def calls(monkeypatch):
    done = []

    def counted(tier, spec):
        done.append((tier, spec.name, spec.seed))
        return made_up(tier, spec)

    monkeypatch.setattr("identifiability.benchmark.run.score", counted)
    return done


def run_here(folder, **options):
    options = {
        "tiers": ("pairs", "nulls"),
        "seeds": (1, 7),
        "every": 2,
        "progress": False,
    } | options
    return run_benchmark(options.pop("tiers"), folder, **THREADS, **options)


THREADS = {"executor": lambda: ThreadPoolExecutor(2)}


def test_a_benchmark_keeps_what_is_done_and_tries_again_what_failed(tmp_path, calls):
    scores, outcomes = run_here(tmp_path)
    for seed in (1, 7):
        specs = [s for t in ("pairs", "nulls") for s in hidden_cases(t, seed)[::2]]
        assert [s.name for s in scores[seed]] == [s.name for s in specs]
        assert {s.removed for s in scores[seed]} == {seed / 1000, None}
    failed = [s for of_seed in scores.values() for s in of_seed if s.outcome == "failed"]
    assert {s.failure for s in failed} == {"InputError: no luck"}
    assert len(failed) == 4 == sum(o.status != "done" for o in outcomes)
    n_calls = len(calls)
    assert len(set(calls)) == n_calls == len(outcomes)
    again, outcomes = run_here(tmp_path)
    assert calls[n_calls:] == [
        (s.tier, s.name, seed) for seed in scores for s in scores[seed] if s.failure
    ]
    assert again == scores
    assert sum(o.resumed for o in outcomes) == len(outcomes) - 4


def test_scores_of_other_code_are_not_read(tmp_path, calls, monkeypatch):
    run_here(tmp_path, tiers=("nulls",), seeds=(1,), every=25)
    monkeypatch.setattr("identifiability.sweep.keep.code_fingerprint", lambda module: "other")
    _, outcomes = run_here(tmp_path, tiers=("nulls",), seeds=(1,), every=25)
    assert not any(o.resumed for o in outcomes)
    assert len(calls) == 2 * len(outcomes)


def test_cases_of_a_record_by_this_code_are_not_judged_again(tmp_path, calls, monkeypatch):
    scores, _ = run_here(None)
    path = tmp_path / "investigation.json"
    path.write_text(json.dumps(benchmark_record(scores, tried=100), allow_nan=False))
    known, n_calls = recorded_scores(path), len(calls)
    assert known == scores
    # A third seed is judged, and what failed is tried again.
    again, outcomes = run_here(None, seeds=(1, 7, 9), known=known)
    assert {seed: again[seed] for seed in (1, 7)} == scores
    assert {seed for *_, seed in calls[n_calls:]} == {1, 7, 9}
    assert len(outcomes) == len(again[9]) + sum(s.outcome == "failed" for s in known[1] + known[7])
    monkeypatch.setattr("identifiability.provenance.code_fingerprint", lambda *modules: "other")
    assert recorded_scores(path) == {}


def test_seeds_stand_side_by_side(calls):
    scores, outcomes = run_here(None)
    record = benchmark_record(scores, tried=2 * len(outcomes))
    text = page(json.loads(json.dumps(record, allow_nan=False)))
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    side, one, two, cases_one, cases_two = blocks
    assert side[0].split(" | ")[1:3] == ["seed 1", "seed 7"]
    for name, t in record["together"].items():
        row = next(line for line in side if line.startswith(f"| {name} |"))
        runs = [run["tiers"][name] for run in record["runs"]]
        assert t["right"] == sum(r["right"] for r in runs)
        for r in runs:
            assert f"| {r['right']} right, {r['wrong']} wrong of {r['n']} |" in row
    assert len(one) == len(two) == len(side)
    assert len(cases_one) == len(cases_two) == 2 + len(scores[1])
    assert sum(run["tiers"]["nulls"]["outcomes"]["failed"] for run in record["runs"]) == 2


@pytest.mark.long
def test_scores_are_the_same_whatever_runs_the_workers():
    """The function that workers run, through the default processes and through threads."""
    options = {"seeds": (1,), "every": 100, "progress": False}
    found = [
        run_benchmark(("nulls",), None, **options, **how)[0] for how in ({"workers": 1}, THREADS)
    ]
    (one,), (two,) = (next(iter(scores.values())) for scores in found)
    assert not one.failure
    assert one.seconds != two.seconds
    same = replace(two, seconds=one.seconds, rungs=one.rungs)
    assert one == same
    for (_, *a), (_, *b) in zip(one.rungs, two.rungs, strict=True):
        assert a == pytest.approx(b, rel=1e-6)


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
