"""Whether posterior spread follows what was predicted for it, over the cells of an atlas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from identifiability.study.approximations import high_frequency, low_frequency
from identifiability.study.setting import Setting

PREDICTIONS = ("quadratic", "change")
"""Fields that predict the posterior's spread: the quadratic width, and the paper's Eq. 15."""

TOLERANCES = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1.0)
_RESAMPLES, _SEED = 1000, 1
_NOTHING = 1e-6  # an optimum that is on its bound
_MODEL = ("K_CE", "B_CE", "ratio")

Record = dict[str, Any]


def tracking(part: xr.Dataset, predicted: str) -> Record:
    """How closely one parameter's posterior sd follows a prediction.

    Parameters
    ----------
    part : Dataset
        Finished cells, along ``cell``, of one parameter.
    predicted : str
        One of `PREDICTIONS`.

    Returns
    -------
    dict
        Number of cells, of those with a prediction; correlation and slope of the logarithms, median
        ratio, and the share within a tenth and within a factor of two, each but the number with a
        95 % interval: by resampling the musculoskeletal models, as cells of one are alike.
    """
    x, y = part[predicted].values, part["posterior_sd"].values
    usable = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    found: Record = {"of": int(usable.size), "predicted": int(usable.sum())}
    if usable.sum() < 3:
        return found
    x, y = np.log(x[usable]), np.log(y[usable])
    models = np.array([part[name].values[usable] for name in _MODEL])
    which = np.unique(models, axis=1, return_inverse=True)[1].ravel()
    off = np.abs(y - x) * (1 - 1e-6)  # stored in single precision
    columns = np.array(
        [np.ones_like(x), x, y, x * x, y * y, x * y, off <= np.log(1.1), off <= np.log(2.0)]
    )
    # Everything asked follows from these sums, so that a resample is one product.
    sums = np.array([np.bincount(which, column) for column in columns])
    n_models = sums.shape[1]
    random = np.random.default_rng(_SEED)
    counts = random.multinomial(n_models, np.full(n_models, 1 / n_models), _RESAMPLES)
    whole, again = _figures(sums.sum(axis=1)), _figures(sums @ counts.T)
    for name, value in whole.items():
        some = again[name][np.isfinite(again[name])]
        if not (np.isfinite(value) and some.size):
            found[name] = None  # predictions that are all the same have no slope
            continue
        low, high = np.quantile(some, [0.025, 0.975])
        found[name] = {"value": float(value), "low": float(low), "high": float(high)}
    found["ratio"] = float(np.exp(np.median(y - x)))
    return found


def _figures(sums: np.ndarray) -> dict[str, np.ndarray]:
    n, x, y, xx, yy, xy, tenth, twice = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        var_x, var_y, both = xx / n - (x / n) ** 2, yy / n - (y / n) ** 2, xy / n - x * y / n**2
        return {
            "correlation": both / np.sqrt(var_x * var_y),
            "slope": both / var_x,
            "within_tenth": tenth / n,
            "within_twice": twice / n,
        }


def within(part: xr.Dataset) -> list[Record]:
    """Share of cells in which no width is off by more than each of the tolerances."""
    off = abs(part["posterior_sd"] / part["quadratic"] - 1).max("parameter", skipna=False).values
    off = np.where(np.isfinite(off), off, np.inf)
    return [{"tolerance": t, "share": float(np.mean(off <= t))} for t in TOLERANCES]


def relative(part: xr.Dataset) -> Record:
    """Mean uncertainty of K and B as a share of their size, by Eq. 15 and by the posterior.

    Parameters
    ----------
    part : Dataset
        Finished cells, along ``cell``.

    Returns
    -------
    dict
        By parameter and field, mean and standard deviation over the cells whose parameter is not 0,
        the posterior's as a share of its mean; and how many those are.
    """
    found: Record = {"of": part.sizes["cell"]}
    for name in ("K", "B"):
        one = part.sel(parameter=name)
        shares = {
            "change": (one["change"] / one["optimum"]).values,
            "posterior": (one["posterior_sd"] / one["posterior_mean"]).values,
        }
        usable = np.all([np.isfinite(s) for s in shares.values()], axis=0)
        usable &= one["optimum"].values > _NOTHING
        found[name] = {"of": int(usable.sum())} | {
            key: {"mean": float(s[usable].mean()), "sd": float(s[usable].std())}
            for key, s in shares.items()
            if usable.any()
        }
    return found


def structural(part: xr.Dataset) -> Record:
    """How far the fitted K is from any stiffness of the joint, and from that in posterior sds.

    Parameters
    ----------
    part : Dataset
        Finished cells, along ``cell``.
    """
    values = {name: part[name].values for name in _MODEL}
    settings = [
        Setting(k, b, r * k) for k, b, r in zip(*(values[name] for name in _MODEL), strict=True)
    ]
    truths: Mapping[str, np.ndarray] = {
        "K_CE": values["K_CE"],
        "slow": np.array([low_frequency(s)[0] for s in settings]),
        "fast": np.array([high_frequency(s)[0] for s in settings]),
    }
    fitted = part.sel(parameter="K")
    optimum, sd = fitted["optimum"].values, fitted["posterior_sd"].values
    found: Record = {"of": int(optimum.size)}
    for name, truth in truths.items():
        off, sds = optimum / truth - 1, np.abs(optimum - truth) / sd
        found[name] = {
            **{f"q{round(100 * q)}": float(np.quantile(off, q)) for q in (0.05, 0.5, 0.95)},
            "sds": float(np.median(sds)),
            "beyond_two_sd": float(np.mean(sds > 2)),
        }
    return found
