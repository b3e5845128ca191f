from __future__ import annotations

import argparse
import itertools
import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray

from identifiability.cli import atlas as command
from identifiability.errors import InputError
from identifiability.inference.fitting import fit
from identifiability.inference.widths import VERDICTS
from identifiability.measurement.perturbations import PERTURBATIONS
from identifiability.plots.atlas import drawings
from identifiability.plots.style import save
from identifiability.provenance import code_fingerprint, read_record
from identifiability.report.atlas import MOST_LISTED, page
from identifiability.study.atlas import N_DRAWS, Cell, Plan, plan_from, read_plan, run_atlas
from identifiability.study.atlas_record import record
from identifiability.study.setting import error_problem
from identifiability.study.store import CELL, FIELDS, to_dataset, write_atlas
from identifiability.sweep.outcome import Outcome

RESULTS = Path(__file__).parents[1] / "results"

SMALL = {
    "K_CE": [10, 200],
    "B_CE": [5],
    "ratio": [2],
    "T": [0.05],
    "perturbations": ["impulse"],
    "readings": ["energy"],
    "corner": [],
}


# -- configuration ----------------------------------------------------------------------------


def test_the_papers_grid_is_the_whole_of_it():
    plan = plan_from({"grid": "paper"})
    assert len(plan.cells()) == 300 * 3 * 3 * 5 * 2
    assert (plan.K_CE[0], plan.K_CE[-1], len(plan.K_CE)) == (10, 200, 20)
    assert (plan.B_CE[0], plan.B_CE[-1], len(plan.B_CE)) == (2, 30, 15)


def test_keys_beside_the_papers_grid_replace_their_part():
    plan = plan_from({"grid": "paper", "T": [0.1], "readings": ["contour"]})
    assert len(plan.cells()) == 300 * 3 * 5


def test_the_default_grid_spans_the_papers():
    plan, paper = read_plan(None), plan_from({"grid": "paper"})
    for axis, values in paper.axes.items():
        mine = plan.axes[axis]
        if isinstance(values[0], float):
            assert (mine[0], mine[-1]) == (values[0], values[-1])
    assert set(plan.readings) == set(paper.readings)
    assert "impulse" in plan.perturbations
    assert len(plan.perturbations) > 1


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"K_SE": [1]}, "unknown key 'K_SE', expected some of"),
        ({"K_CE": []}, "found K_CE = [], expected a list of different numbers above 0"),
        ({"B_CE": 3.0}, "found B_CE = 3.0, expected a list"),
        ({"B_CE": [3.0, "4"]}, "expected a list of different numbers"),
        ({"B_CE": [3.0, True]}, "expected a list of different numbers"),
        ({"ratio": [2, -5]}, "found ratio = [2, -5], expected"),
        ({"ratio": [2, float("nan")]}, "found ratio"),
        ({"ratio": [2, float("inf")]}, "found ratio"),
        ({"K_CE": [10, 10.0]}, "different numbers"),
        ({"T": [50, 100]}, "found T = [50, 100], expected seconds"),
        ({"T": [0.0505]}, "three whole sampling intervals"),
        ({"T": [0.002]}, "three whole sampling intervals"),
        ({"rate": 250, "T": [0.1], "perturbations": ["pulse"]}, "lies between two samples"),
        ({"perturbations": ["ramp"]}, "found perturbations = ['ramp'], expected a list of some of"),
        ({"perturbations": []}, "found perturbations = []"),
        ({"perturbations": "impulse"}, "found perturbations = 'impulse'"),
        ({"perturbations": [["impulse"]]}, "found perturbations"),
        ({"readings": ["contour", "contour"]}, "each once"),
        ({"readings": ["loud"]}, "['contour', 'energy']"),
        ({"seed": -1}, "found seed = -1, expected a whole number"),
        ({"seed": 1.5}, "whole number"),
        ({"seed": True}, "whole number"),
        ({"dE": 0}, "found dE = 0, expected a number above 0"),
        ({"rate": "fast"}, "found rate = 'fast', expected a number"),
        ({"correlation_time": -0.1}, "found correlation_time = -0.1"),
        ({"corner": [[32, 3.2, 100]]}, "expected rows of K_CE, B_CE, K_SE and I"),
        ({"corner": [32, 3.2, 100, 0.1]}, "expected rows of"),
        ({"corner": [[32, 0, 100, 0.1]]}, "numbers above 0"),
        ({"grid": "whole"}, "found grid = 'whole', expected \"paper\""),
        ({"grid": ["paper"]}, "found grid = ['paper']"),
    ],
)
def test_a_wrong_configuration_is_told_in_one_sentence(config, expected):
    with pytest.raises(InputError) as error:
        plan_from(config)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "cannot read"),
        (b"K_CE = [10", "is not valid TOML"),
        (b"\xff\xfe", "is no text"),
        (b"K_CE = []", "in '"),
    ],
)
def test_a_wrong_file_is_told_in_one_sentence(tmp_path, content, expected):
    path = tmp_path / "config.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        read_plan(path)


