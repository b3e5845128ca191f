"""Kistemaker & Rozendaal (2011), computed again: oracles, the command, the committed results."""

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import xarray as xr

from identifiability.cli import paper as command
from identifiability.errors import InputError
from identifiability.measurement.perturbations import (
    PERTURBATIONS,
    DoublePulse,
    Impulse,
    Pulse,
    Sinusoid,
    Step,
)
from identifiability.provenance import read_record
from identifiability.report.markdown import number, percent
from identifiability.report.paper import PUBLISHED, page
from identifiability.study import paper
from identifiability.study.approximations import high_frequency, low_frequency
from identifiability.study.paper_record import nearest_example, relative_change
from identifiability.study.setting import Setting, error_problem

RESULTS = Path(__file__).parents[1] / "results"
needs_results = pytest.mark.skipif(
    not (RESULTS / "paper.json").exists(), reason="no committed results, as in an installed copy"
)

# K, B, I and E* of Figure 2's panels, computed independently with tight tolerances.
FIGURE2 = {
    "A": (54.98, 0.355, 0.0986, 7.0e-7),
    "B": (59.2, 0.286, 0.0990, 1.8e-6),
    "C": (38.28, 0.809, 0.0941, 2.4e-5),
    "D": (96.05, 3.051, 0.0739, 5.12e-3),
}


@pytest.mark.parametrize("panel", paper.PANELS, ids=lambda panel: panel.letter)
def test_figure_2_comes_out(panel):
    found = paper.paper_optimum(panel.setting, panel.perturbation, panel.window)
    *values, error = FIGURE2[panel.letter]
    np.testing.assert_allclose(found.values, values, rtol=5e-3)
    np.testing.assert_allclose(found.E, error, rtol=0.02)
    assert found.at_bound == ()
    assert found.n_agreeing == 4


def test_the_simplex_finds_the_same_optimum_for_the_sinusoid():
    fit = paper.panel_fit(paper.PANELS[1])
    np.testing.assert_allclose(fit.simplex, fit.optimum.values, rtol=1e-4)
    assert fit.simplex_E == pytest.approx(fit.optimum.E, rel=1e-4)


def test_the_published_sinusoid_k_lies_on_a_flat_valley():
    found = paper.valley(paper.PANELS[1], np.array([40.0, 88.0]))
    low, best, published = found.E_unbounded
    assert published - best == pytest.approx(1.4e-4, rel=0.1)
    assert found.B_unbounded[2] < 0 == found.B[2]
    # With B not below zero the valley ends sooner, but still below dE.
    assert published < found.E[2] < paper.DE
    assert low == pytest.approx(found.E[0], rel=1e-6)


def test_half_a_millisecond_moves_the_sinusoids_k_to_the_published_one():
    slips = paper.timing_slip(paper.PANELS[1])
    assert slips["MSM, unbounded"][0] == pytest.approx(88, rel=0.02)
    assert slips["MSM"][1] == 0
    assert slips["KBI"][0] < 40
    # Without a slip, which is what a hold of no length is, the optimum is back.
    none = paper.timing_slip(paper.PANELS[1], hold=0.05 / 400)
    assert none["MSM"][0] == pytest.approx(59.28, rel=0.1)


def test_table_1_is_the_expansion_of_the_impedance():
    setting = Setting(32.0, 3.2, 100.0, 0.1)

    def impedance(s):
        muscle = setting.K_CE + setting.B_CE * s
        return muscle * setting.K_SE / (muscle + setting.K_SE) + setting.I * s**2

    h = 1e-4
    slow = impedance(0.0), (impedance(h) - impedance(-h)) / (2 * h)
    np.testing.assert_allclose(low_frequency(setting), slow, rtol=1e-6)

    # Without K_CE, and K_SE small beside B_CE s, Eq. 11: Z is a polynomial in s at its true order.
    s = 1e7
    stiffness = impedance(s) - setting.I * s**2
    assert high_frequency(setting)[0] == pytest.approx(stiffness, rel=1e-3)
    # Its damping is that of muscle and tendon at the frequency of I on K_SE, for large B_CE.
    stiff = Setting(1e-6, 1e4, 100.0, 0.1)
    w = np.sqrt(stiff.K_SE / stiff.I)
    muscle = stiff.K_CE + 1j * w * stiff.B_CE
    damping = (muscle * stiff.K_SE / (muscle + stiff.K_SE)).imag / w
    assert high_frequency(stiff)[1] == pytest.approx(damping, rel=1e-4)


def _torque(perturbation):
    match perturbation:
        case Step():
            return lambda t: 1.0, ()
        case Pulse():
            return lambda t: 20.0 * (t < 0.01), (0.01,)
        case DoublePulse():
            return lambda t: 20.0 * (t < 0.01) - 20.0 * (0.01 <= t < 0.02), (0.01, 0.02)
        case Sinusoid():
            return lambda t: 20.0 * np.sin(2 * np.pi * t / 0.03), ()
    return lambda t: 0.0, ()


