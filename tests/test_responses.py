"""The benchmark of responses: what it times, and the page that is published."""

import json
from pathlib import Path

import pytest

from identifiability.benchmark.responses import MODELS, measure, questions, record
from identifiability.joint.effects import EFFECTS
from identifiability.report.responses import responses_page

RESULTS = Path(__file__).resolve().parents[1] / "results"


@pytest.mark.parametrize("imposed", ["torque", "angle"])
def test_both_ways_are_timed_and_compared(imposed):
    row = measure(("cubic_stiffness",), imposed)
    assert row.n_parameters == 5
    assert min(row.once, row.once_jax, row.each, row.each_jax) > 0
    assert row.difference < 1e-9
    page = responses_page(json.loads(json.dumps(record([row]))))
    assert f"| cubic stiffness | {imposed} | 1 step a sample of order 2 | 5 |" in page


def test_every_effect_is_asked_in_both_causalities():
    asked = list(questions())
    assert len(asked) == 2 * len(MODELS)
    assert {key for effects, _ in asked for key in effects} == set(EFFECTS)


def test_what_is_published_is_what_the_record_says():
    stored = json.loads((RESULTS / "responses.json").read_text())
    assert (RESULTS / "responses.md").read_text() == responses_page(stored)
    assert [(tuple(r["effects"]), r["imposed"]) for r in stored["rows"]] == list(questions())
    assert all(r["difference"] < 1e-9 for r in stored["rows"])
    # A fit asks for many points of many models: neither may cost more than it did.
    assert stored["once"] < stored["once_jax"]
    assert stored["median_each"] > 1