def test_a_file_says_the_same_as_a_mapping(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text('K_CE = [200, 10]\nreadings = ["energy"]\ncorner = [[32, 3.2, 100, 0.1]]\n')
    config = {"K_CE": [200, 10], "readings": ["energy"], "corner": [[32, 3.2, 100, 0.1]]}
    assert read_plan(path) == plan_from(config)
    assert read_plan(path).K_CE == (10.0, 200.0)


# -- cells ------------------------------------------------------------------------------------


def test_seeds_belong_to_cells_and_not_to_grids():
    narrow = plan_from(SMALL).cells()
    wide = plan_from({"K_CE": [3, 10, 77, 200], "B_CE": [1, 5], "T": [0.05, 0.3]}).cells()
    assert set(narrow) <= set(wide)
    for name, cell in narrow.items():
        assert cell.own_seed == wide[name].own_seed
    seeds = [cell.own_seed for cell in Plan().cells().values()]
    assert len(set(seeds)) == len(seeds)
    other = plan_from({**SMALL, "seed": 2}).cells()
    assert not {c.own_seed for c in narrow.values()} & {c.own_seed for c in other.values()}
    # Written down: another number would mean another result for the same configuration.
    assert Cell(10.0, 5.0, 2.0, 0.05, "impulse", "energy").own_seed == 735324690


def test_cells_of_one_shape_follow_each_other():
    plan = plan_from({"grid": "paper"})
    shapes = [(cell.T, cell.perturbation) for cell in plan.cells().values()]
    changes = sum(a != b for a, b in itertools.pairwise(shapes))
    assert changes == len(plan.T) * len(plan.perturbations) - 1


# -- store, record, page and figures, with made-up results -----------------------------------


def made_up(cell: Cell) -> dict[str, np.ndarray]:
    """What `evaluate` returns, for a posterior that is known."""
    rng = np.random.default_rng(cell.own_seed)
    optimum = np.array([cell.K_CE, cell.B_CE / 10, cell.I])
    width = optimum / cell.K_CE
    truncated = cell.K_CE < 50
    sd = width * (0.5 if truncated else 1.0)
    ends = optimum[:, None] + np.array([-1.96, 1.96]) * sd[:, None]
    verdict = "truncated" if truncated else "agrees"
    sides = np.full((3, 2), "closed")
    if truncated:
        sides[1, 0] = "bound"
    return {
        **dict.fromkeys(
            ("slice", "quadratic", "change", "gauss_newton", "sandwich", "profile"), width
        ),
        **dict.fromkeys(("profile_68", "profile_95", "posterior_68", "posterior_95"), ends),
        **dict.fromkeys(("optimum", "posterior_mean", "quadrature_mean"), optimum),
        "posterior_sd": sd,
        "posterior_sd_mcse": sd / 100,
        "quadrature_sd": sd * (1 - 2 / 100),
        "rhat": np.full(3, 1.001),
        "ess_bulk": np.full(3, 5000.0),
        "ess_tail": np.full(3, 4000.0),
        "E": np.array(1e-6 * cell.K_CE),
        "at_bound": np.array([False, truncated, False]),
        "profile_end": sides,
        "parameter_verdict": np.full(3, verdict),
        "parameter_reason": np.full(3, "because"),
        "verdict": np.array(verdict),
        "reason": np.array("because"),
        "step": np.array("laplace-t"),
        "step_reason": np.array("it fits"),
        "acceptance": np.array(0.9),
        "draws": rng.normal(optimum, sd, (N_DRAWS, 3)).astype(np.float32),
        "seconds": np.array(1.0),
    }


def made_up_outcomes(plan: Plan, *, failing: int = 0) -> dict[str, Outcome]:
    outcomes = {}
    for i, (name, cell) in enumerate(plan.cells().items()):
        if i < failing:
            outcomes[name] = Outcome(name, "crashed", cause="its process | died")
        else:
            outcomes[name] = Outcome(name, "done", made_up(cell), seconds=1.0)
    return outcomes


def test_cells_run_on_any_executor(plan, tmp_path, monkeypatch):
    monkeypatch.setattr("identifiability.study.atlas.evaluate", made_up)
    pools = []

    def executor() -> ThreadPoolExecutor:
        pools.append(ThreadPoolExecutor(2))
        return pools[-1]

    outcomes = run_atlas(plan, tmp_path, executor=executor, progress=False)
    assert len(pools) == 1
    assert {name: o.status for name, o in outcomes.items()} == dict.fromkeys(plan.cells(), "done")
    assert all(o.resumed for o in run_atlas(plan, tmp_path, progress=False).values())


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_from({"K_CE": [10, 50, 200], "B_CE": [2, 30], "ratio": [2], "T": [0.05, 0.2]})


def test_made_up_results_have_what_real_ones_have(plan):
    cell = next(iter(plan.cells().values()))
    assert set(made_up(cell)) == set(FIELDS) - {"status", "cause", "seed"}


def test_the_store_puts_every_cell_in_its_place(plan, tmp_path):
    outcomes = made_up_outcomes(plan, failing=1)
    write_atlas(to_dataset(plan, outcomes), tmp_path / "atlas.nc")
    with xarray.open_dataset(tmp_path / "atlas.nc") as data:
        data = data.load()
        assert data["verdict"].dims == CELL
        assert data["parameter"].values.tolist() == ["K", "B", "I"]
        assert data["unit"].values.tolist() == ["Nm/rad", "Nms/rad", "kg m²"]
        assert data["K_CE"].attrs["units"] == "N m rad-1"
        for i, (name, cell) in enumerate(plan.cells().items()):
            found = data.sel({axis: getattr(cell, axis) for axis in CELL})
            assert found["seed"].item() == cell.own_seed
            assert found["K_SE"].item() == cell.setting.K_SE
            if i == 0:
                assert (found["status"].item(), found["verdict"].item()) == ("crashed", "")
                assert found["optimum"].isnull().all()
                continue
            for key, value in outcomes[name].arrays.items():
                stored = np.asarray(value)
                if stored.dtype == float and FIELDS[key].kind == "f4":
                    stored = stored.astype(np.float32)
                np.testing.assert_array_equal(found[key].values, stored, err_msg=key)


def test_the_record_counts_what_is_there(plan):
    failing = 2
    found = record(to_dataset(plan, made_up_outcomes(plan, failing=failing)), command="c")
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    total = len(plan.cells())
    assert (found["cells"]["total"], found["cells"]["done"]) == (total, total - failing)
    assert [cell["status"] for cell in found["cells"]["failed"]] == ["crashed"] * failing
    counts = {
        verdict: sum(group["counts"].get(verdict, 0) for group in found["verdicts"])
        for verdict in VERDICTS
    }
    assert counts["truncated"] == total / 3 - failing
    assert counts["agrees"] == total * 2 / 3
    assert sum(group["of"] for group in found["verdicts"]) == total - failing
    for group in found["bounds"]:
        assert group["counts"] == {"B >= 0": group["of"]}
    # The distance is K_CE in these results: 10, 50 and 200.
    for group in found["distances"]:
        near, far = (c for c in group["classes"] if c["of"])
        assert near["to"] <= 15
        assert near["agrees"] == 0
        assert far["agrees"] == far["of"] == total / 3
    assert found["referee"]["rms"] == pytest.approx(2.0, rel=1e-5)
    assert found["referee"]["largest"] == pytest.approx(2.0, rel=1e-5)
    assert found["referee"]["of"] == 3 * (total - failing)
    assert found["referee"]["disagreeing"] == []
    for group in found["ratios"]:
        assert (group["smallest"], group["largest"]) == pytest.approx((0.5, 1.0))
    assert found["sampler"]["steps"] == {"laplace-t": total - failing}


def test_the_page_says_what_the_record_says(plan):
    found = record(to_dataset(plan, made_up_outcomes(plan, failing=1)), command="atlas --out here")
    text = page(found)
    for group in found["verdicts"]:
        T = f"{1000 * group['T']:g} ms"
        counts = [f"{group['counts'].get(v, 0)} of {group['of']}" for v in ("agrees", "truncated")]
        row = rf"\| {group['reading']} \| {T} \| {counts[0]} \| {counts[1]} \|"
        assert re.search(row, text)
    assert "its process \\| died" in text
    assert "    atlas --out here" in text
    assert "nan" not in text.lower().split()
    assert max(len(line) for line in text.splitlines() if not line.startswith(("|", "-"))) <= 100


def test_a_width_that_was_sampled_wrongly_is_named(plan):
    data = to_dataset(plan, made_up_outcomes(plan))
    place = {"K_CE": 50, "B_CE": 30, "ratio": 2, "T": 0.2, "perturbation": "impulse"}
    data["quadrature_sd"].loc[{**place, "reading": "energy", "parameter": "B"}] *= 4
    (wrong,) = record(data, command="c")["referee"]["disagreeing"]
    assert {**wrong, **place, "reading": "energy", "parameter": "B"} == wrong
    assert wrong["integrated"] == pytest.approx(4 * 0.98 * wrong["sampled"])
    text = page(record(data, command="c"))
    assert "This is so in 1 cell." in text
    assert "| K_CE 50, B_CE 30, K_SE/K_CE 2, 200 ms, impulse, energy | agrees | B |" in text


def test_the_page_does_not_drown_in_failures():
    plan = plan_from({"T": [0.05]})
    found = record(to_dataset(plan, made_up_outcomes(plan, failing=30)), command="c")
    assert page(found).count("| crashed |") == MOST_LISTED
    assert f"Of 30 the first {MOST_LISTED}" in page(found)


def test_every_figure_can_be_drawn_whatever_failed(plan, tmp_path):
    """Where nothing does, the whole command draws them."""
    data = to_dataset(plan, made_up_outcomes(plan, failing=3))
    found = list(drawings(data))
    n_maps = 4 * len(plan.readings) + len(plan.perturbations)
    assert len({one.stem for one in found}) == len(found) == n_maps + 3
    for one in found:
        figure = one.draw()
        columns = len(plan.ratio) * len(plan.T)
        rows = 3 if one.stem.startswith("optimum") else len(plan.perturbations)
        panels = [axes for axes in figure.axes if axes.images]
        assert len(panels) == (rows * columns if one.kind == "map" else 0)
        save(figure, tmp_path / "figure.png")


def test_spread_is_held_against_its_predictions(plan):
    data = to_dataset(plan, made_up_outcomes(plan))
    for group in record(data, command="c")["tracking"]:
        # Half the width where K_CE is 10, of three values; the width itself elsewhere.
        assert group["of"] == group["predicted"] == len(plan.cells()) / 4
        assert group["within_tenth"]["value"] == pytest.approx(2 / 3)
        assert group["within_twice"]["value"] == 1.0
        assert group["ratio"] == pytest.approx(1.0)
        assert group["within_tenth"]["low"] < 2 / 3 < group["within_tenth"]["high"]
    # Spread that is a power of the prediction, and spread that has nothing to do with it.
    for power in (1.0, 0.5, 0.0):
        values = 3.0 * data["quadratic"] ** power
        found = record(data.assign(posterior_sd=values), command="c")["tracking"]
        for group in found:
            if group["parameter"] == "B":  # the widths of the others are all the same here
                assert group["slope"]["value"] == pytest.approx(power, abs=1e-6)
            assert group["prediction"] in ("quadratic", "change")


def test_cells_are_counted_for_every_tolerance(plan):
    data = to_dataset(plan, made_up_outcomes(plan))
    data["quadratic"].loc[{"K_CE": 50}] *= 1.3
    for group in record(data, command="c")["tolerances"]:
        shares = {w["tolerance"]: w["share"] for w in group["within"]}
        # Off by a half, by 1 - 1 / 1.3 and not at all.
        assert shares[0.01] == pytest.approx(1 / 3)
        assert shares[0.25] == pytest.approx(2 / 3)
        assert shares[0.5] == 1.0


def test_the_fitted_stiffness_is_held_against_those_of_the_joint(plan):
    found = record(to_dataset(plan, made_up_outcomes(plan)), command="c")["structural"]
    for group in found:
        # The fitted K is K_CE; a tendon twice as stiff leaves two thirds of it to slow movements.
        assert group["K_CE"]["q50"] == pytest.approx(0.0, abs=1e-6)
        assert group["slow"]["q50"] == pytest.approx(0.5)
        assert group["fast"]["q95"] == pytest.approx(-0.5)
        assert group["slow"]["beyond_two_sd"] == 1.0


def test_an_atlas_of_nothing_but_failures_still_has_a_page(plan):
    data = to_dataset(plan, made_up_outcomes(plan, failing=10**6))
    text = " ".join(page(record(data, command="c")).split())
    assert f"in 0 of {len(plan.cells())} cells" in text


def test_the_committed_page_is_made_from_the_committed_record():
    found = read_record(RESULTS / "atlas.json").record
    assert (RESULTS / "atlas.md").read_bytes() == page(found).encode()
    for figure in found["figures"] + found["corners"]:
        assert (RESULTS / figure["file"]).is_file()


def test_the_readme_says_what_the_atlas_found():
    found = read_record(RESULTS / "atlas.json").record
    groups = [group for group in found["tracking"] if group["prediction"] == "quadratic"]

    def share(some):
        right = sum(g["within_tenth"]["value"] * g["predicted"] for g in some)
        return 100 * right / sum(g["of"] for g in some)

    every = {(g["reading"], g["T"]) for g in groups}
    shares = [share([g for g in groups if (g["reading"], g["T"]) == one]) for one in every]
    off = [100 * group["slow"]["q50"] for group in found["structural"]]
    readme = (RESULTS.parent / "README.md").read_text(encoding="utf-8")
    said = re.search(
        r"(\d+) % of the posterior widths are within a tenth.*?\((\d+) % to (\d+) % by"
        r".*?median\s+K is (\d+) to (\d+) % off the stiffness",
        readme,
        re.DOTALL,
    )
    assert said is not None
    expected = [share(groups), min(shares), max(shares), min(off), max(off)]
    assert [int(number) for number in said.groups()] == [round(e) for e in expected]


# -- the command ------------------------------------------------------------------------------


def run(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    options = parser.parse_args(["atlas", *map(str, arguments)])
    return options.run(options)


def test_an_atlas_of_two_cells_from_end_to_end(tmp_path, monkeypatch, capsys):
    config = tmp_path / "config.toml"
    settings = {**SMALL, "corner": [[200, 5, 400, 0.1]]}
    config.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in settings.items()))
    out = tmp_path / "out"
    assert run(config, "--out", out, "--workers", 1) == 0
    with xarray.open_dataset(out / "atlas.nc") as data:
        data = data.squeeze().load()
    assert data["verdict"].values.tolist() == ["truncated", "agrees"]
    for K_CE in data["K_CE"].values:
        found, cell = data.sel(K_CE=K_CE), Cell(K_CE, 5.0, 2.0, 0.05, "impulse", "energy")
        assert found["seed"].item() == cell.own_seed
        exact = fit(
            error_problem(cell.setting, PERTURBATIONS["impulse"](), 0.05), cell.setting.starts()
        )
        # The sampled criterion is that of the paper up to the rule of integration.
        assert found["E"].item() == pytest.approx(2 * exact.cost, rel=0.1)
        np.testing.assert_allclose(found["optimum"], exact.values, rtol=0.02)
        draws = found["draws"].values
        np.testing.assert_allclose(draws.mean(axis=0), found["posterior_mean"], rtol=0.3)
        off = np.abs(found["posterior_sd"] - found["quadrature_sd"]) / found["posterior_sd_mcse"]
        assert float(off.max()) < 5
    ratio = (data["posterior_sd"] / data["quadratic"]).sel(parameter="B").values
    assert ratio[0] < 0.7
    assert ratio[1] == pytest.approx(1, abs=0.05)

    assert data.attrs["code"] == code_fingerprint("identifiability.study.store")
    summary, remark = read_record(out / "atlas.json")
    assert remark == ""
    assert (out / "atlas.md").read_bytes() == page(summary).encode()
    for figure in summary["figures"] + summary["corners"]:
        assert (out / figure["file"]).is_file()
        assert (out / figure["file"]).with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert len(summary["figures"]) == 3 + 4 + 1
    (corner,) = summary["corners"]
    assert (out / corner["file"]).read_bytes().startswith(b"\x89PNG")
    # The model of the corner plot is that of a cell, and so are seed and verdict.
    assert corner["verdict"] == "agrees"

    # The same command again computes nothing, and says the same; what it draws was seen above.
    monkeypatch.setattr("identifiability.plots.style.bytes_of", lambda figure, *_, **__: b"")
    before = (out / "atlas.cells" / "log.jsonl").read_bytes()
    pages = (out / "atlas.md").read_bytes()
    assert run(config, "--out", out, "--workers", 1) == 0
    assert (out / "atlas.cells" / "log.jsonl").read_bytes() == before
    assert (out / "atlas.md").read_bytes() == pages
    assert "2 of 2, 2 of them from an earlier run" in capsys.readouterr().err