def _integrate(rates, start, perturbation, time):
    """Angle by an adaptive integrator, restarted where the torque jumps."""
    torque, jumps = _torque(perturbation)
    angle, state, ends = np.empty(time.size), np.array(start, float), [*jumps, time[-1]]
    begin = 0.0
    for end in ends:
        inside = (time >= begin) & (time <= end + 1e-12)
        # The torque of the interval's inside: at its very end the next one begins.
        solved = scipy.integrate.solve_ivp(
            lambda t, y, end=end: rates(y, torque(min(t, end - 1e-12))),
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
        )
        angle[inside] = solved.sol(time[inside])[0]
        state, begin = solved.y[:, -1], end
    return angle


@pytest.mark.parametrize("key", PERTURBATIONS)
def test_the_error_agrees_with_an_independent_computation(key):
    setting, perturbation, window = Setting(32.0, 10.0, 320.0, 0.1), PERTURBATIONS[key](), 0.1
    K, B, inertia = x = np.array([90.0, 2.0, 0.08])
    kick = 1.0 if isinstance(perturbation, Impulse) else 0.0
    # Fine enough for the trapezoidal rule, with the jumps on the grid.
    time = np.linspace(0.0, window, 8001)

    def joint(y, torque):
        angle, velocity, muscle = y
        stretch = setting.K_SE * (angle - muscle)
        rate = (stretch - setting.K_CE * muscle) / setting.B_CE
        return [velocity, (torque - stretch) / setting.I, rate]

    def kbi(y, torque):
        return [y[1], (torque - K * y[0] - B * y[1]) / inertia]

    reference = _integrate(joint, [0, kick / setting.I, 0], perturbation, time)
    if key == "impulse":
        # Underdamped second-order system in closed form.
        decay, w = B / (2 * inertia), np.sqrt(K / inertia - (B / (2 * inertia)) ** 2)
        response = np.exp(-decay * time) * np.sin(w * time) / (inertia * w)
    else:
        response = _integrate(kbi, [0, kick / inertia], perturbation, time)
    error = np.trapezoid((response - reference) ** 2, time) / np.trapezoid(reference**2, time)

    problem = error_problem(setting, perturbation, window)
    assert np.sum(problem.residuals(x) ** 2) == pytest.approx(error, rel=1e-5)
    assert paper.errors(problem, [x])[0] == pytest.approx(error, rel=1e-5)


def test_the_hessian_of_the_error_agrees_with_differences():
    panel = paper.PANELS[3]
    problem = error_problem(panel.setting, panel.perturbation, panel.window)
    x = np.array([96.0, 3.05, 0.074])
    h = 1e-3 * x
    steps = np.diag(h)
    plus_minus = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    points = [x + a * u + b * v for u in steps for v in steps for a, b in plus_minus]
    values = paper.errors(problem, points).reshape(3, 3, 4) @ [1, -1, -1, 1]
    differences = values / (4 * np.outer(h, h))
    np.testing.assert_allclose(2 * problem.hessian(x), differences, rtol=2e-4)


def test_eq_15_raises_the_error_by_de_where_it_is_quadratic():
    panel = paper.PANELS[3]
    small = 1e-6
    found = paper.paper_optimum(panel.setting, panel.perturbation, panel.window, dE=small)
    problem = error_problem(panel.setting, panel.perturbation, panel.window)
    points = [found.values + found.change, found.values - found.change]
    np.testing.assert_allclose(paper.errors(problem, points) - found.E, small, rtol=0.02)
    # No direction is longer than that of Eq. 15, and none reaches further than the ellipsoid.
    assert np.all(np.abs(found.change) <= found.reach * (1 + 1e-9))
    assert found.change[0] == pytest.approx(found.reach[0], rel=1e-3)


def test_an_optimum_on_a_bound_is_recorded_and_left_out():
    # A long step response without oscillation: the inertia that fits best is none.
    row = paper.Row("step", 5.0, 0.2, 160.0, (2.0, 30.0), paper.DE)
    cells = paper.compute_row(row)["cells"]
    data = paper.to_dataset({row: cells}, [160.0], [2.0, 30.0], [5.0])
    cell = data.sel(perturbation="step", ratio=5.0, T=0.2, K_CE=160.0)
    assert cell.at_bound.values.tolist() == [0, 4]
    assert float(cell.I[1]) == 0.005
    assert np.isnan(relative_change(cell, "K")).tolist() == [False, True]
    assert int(data.at_bound.sel(perturbation="impulse").max()) == -1
    assert np.isnan(data.E.sel(perturbation="impulse")).all()


def test_rows_run_on_any_executor():
    tasks = [paper.Row("impulse", 5.0, 0.05, 160.0, (2.0,), paper.DE)]
    found, failed = paper.compute_rows(tasks, folder=None, executor=lambda: ThreadPoolExecutor(1))
    assert failed == []
    np.testing.assert_array_equal(found[tasks[0]], paper.compute_row(tasks[0])["cells"])


