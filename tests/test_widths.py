"""Widths side by side: when the quadratic one holds, when it does not, and what is said then."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from cases import SPREAD, A, Case, fit_of, problem_of, widths_of
from matplotlib.patches import Rectangle

from identifiability.inference.archive import to_datatree, write_netcdf
from identifiability.inference.curvature import curvature
from identifiability.inference.sampling import Posterior, sample
from identifiability.inference.widths import VERDICTS, judge, widths
from identifiability.investigation.wording.values import width_in_words
from identifiability.plots.corner import corner_figure
from identifiability.provenance import package_version

AGREEING = [case for case, verdicts in SPREAD.items() if verdicts == (A, A, A)]
DEPARTING = [case for case in SPREAD if case not in AGREEING]
TRUNCATED = Case(32, 3.2, 100, 0.05)


def test_the_spread_is_one():
    assert len(SPREAD) >= 8
    assert {case.reading for case in SPREAD} == {"contour", "energy"}
    assert len({case.window for case in SPREAD}) >= 3
    assert len({case.setting for case in SPREAD}) >= 6
    assert len(AGREEING) >= 4
    assert len(DEPARTING) >= 4


@pytest.mark.parametrize("case", SPREAD, ids=str)
def test_verdicts(case):
    result = widths_of(case)
    assert tuple(row.verdict for row in result.rows) == SPREAD[case]
    assert result.verdict == max(SPREAD[case], key=VERDICTS.index)
    assert result.reason == next(r.reason for r in result.rows if r.verdict == result.verdict)
    assert all(row.name in row.reason for row in result.rows)


@pytest.mark.parametrize("case", AGREEING, ids=str)
def test_posterior_tracks_the_hessian_where_it_agrees(case):
    result = widths_of(case)
    predicted = np.sqrt(np.diag(curvature(problem_of(case), fit_of(case).values).covariance))
    for row, quadratic in zip(result.rows, predicted, strict=True):
        assert row.quadratic == pytest.approx(quadratic, rel=1e-9)
        assert row.posterior_sd_mcse < 0.01 * quadratic
        assert abs(row.posterior_sd - quadratic) < 4 * row.posterior_sd_mcse
        assert row.quadrature_sd == pytest.approx(quadratic, rel=5e-3)
        assert row.profile == pytest.approx(quadratic, rel=1e-2)
        assert row.slice < quadratic


@pytest.mark.parametrize("case", DEPARTING, ids=str)
def test_posterior_departs_from_the_hessian_where_it_says_so(case):
    for row in widths_of(case).rows:
        assert row.verdict != A
        assert abs(row.posterior_sd - row.quadratic) > 4 * row.posterior_sd_mcse
        # It is the posterior that departs, not the sampler.
        assert abs(row.posterior_sd - row.quadrature_sd) < 4 * row.posterior_sd_mcse


@pytest.mark.parametrize("case", [AGREEING[0], TRUNCATED], ids=str)
def test_a_corner_plot_shows_the_bound_that_cuts_the_posterior(case):
    result = widths_of(case)
    figure = corner_figure(result, problem_of(case))
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    names = [f"{row.name}: {width_in_words(row.verdict)}" for row in result.rows]
    assert said[-3:] == names
    assert ("beyond a bound" in said) == (case is TRUNCATED)
    shaded = [p for axes in figure.axes for p in axes.patches if isinstance(p, Rectangle)]
    ends = [p.get_x() + p.get_width() for p in shaded if p.get_height() == 1]
    assert all(end == pytest.approx(0) for end in ends)  # neither K nor B is below 0
    assert (len(ends) >= 5) == (case is TRUNCATED)


def test_a_wrong_hessian_would_be_noticed():
    # The Gauss-Newton matrix in the Hessian's place, where the model cannot fit.
    result = widths_of(Case(100, 16, 500, 0.2, "energy"))
    for row in result.rows:
        assert abs(row.posterior_sd - row.gauss_newton) > 20 * row.posterior_sd_mcse


def test_one_row_for_each_matrix():
    case = Case(100, 16, 500, 0.2, "energy")
    result, shape = widths_of(case), curvature(problem_of(case), fit_of(case).values)
    for i, row in enumerate(result.rows):
        assert row.gauss_newton == pytest.approx(np.linalg.inv(shape.gauss_newton)[i, i] ** 0.5)
        inverse = np.linalg.inv(shape.hessian)
        sandwich = inverse @ shape.gauss_newton @ inverse
        assert row.sandwich == pytest.approx(sandwich[i, i] ** 0.5)
        assert row.slice == pytest.approx(shape.hessian[i, i] ** -0.5)


def test_which_matrix_matters_when_the_model_cannot_fit():
    """K_CE 100, B_CE 16, K_SE 500, 200 ms, contour: sd of K 9.5, Gauss-Newton 6.4."""
    row = widths_of(Case(100, 16, 500, 0.2))["K"]
    assert row.posterior_sd == pytest.approx(9.5, abs=0.25)
    assert row.gauss_newton == pytest.approx(6.4, abs=0.1)
    assert row.quadratic == pytest.approx(9.2, abs=0.1)


def test_bounds_matter_as_much_as_curvature():
    """K_CE 32, B_CE 3.2, K_SE 100, 50 ms: sd of K 23 with the bounds, 175 without, Hessian 132."""
    bounded = widths_of(TRUNCATED)["K"]
    unbounded = widths_of(Case(32, 3.2, 100, 0.05, bounded=False))["K"]
    assert bounded.quadratic == pytest.approx(132, abs=2)
    assert unbounded.quadratic == pytest.approx(132, abs=2)
    assert bounded.posterior_sd == pytest.approx(23.4, abs=0.5)
    assert unbounded.quadrature_sd == pytest.approx(175, abs=2)
    assert unbounded.verdict in {"curved", "heavy-tailed"}


def test_the_quadratic_width_becomes_exact_as_noise_falls():
    gaps = []
    for dE in (1e-3, 1e-4, 1e-6):
        result = widths_of(Case(50, 5, 250, 0.1, "contour", dE=dE))
        gaps.append(max(abs(row.quadrature_sd / row.quadratic - 1) for row in result.rows))
    assert gaps[0] > 0.03
    assert gaps[1] < 0.3 * gaps[0]
    assert gaps[2] < 2e-3


def test_the_same_seed_gives_the_same_widths():
    case = Case(32, 3.2, 100, 0.1, "energy")
    again = widths(
        problem_of(case), starts=case.setting.starts(), seed=widths_of(case).posterior.seed
    )
    assert again.to_dict() == widths_of(case).to_dict()


def test_without_the_referee():
    case = Case(32, 3.2, 100, 0.1, "energy")
    result = widths(problem_of(case), starts=case.setting.starts(), seed=1, referee=False)
    assert result.moments is None
    assert np.isnan(result["K"].quadrature_sd)
    record = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert record["quadrature"] is None
    assert record["parameters"]["K"]["quadrature_sd"] is None
    assert "quadrature" not in to_datatree(problem_of(case), result).children


def gaussian(problem, optimum, /, *, seed, local_optima, quick):
    """Exact draws of the Gaussian about the optimum: a sampler that is not ours."""
    factor = np.linalg.cholesky(curvature(problem, optimum).covariance)
    shape = (4, 64, 10, len(optimum))
    draws = optimum + np.random.default_rng(seed).standard_normal(shape) @ factor.T
    return Posterior.judged(
        problem.names,
        draws,
        np.zeros(shape[:-1]),
        independent=True,
        step="Gaussian",
        reason=f"quick: {quick}, {len(local_optima)} optima",
        acceptance=1.0,
        seed=seed,
    )


def test_the_sampler_is_an_argument():
    case = Case(32, 3.2, 100, 0.1, "energy")
    result = widths(
        problem_of(case), starts=case.setting.starts(), seed=3, referee=False, sampler=gaussian
    )
    assert result.posterior.step == "Gaussian"
    assert result.posterior.reason == f"quick: False, {len(case.setting.starts())} optima"
    assert result.to_dict()["sampler"]["step"] == "Gaussian"
    assert result.to_dict()["sampler"]["seed"] == 3
    assert result.verdict == "agrees"


def test_a_sampler_that_did_not_converge_gives_no_verdict():
    case = Case(32, 3.2, 100, 0.1, "energy")

    def hasty(*args, **options):
        return replace(sample(*args, **options), unmet=("nested R-hat of K is 1.300",))

    result = widths(
        problem_of(case), starts=case.setting.starts(), seed=1, referee=False, sampler=hasty
    )
    assert result.verdict == "not converged"
    record = result.to_dict()
    assert record["sampler"]["converged"] is False
    assert record["sampler"]["unmet"] == ["nested R-hat of K is 1.300"]
    assert all("nested R-hat of K is 1.300" in row.reason for row in result.rows)


def test_a_better_point_on_a_profile_is_taken_up():
    """A fit from one start ends in the worse of two optima; a profile passes by the better one."""
    case = Case(100, 30, 1000, 0.2)
    found = fit_of(case)
    worse = found.reached[np.argmax(np.abs(found.reached[:, 0] - found.values[0]))]
    options = {"seed": 1, "referee": False, "sampler": gaussian}
    result = widths(problem_of(case), starts=worse[None], **options)
    assert len(result.taken_up) == 1
    assert result.taken_up[0] in result.names
    assert result.to_dict()["optimum"]["taken_up"] == list(result.taken_up)
    assert result.fit.cost == pytest.approx(found.cost, rel=1e-6)
    assert not any(path.improved for path in result.profiles)
    # The control: from the best optimum there is nothing to take up.
    assert widths(problem_of(case), starts=found.values[None], **options).taken_up == ()


# The judge, on constructed inputs: a Gaussian of sd 1 about 0, then one thing changed at a time

GAUSSIAN = {
    "name": "K",
    "optimum": 0.0,
    "quadratic": 1.0,
    "posterior_sd": 1.0,
    "posterior_68": (-1.0, 1.0),
    "posterior_95": (-1.96, 1.96),
    "sides": ("closed", "closed"),
    "bounds": (-5.0, 7.0),
    "pinned": (),
    "at_bound": (),
    "unmet": (),
}
WIDE = {"posterior_sd": 2.0, "posterior_68": (-2.0, 2.0), "posterior_95": (-3.92, 3.92)}
JUDGED = [
    ({}, "agrees", "lies where a Gaussian's would"),
    ({"posterior_sd": 1.09}, "agrees", "1.09 times"),
    ({"posterior_95": (-1.96, 2.2)}, "agrees", "1.00 times"),
    # What a parameter's neighbours do is no reason where the width is right.
    ({"pinned": ("B",), "at_bound": ("I",), "sides": ("bound", "closed")}, "agrees", ""),
    ({"posterior_sd": 1.11}, "curved", "is not quadratic"),
    ({"posterior_sd": 0.89}, "curved", "0.89 times"),
    ({"posterior_95": (-1.96, 2.22)}, "curved", "is shifted"),
    (WIDE, "curved", "2.00 times"),
    (WIDE | {"posterior_95": (-4.6, 4.6)}, "heavy-tailed", "2.30 times its 68 % one"),
    (WIDE | {"posterior_95": (-4.2, 4.2)}, "curved", ""),
    (WIDE | {"sides": ("bound", "closed")}, "truncated", "the bound K >= -5 cuts"),
    (WIDE | {"sides": ("closed", "bound")}, "truncated", "the bound K <= 7 cuts"),
    (WIDE | {"pinned": ("B", "I")}, "truncated", "B and I"),
    (WIDE | {"at_bound": ("B",)}, "truncated", "the optimum lies on a bound of B"),
    # Its own bound at the optimum is the sides' business.
    (WIDE | {"at_bound": ("K",)}, "curved", ""),
    (WIDE | {"pinned": ("B",), "posterior_95": (-4.6, 4.6)}, "truncated", ""),
    (WIDE | {"sides": ("bound", "bound")}, "non-identifiable", "neither below nor above"),
    (WIDE | {"sides": ("open", "bound")}, "non-identifiable", "neither below nor above"),
    (WIDE | {"sides": ("open", "closed")}, "non-identifiable", "do not bound K below"),
    (WIDE | {"sides": ("closed", "open")}, "non-identifiable", "do not bound K above"),
    ({"quadratic": float("nan")}, "curved", "the Hessian gives no width for K"),
    ({"quadratic": float("nan"), "sides": ("open", "open")}, "non-identifiable", "no width"),
    ({"unmet": ("nested R-hat of K is 1.3",)}, "not converged", "nested R-hat of K is 1.3"),
]


@pytest.mark.parametrize(("change", "verdict", "words"), JUDGED)
def test_judge(change, verdict, words):
    found, reason = judge(**(GAUSSIAN | change))
    assert found == verdict
    assert words in reason


def test_every_verdict_is_reached():
    assert {verdict for _, verdict, _ in JUDGED} == set(VERDICTS)


# Records

KEYS = {
    "slice",
    "quadratic",
    "profile",
    "posterior_sd",
    "posterior_mean",
    "quadrature_sd",
    "rhat",
    "rhat_nested",
    "ess_bulk",
    "ess_tail",
    "verdict",
    "reason",
}


@pytest.mark.parametrize("case", SPREAD, ids=str)
def test_record_is_json(case):
    result = widths_of(case)
    record = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert record["verdict"] == result.verdict
    assert record["reason"] == result.reason
    assert list(record["parameters"]) == ["K", "B", "I"]
    for row in result.rows:
        entry = record["parameters"][row.name]
        assert set(entry) >= KEYS
        assert entry["posterior_sd"] == row.posterior_sd
        assert entry["unit"]
        for key in KEYS - {"verdict", "reason"}:
            assert np.isfinite(entry[key])
    assert record["sampler"]["converged"] is True
    assert record["sampler"]["seed"] == result.posterior.seed
    assert record["optimum"]["starts_agreeing"] <= record["optimum"]["starts"]
    assert record["quadrature"]["log_evidence"] == result.moments.log_evidence


def test_an_endless_interval_is_json_too():
    result = widths_of(Case(32, 3.2, 100, 0.05, bounded=False))
    json.dumps(result.to_dict(), allow_nan=False)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("archive") / "below" / "widths.nc"
    write_netcdf(problem_of(TRUNCATED), widths_of(TRUNCATED), path)
    assert [p.name for p in path.parent.iterdir()] == ["widths.nc"]
    return path


def test_archive_is_read_by_xarray(archive):
    result = widths_of(TRUNCATED)
    with xarray.open_datatree(archive, engine="h5netcdf") as tree:
        for i, row in enumerate(result.rows):
            draws = tree["posterior"][row.name]
            assert draws.dims == ("chain", "draw")
            assert draws.attrs["units"] == row.unit
            assert np.array_equal(draws.values, result.posterior.draws[:, :, i])
        assert np.array_equal(tree["sample_stats/lp"].values, result.posterior.log_probability)
        assert np.array_equal(tree["laplace/hessian"].values, result.curvature.hessian)
        value = tree["optimum/value"].sel(parameter="B")
        assert float(value) == result["B"].optimum
        assert float(tree["quadrature/sd"].sel(parameter="K")) == result["K"].quadrature_sd
        measured = problem_of(TRUNCATED).observations[0].measured
        assert np.array_equal(tree["observed_data/response_0"].values, measured)
        profile = result.profiles[1]
        assert np.array_equal(tree["profile/B_value"].values, profile.values)
        assert np.array_equal(tree["profile/B_drop"].values, profile.drops)
        assert tree.attrs["verdict"] == result.verdict
        assert tree.attrs["reason"] == result.reason
        assert tree.attrs["model"] == "KBI()"
        assert tree.attrs["seed"] == result.posterior.seed
        assert package_version() in tree.attrs["package"]


def test_archive_is_read_by_arviz(archive):
    import arviz

    data = arviz.from_netcdf(archive)
    result = widths_of(TRUNCATED)
    summary = arviz.summary(data, var_names=["K", "B", "I"], round_to="none")
    for row in result.rows:
        assert float(summary.loc[row.name, "mean"]) == pytest.approx(row.posterior_mean)
        assert float(summary.loc[row.name, "sd"]) == pytest.approx(row.posterior_sd, rel=1e-3)
        assert float(summary.loc[row.name, "r_hat"]) == pytest.approx(row.rhat, abs=1e-6)
        assert float(summary.loc[row.name, "ess_bulk"]) == pytest.approx(row.ess_bulk, rel=1e-6)
