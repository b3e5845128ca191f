"""What tracking hangs on: the committed page, cells computed again, and what each change does."""

import json
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identifiability.cli.main import main
from identifiability.report.sensitivity import answers, sensitivity_page
from identifiability.study import sensitivity
from identifiability.study.sensitivity import ATLAS, VARIANTS, Variant, evaluate, record, tasks
from identifiability.sweep.outcome import Outcome

RESULTS = Path(__file__).parents[1] / "results"
RECORD = json.loads((RESULTS / "sensitivity.json").read_text())


def cells_named(*parts):
    return {n: asked for n, asked in tasks().items() if all(part in n for part in parts)}


def test_the_page_is_that_of_the_record():
    assert (RESULTS / "sensitivity.md").read_text() == sensitivity_page(RECORD)
    assert RECORD["cells"]["done"] == RECORD["cells"]["total"] == len(tasks())
    assert [r["variant"] for r in RECORD["rows"][::6]] == list(VARIANTS)
    for row in RECORD["rows"]:
        low, high = row["interval"]
        assert low <= row["within"] / row["of"] <= high


def test_one_thing_differs_from_the_atlas_in_each():
    for name, variants in VARIANTS.items():
        changed = [
            key
            for key, value in vars(Variant()).items()
            if any(getattr(v, key) != value for v in variants)
        ]
        assert len(changed) == (name != ATLAS)
    seen = {(asked.cell, asked.variant) for asked in tasks().values()}
    assert len(seen) == len(tasks())


@pytest.mark.parametrize("name", random.Random(3).sample(list(VARIANTS), 3))
def test_a_row_is_computed_again(name):
    """All fits of the muscle in the middle, of which the stored row has the sum."""
    some = list(cells_named(f"{name}, 0: ", "K_CE=60 ", "T=0.2 ", "energy").items())
    done = {n: Outcome(n, "done", evaluate(asked)) for n, asked in some[:3]}
    (row,) = record(done, seed=1)["rows"]
    (stored,) = (
        r for r in RECORD["rows"] if (r["variant"], r["reading"], r["T"]) == (name, "energy", 0.2)
    )
    missed = row["of"] - row["within"]
    assert row["within"] <= stored["within"]
    assert missed <= stored["of"] - stored["within"]


def test_without_bounds_the_posterior_is_no_narrower_than_a_bound_made_it():
    """Where the optimum is near nothing, the bound takes half of the posterior away."""
    (asked,) = cells_named(
        f"{ATLAS}, ", ": K_CE=10 ", " B_CE=2 ", "K_SE/K_CE=10 ", "T=0.05 ", "contour"
    ).values()
    free = replace(asked, variant=Variant(bounded=False))
    bounded, unbounded = evaluate(asked), evaluate(free)
    assert str(bounded["verdict"]) == "truncated"
    assert unbounded["spread"][0] > 1.2 * bounded["spread"][0]


def test_a_known_inertia_has_no_width_and_narrows_the_others():
    (asked,) = cells_named(
        f"{ATLAS}, ", "K_CE=60 ", "B_CE=8 ", "K_SE/K_CE=5 ", "T=0.1 ", "energy"
    ).values()
    found, known = evaluate(asked), evaluate(replace(asked, variant=Variant(inertia_known=True)))
    assert np.isnan(known["spread"][2])
    assert np.all(known["spread"][:2] < found["spread"][:2])
    logs = evaluate(replace(asked, variant=Variant(logarithms=True)))
    np.testing.assert_allclose(logs["predicted"], found["predicted"] / found["optimum"], rtol=1e-9)
    np.testing.assert_allclose(logs["spread"], found["spread"] / found["optimum"], rtol=0.2)


def test_the_command_writes_the_page(tmp_path, monkeypatch, capsys):
    few = dict(list(cells_named("K_CE=60 ", "B_CE=8 ", "K_SE/K_CE=5 ", "T=0.2 ", "energy").items()))
    monkeypatch.setattr(sensitivity, "tasks", lambda seed=1: few)
    assert main(["sensitivity", "--out", str(tmp_path), "--workers", "1"]) == 0
    found = json.loads((tmp_path / "sensitivity.json").read_text())
    assert found["cells"] == {"total": 13, "done": 13}
    assert (tmp_path / "sensitivity.md").read_text() == sensitivity_page(found)
    assert answers(found)[0].replace("**", "") in capsys.readouterr().out
