"""The stored atlas: cells computed again, and how far posterior spread tracks the Hessian."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from identifiability.provenance import code_fingerprint, read_record
from identifiability.study.atlas import Cell, evaluate

RESULTS = Path(__file__).parents[1] / "results"
AGAIN = 16  # cells
RESAMPLES = 400


@pytest.fixture(scope="module")
def stored():
    with xarray.open_dataset(RESULTS / "atlas.nc", engine="h5netcdf") as data:
        return data.load()


def cell_of(data):
    numbers = (float(data[name]) for name in ("K_CE", "B_CE", "ratio", "T"))
    return Cell(*numbers, str(data["perturbation"].values), str(data["reading"].values))


def test_a_sample_of_cells_is_computed_again(stored):
    """The same cells for the same code, others for any other."""
    status = stored["status"]
    done = np.argwhere(status.values == "done")
    assert len(done) == status.size == 27_000
    seed = int(code_fingerprint("identifiability.study.store"), 16)
    for at in done[np.random.default_rng(seed).choice(len(done), AGAIN, replace=False)]:
        kept = stored.isel(dict(zip(status.dims, at, strict=True)))
        found = evaluate(cell_of(kept))
        for name in ("optimum", "slice", "quadratic", "gauss_newton", "sandwich", "change"):
            np.testing.assert_allclose(found[name], kept[name], rtol=2e-3, atol=1e-9, err_msg=name)
        for name in ("profile_68", "profile_95"):
            # An end may lie where the profile is flat.
            size = np.abs(kept["profile_95"].values).max()
            np.testing.assert_allclose(found[name], kept[name], rtol=0.02, atol=1e-3 * size)
        np.testing.assert_allclose(found["quadrature_sd"], kept["quadrature_sd"], rtol=0.02)
        error = np.hypot(found["posterior_sd_mcse"], kept["posterior_sd_mcse"])
        assert np.all(np.abs(found["posterior_sd"] - kept["posterior_sd"].values) < 5 * error)


def tracks(stored, reading, T, predicted="quadratic"):
    """Share of cells in which each width is within a tenth of its prediction: low, value, high.

    The interval (95 %) is by resampling the musculoskeletal models, whose cells are alike.
    """
    part = stored.sel(reading=reading, T=T)
    off = np.abs(np.log(part["posterior_sd"] / part[predicted])).max("parameter", skipna=False)
    right = (off < np.log(1.1)).mean("perturbation").values.ravel()
    again = np.random.default_rng(1).choice(right, (RESAMPLES, right.size)).mean(axis=1)
    low, high = np.quantile(again, [0.025, 0.975])
    return low, right.mean(), high


# Where the spread has to track the Hessian: the noise is small, or the response lasts long.
@pytest.mark.parametrize(
    ("reading", "T", "least"),
    [
        ("energy", 0.1, 0.9),
        ("energy", 0.2, 0.9),
        ("contour", 0.2, 0.75),
    ],
)
def test_spread_tracks_the_hessian_where_it_should(stored, reading, T, least):
    assert tracks(stored, reading, T)[0] > least


# And where it cannot: a short response says too little, and bounds cut the ellipse off.
@pytest.mark.parametrize(
    ("reading", "T", "low", "high"),
    [
        ("contour", 0.05, 0.25, 0.4),
        ("contour", 0.1, 0.6, 0.8),
        ("energy", 0.05, 0.6, 0.8),
    ],
)
def test_spread_tracks_the_hessian_in_part(stored, reading, T, low, high):
    found = tracks(stored, reading, T)
    assert low < found[0] < found[2] < high


@pytest.mark.parametrize("T", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("reading", ["contour", "energy"])
def test_what_is_no_prediction_is_not_tracked(stored, reading, T):
    """The paper's largest change, over all three parameters: the control."""
    assert tracks(stored, reading, T, "change")[2] < 0.15


def test_the_shares_of_the_page_are_those_of_the_store(stored):
    rows = read_record(RESULTS / "atlas.json").record["tracking"]
    rows = [row for row in rows if row["prediction"] == "quadratic"]
    assert len(rows) == 2 * 3 * 3
    for row in rows:
        part = stored.sel(reading=row["reading"], T=row["T"], parameter=row["parameter"])
        ratio = (part["posterior_sd"] / part["quadratic"]).values
        ratio = ratio[np.isfinite(ratio)]
        share = np.mean(np.abs(np.log(ratio)) < np.log(1.1))
        assert share == pytest.approx(row["within_tenth"]["value"], abs=1e-3)
        assert row["within_tenth"]["low"] < share < row["within_tenth"]["high"]