def other_code(path, _):
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        data = data.load()
    data.attrs["code"] = "0" * 32
    data.to_netcdf(path, engine="h5netcdf")


def other_order(path, _):
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        data = data.load()
    data.isel(parameter=[1, 0, 2]).to_netcdf(path, engine="h5netcdf")


def other_plan(path, settings):
    settings |= {"K_CE": [10, 30], "seed": 2}


def damaged(path, _):
    path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (other_plan, ["K_CE is 10.0, 200.0 there and 10.0, 30.0 here", "seed is 1 there and 2"]),
        (other_code, ["made by other code (fingerprint 000000000000, now"]),
        (other_order, ["its parameters are B, K, I and not K, B, I"]),
        (damaged, ["it cannot be read"]),
    ],
)
def test_another_atlas_is_not_replaced_unless_that_is_asked_for(
    change, named, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        "identifiability.study.atlas.run_atlas", lambda plan, folder, **_: made_up_outcomes(plan)
    )
    monkeypatch.setattr("identifiability.plots.atlas.drawings", lambda data: ())
    config, out, settings = tmp_path / "config.toml", tmp_path / "out", dict(SMALL)

    def command(*more: str) -> int:
        text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in settings.items())
        config.write_text(text)
        return run(config, "--out", out, *more)

    assert command() == 0
    change(out / "atlas.nc", settings)
    before = (out / "atlas.nc").read_bytes()
    with pytest.raises(InputError, match=r"found another atlas in .*--replace") as refused:
        command()
    assert all(text in str(refused.value) for text in named)
    assert (out / "atlas.nc").read_bytes() == before
    assert command("--replace") == 0
    assert command() == 0  # the same may be made again