def test_numbers_are_written_plainly():
    assert number(54.977, 4) == "54.98"
    assert number(88.0, 2) == "88"
    assert number(9.96, 2) == "10"
    assert number(-0.287, 2) == "−0.29"
    assert number(1.36e-4, 2) == "1.4 × 10⁻⁴"
    assert number(0.0, 2) == "0.0"
    assert percent(0.602) == "60 %"
    assert percent(7.564) == "756 %"


def _run(arguments):
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    options = parser.parse_args(["paper", *arguments])
    return options.run(options)


def test_a_number_of_workers_below_one_is_refused(tmp_path):
    with pytest.raises(InputError, match="--workers 0"):
        _run(["--out", str(tmp_path), "--workers", "0"])


def test_quick_from_end_to_end(tmp_path, capsys, monkeypatch):
    grid = paper.K_CE[::10], paper.B_CE[::14]
    monkeypatch.setattr(paper, "coarse", lambda: grid)
    assert _run(["--out", str(tmp_path), "--quick", "--workers", "1"]) == 0
    assert "paper.md" in capsys.readouterr().out
    assert not (tmp_path / "paper.cells").exists()

    found, remark = read_record(tmp_path / "paper.json")
    assert remark == ""
    assert found["quick"] is True
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert text == page(found)
    assert "quick run" in text
    embedded = {line.split("(")[-1][:-1] for line in text.splitlines() if line.startswith("![")}
    assert {f"paper/figure{i}.png" for i in range(2, 10)} <= embedded
    assert embedded == {f"paper/{file.name}" for file in (tmp_path / "paper").iterdir()}
    assert all((tmp_path / name).read_bytes()[:4] == b"\x89PNG" for name in embedded)

    with xr.open_dataset(tmp_path / "paper.nc", engine="h5netcdf") as data:
        assert data.K.attrs["units"] == "Nm/rad"
        assert int((data.n_agreeing < 0).sum()) == 0
        setting, window = nearest_example(data)
        assert (setting.K_CE, window) == (found["figure6"]["K_CE"], found["figure6"]["T"])
        # What a worker found is what is found here, but for the order of sums: it has one thread.
        row = paper.Row("pulse", 5.0, 0.1, float(data.K_CE[1]), (float(data.B_CE[1]),), paper.DE)
        cell = data.sel(perturbation="pulse", T=0.1, K_CE=row.K_CE, B_CE=row.B_CE[0]).squeeze()
        here = paper.compute_row(row)["cells"][0]
        stored = [float(cell[name]) for name in paper.QUANTITIES]
        np.testing.assert_allclose(here[:-2], stored, rtol=1e-7)


@needs_results
def test_the_committed_page_is_that_of_the_committed_record():
    found = read_record(RESULTS / "paper.json").record
    text = page(found)
    assert (RESULTS / "paper.md").read_text(encoding="utf-8") == text
    assert not found["quick"]
    for item in PUBLISHED:
        assert item.published in text, item.what
        assert item.ours(found) in text


@needs_results
def test_the_committed_averages_are_the_expected_ones():
    found = read_record(RESULTS / "paper.json").record["sensitivity"]
    means = {"T50": (0.602, 7.56), "T100": (0.113, 0.56), "T200": (0.062, 0.038)}
    for window, (stiffness, damping) in means.items():
        assert found[window]["cells"] == 300
        assert found[window]["dK_over_K"]["mean"] == pytest.approx(stiffness, rel=0.01)
        assert found[window]["dB_over_B"]["mean"] == pytest.approx(damping, rel=0.01)
    assert found["T50"]["dK_over_K"]["sd"] == pytest.approx(0.81, rel=0.01)
    assert found["T50"]["dB_over_B"]["sd"] == pytest.approx(24.73, rel=0.01)
    assert found["T50"]["dK_over_K"]["median"] == pytest.approx(0.288, rel=0.01)
    assert found["T50"]["dB_over_B"]["median"] == pytest.approx(0.72, rel=0.01)


@needs_results
def test_a_sample_of_the_committed_cells_is_computed_again():
    with xr.open_dataset(RESULTS / "paper.nc", engine="h5netcdf") as data:
        computed = np.argwhere(data.n_agreeing.values > 0)
        chosen = np.random.default_rng(7).choice(len(computed), 12, replace=False)
        for at in computed[chosen]:
            cell = data.isel(dict(zip(data.E.dims, at, strict=True)))
            row = paper.Row(
                str(cell.perturbation.values),
                float(cell.ratio),
                float(cell["T"]),
                float(cell.K_CE),
                (float(cell.B_CE),),
                float(data.attrs["dE"]),
            )
            stored = [float(cell[name]) for name in paper.QUANTITIES]
            found = paper.compute_row(row)["cells"][0]
            np.testing.assert_allclose(found[:-2], stored, rtol=2e-3)
