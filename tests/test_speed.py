"""The benchmark of speed: what it times, by which likelihood, and the page that is published."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from identifiability.benchmark import peers, speed
from identifiability.benchmark.speed import (
    BASE,
    OWN,
    Row,
    Scaling,
    Timed,
    cells,
    many,
    measured,
    row_from,
)
from identifiability.cli.main import main
from identifiability.inference.fitting import fit
from identifiability.inference.quadrature import quadrature
from identifiability.measurement.perturbations import PERTURBATIONS
from identifiability.report.speed import speed_page

RESULTS = Path(__file__).resolve().parents[1] / "results"
FAST, SLOW = Timed(1e4, 0.1, 1.0, 0.01, True), Timed(1e3, 2.0, 3.5, 0.04, False)
STAGES = {"fit": 0.01, "posterior": 0.05, "whole": 0.08}


def test_cells_span_the_grid():
    every = cells(1)
    assert len({cell.name for cell in every}) == 27
    for name, values in {"K_CE": 3, "B_CE": 3, "ratio": 3, "T": 3, "perturbation": 5}.items():
        assert len({getattr(cell, name) for cell in every}) == values
    assert {cell.reading for cell in every} == {"contour", "energy"}


def test_cells_to_scale_by_are_of_every_kind():
    some = many(1)
    assert len({cell.name for cell in some}) == len(some) > 2 * speed.FEW
    assert {cell.perturbation for cell in some} == set(PERTURBATIONS)
    assert len({cell.T for cell in some}) == 3


@pytest.mark.parametrize("ask", [peers.own, peers.by_emcee])
def test_widths_are_those_of_the_quadrature(ask):
    """Another sampler on the same likelihood; what it draws is counted alike."""
    cell = cells(1)[13]
    problem = cell.problem()
    best = fit(problem, cell.setting.starts())
    sd = quadrature(problem, best.values).sd
    drawn = ask(problem, best.values, 3)
    assert drawn.converged
    assert drawn.ess.min() > 400
    assert np.all(np.abs(drawn.sd - sd) < 4 * drawn.sd_mcse)
    again = ask(problem, best.values, 3)
    np.testing.assert_array_equal(again.sd, drawn.sd)


@pytest.mark.long
@pytest.mark.parametrize("name", [*peers.PEERS, peers.NUTS_NAME])
def test_every_library_that_is_there_finds_these_widths(name):
    if name not in peers.installed():
        pytest.skip(f"needs the library of {name}")
    row = measured(cells(1)[13], {name: "installed"})
    for one in (row.samplers[OWN], row.samplers[name]):
        assert one.apart < 5
        assert one.off < 0.2
        assert min(one.ess, one.seconds) > 0


def test_a_cell_is_timed_by_its_parts_and_as_a_whole():
    row = measured(cells(1)[0], {})
    assert list(row.samplers) == [OWN]
    parts = [seconds for part, seconds in row.stages.items() if part != "whole"]
    assert min(parts) > 0
    assert 0.5 < sum(parts) / row.stages["whole"] < 1.5
    assert row.own_evaluations > 50_000
    assert 0 < row.bare < 1e-3
    assert row_from(json.loads(json.dumps(asdict(row)))) == row


def test_the_page_says_how_many_times_as_many():
    rows = [Row(f"cell {i}", {OWN: FAST, BASE: SLOW}, STAGES, 1e-6, 50_000) for i in range(3)]
    assert rows[0].times(BASE) == 200
    scaled = Scaling(50, 200, 7.0, 22.0, 12.0, 400.0)
    assert (scaled.each, scaled.start, scaled.by_two) == pytest.approx((0.1, 2.0, 2.0))
    page = speed_page(json.loads(json.dumps(speed.record(rows, scaled, seed=1))))
    assert "2.0 s to start, and 0.100 s for each cell more. Two workers do 2.00" in page
    assert "would take two workers 11 minutes (aim: 10)" in page
    assert "**200 times** as many effective draws a second" in page
    assert f"| {BASE} | 500 (500 to 500) | 200 (200 to 200) | 0 of 3 | 3 of 3 | 4.0 % |" in page
    assert "**0.080 s** of a processor" in page
    assert "| posterior | 0.050 (0.050 to 0.050) | 62 % |" in page


def test_bad_options_are_one_sentence(capsys, tmp_path):
    assert main(["benchmark", "speed", "--seed", "-2", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_is_published_is_what_the_record_says():
    stored = json.loads((RESULTS / "benchmarks.json").read_text())
    assert (RESULTS / "benchmarks.md").read_text() == speed_page(stored)
    rows = [row_from(row) for row in stored["rows"]]
    assert [row.name for row in rows] == [cell.name for cell in cells(stored["seed"])]
    assert all(row.samplers[OWN].converged for row in rows)
    # Of 27 largest of three errors each, nearly normal, one in ten is above 2.6 and none above 4.5.
    assert max(row.samplers[OWN].apart for row in rows) < 4.5