def test_failed_cells_are_told_and_set_the_exit_code(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "identifiability.study.atlas.run_atlas",
        lambda plan, folder, **_: made_up_outcomes(plan, failing=1),
    )
    monkeypatch.setattr("identifiability.plots.atlas.drawings", lambda data: ())
    config = tmp_path / "config.toml"
    config.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in SMALL.items()))
    assert run(config, "--out", tmp_path / "out") == 3
    assert "1 of 2 tasks have no result" in capsys.readouterr().err
    assert "its process" in (tmp_path / "out" / "atlas.md").read_text(encoding="utf-8")


def unlucky(cell: Cell) -> dict[str, np.ndarray]:
    with open(unlucky.calls, "a") as calls:
        calls.write("x")
    if cell.K_CE == 10:
        raise ArithmeticError("no luck")
    return made_up(cell)


def test_failed_cells_are_tried_again_where_that_is_asked_for(tmp_path, monkeypatch, capsys):
    def in_threads(plan, folder, **options):
        options["executor"] = lambda: ThreadPoolExecutor(2)
        return run_atlas(plan, folder, **options)

    unlucky.calls = tmp_path / "calls"
    monkeypatch.setattr("identifiability.study.atlas.evaluate", unlucky)
    monkeypatch.setattr("identifiability.study.atlas.run_atlas", in_threads)
    monkeypatch.setattr("identifiability.plots.atlas.drawings", lambda data: ())
    config = tmp_path / "config.toml"
    config.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in SMALL.items()))
    for option, calls in (((), 2), ((), 2), (("--retry-failed",), 3)):
        assert run(config, "--out", tmp_path / "out", *option) == 3
        assert unlucky.calls.stat().st_size == calls
        said = capsys.readouterr().err
        assert "ArithmeticError: no luck" in said
        assert "the same command with --retry-failed tries them again" in said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["--workers", "0"], "found --workers 0"), (["missing.toml"], "cannot read 'missing.toml'")],
)
def test_wrong_options_are_told_in_one_sentence(tmp_path, arguments, expected):
    with pytest.raises(InputError, match=expected):
        run(*arguments, "--out", tmp_path / "out")
