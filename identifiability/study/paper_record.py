"""The study of the paper as plain numbers: what its page, its tests and other programs read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from identifiability.provenance import stamp
from identifiability.study.approximations import high_frequency, low_frequency
from identifiability.study.paper import PARAMETERS, PanelFit, Row, Surface, Valley
from identifiability.study.setting import Setting

SCHEMA = 1
RATIO = 5.0

# K [Nm/rad] printed for the sinusoid of Figure 2B.
SINUSOID_K = 88.0
# E* of the optimum drawn in Figure 6.
FIGURE6_E = 0.002

# Upper ends of the classes in which distances from an approximation are counted.
DISTANCES = (0.1, 0.25, 0.5, 1.0)


def record(
    data: xr.Dataset,
    panels: Sequence[PanelFit],
    *,
    profile: Valley,
    slips: Mapping[str, np.ndarray],
    example: Surface,
    wider: Mapping[Row, np.ndarray],
    quick: bool,
) -> dict[str, Any]:
    """Numbers of the study, ready for JSON.

    Parameters
    ----------
    data : Dataset
        From `paper.to_dataset`.
    panels : sequence of PanelFit
    profile : Valley
        Of panel B; its K must hold `SINUSOID_K`.
    slips : mapping of str to array
        From `paper.timing_slip`, panel B.
    example : Surface
        Of Figure 6.
    wider : mapping of Row to array
        Cells of B_CE beyond the grid, an impulse and K_SE = 5 K_CE.
    quick : bool
        Whether the grid is the coarse one.

    Returns
    -------
    dict
        Relative changes are fractions, not per cent.
    """
    impulse = data.sel(perturbation="impulse", ratio=RATIO)
    return {
        "schema": SCHEMA,
        **stamp(__name__),
        "quick": quick,
        "dE": float(data.attrs["dE"]),
        "I_MSM": float(data.attrs["I_MSM"]),
        "grid": {name: data[name].values.tolist() for name in ("K_CE", "B_CE", "ratio", "T")},
        "figure2": [_panel(panel) for panel in panels],
        "valley": _valley(profile, slips),
        "figure6": {
            **vars(example.setting),
            "T": example.window,
            "E": example.optimum.E,
            **_named(example.optimum.values),
        },
        "sensitivity": {
            label(T): {
                "cells": cells.E.size,
                "dK_over_K": _statistics(relative_change(cells, "K")),
                "dB_over_B": _statistics(relative_change(cells, "B"), cells.B.values),
                "largest_dB_over_B": _statistics((cells.reach_B / cells.B).values),
            }
            for T, cells in _windows(impulse)
        },
        "sensitivity_wider": _wider(impulse, wider),
        "errors": {
            label(T): {**_quartiles(cells.E.values), "largest": float(cells.E.max())}
            for T, cells in _windows(impulse)
        },
        "ranges": _ranges(data),
        "approximations": {label(T): _distances(cells) for T, cells in _windows(impulse)},
        "perturbations": {
            label(T): {
                key: _comparison(cells.sel(perturbation=key)) for key in cells.perturbation.values
            }
            for T, cells in _windows(data.sel(ratio=RATIO))
        },
        "at_bound": _bounds(data),
        "several_minima": [
            {
                "perturbation": str(key),
                "ratio": float(ratio),
                "T": float(T),
                "cells": int(((cells.n_agreeing >= 0) & (cells.n_agreeing < 4)).sum()),
            }
            for key, ratio, T, cells in _computed(data)
            if ((cells.n_agreeing >= 0) & (cells.n_agreeing < 4)).any()
        ],
        "fits": int((data.n_agreeing >= 0).sum()),
    }


def relative_change(cells: xr.Dataset, name: str) -> np.ndarray:
    """|dK|/K or |dB|/B of Eq. 15 as a fraction; NaN for an optimum on a bound, where E slopes."""
    change = np.abs(cells[f"d{name}"].values)
    inside = cells.at_bound.values == 0
    return np.where(inside, change, np.nan) / np.where(inside, cells[name].values, 1.0)


def nearest_example(data: xr.Dataset) -> tuple[Setting, float]:
    """Find the setting and window of the impulse grid whose E* is nearest to that of Figure 6."""
    errors = data.E.sel(perturbation="impulse", ratio=RATIO)
    at = np.unravel_index(np.argmin(np.abs(np.log(errors.values / FIGURE6_E))), errors.shape)
    cell = errors[at]
    stiffness = float(cell.K_CE)
    setting = Setting(stiffness, float(cell.B_CE), RATIO * stiffness, float(data.attrs["I_MSM"]))
    return setting, float(cell["T"])


def label(window: float) -> str:
    """Key of a window: ``"T50"`` for 0.05 s."""
    return f"T{1000 * window:.0f}"


def _windows(data: xr.Dataset) -> list[tuple[float, xr.Dataset]]:
    return [(float(T), data.sel(T=T)) for T in data["T"].values]


def _computed(data: xr.Dataset) -> list[tuple[str, float, float, xr.Dataset]]:
    """Every computed combination of perturbation, ratio and window, with its cells."""
    return [
        (key, ratio, T, cells)
        for key in data.perturbation.values
        for ratio in data.ratio.values
        for T, cells in _windows(data.sel(perturbation=key, ratio=ratio))
        if (cells.n_agreeing >= 0).any()
    ]


def _named(values: np.ndarray, prefix: str = "") -> dict[str, float]:
    return {prefix + name: float(v) for name, v in zip(PARAMETERS, values, strict=True)}


def _panel(fit: PanelFit) -> dict[str, Any]:
    return {
        "panel": fit.panel.letter,
        "setting": vars(fit.panel.setting),
        "perturbation": fit.panel.perturbation.key,
        "T": fit.panel.window,
        **_named(fit.optimum.values),
        "E": fit.optimum.E,
        **_named(fit.optimum.change, "d"),
        "at_bound": list(fit.optimum.at_bound),
        "E_plus": float(fit.changed_E[0]),
        "E_minus": float(fit.changed_E[1]),
        "simplex": {**_named(fit.simplex), "E": fit.simplex_E},
    }


def _valley(profile: Valley, slips: Mapping[str, np.ndarray]) -> dict[str, Any]:
    at = int(np.flatnonzero(profile.K == SINUSOID_K)[0])
    return {
        "K": SINUSOID_K,
        "E": float(profile.E[at]),
        "B": float(profile.B[at]),
        "E_unbounded": float(profile.E_unbounded[at]),
        "B_unbounded": float(profile.B_unbounded[at]),
        "timing_slip": {name: _named(values) for name, values in slips.items()},
    }


def _quartiles(values: np.ndarray) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if values.size == 0:
        return {"q25": None, "median": None, "q75": None}
    q25, median, q75 = np.quantile(values, [0.25, 0.5, 0.75])
    return {"q25": float(q25), "median": float(median), "q75": float(q75)}


def _statistics(values: np.ndarray, fitted: np.ndarray | None = None) -> dict[str, float | None]:
    """Mean, spread, and how few cells carry half of the sum (and the largest B among them)."""
    finite = np.isfinite(values)
    kept = values[finite]
    order = np.argsort(kept)[::-1]
    half = int(np.searchsorted(np.cumsum(kept[order]), 0.5 * kept.sum())) + 1
    out: dict[str, float | None] = {
        "mean": float(kept.mean()),
        "sd": float(kept.std(ddof=1)),
        **_quartiles(kept),
        "largest": float(kept.max()),
        "cells": int(kept.size),
        "cells_with_half_the_sum": half,
    }
    if fitted is not None:
        out["largest_B_of_these"] = float(fitted[finite][order[:half]].max())
    return out


def _wider(impulse: xr.Dataset, wider: Mapping[Row, np.ndarray]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for T, cells in _windows(impulse):
        extra = np.concatenate([values for row, values in wider.items() if row.window == T])
        out[label(T)] = {}
        for name in ("K", "B"):
            i = 1 + PARAMETERS.index(name)
            beyond = np.abs(extra[:, i + 3] / extra[:, i])
            both = np.concatenate([relative_change(cells, name).ravel(), beyond])
            out[label(T)][f"d{name}_over_{name}"] = _statistics(both)
    out["B_CE"] = max(max(row.B_CE) for row in wider)
    return out


def _ranges(data: xr.Dataset) -> list[dict[str, float]]:
    """Extremes of K / K_CE, and how much B changes with K_CE alone."""
    out = []
    for key, ratio, T, cells in _computed(data):
        if key == "impulse":
            relative = cells.K / cells.K_CE
            fold = cells.B.max("K_CE") / cells.B.min("K_CE")
            out.append(
                {
                    "ratio": float(ratio),
                    "T": T,
                    "K_over_K_CE_smallest": float(relative.min()),
                    "K_over_K_CE_largest": float(relative.max()),
                    "B_fold_change_largest": float(fold.max()),
                }
            )
    return out


def approximations(cells: xr.Dataset) -> dict[str, xr.Dataset]:
    """Low- and high-frequency K and B (Table 1) of every cell, K_SE = 5 K_CE."""
    stiffness, damping = xr.broadcast(cells.K_CE, cells.B_CE)
    pairs = {}
    for name, approximation in (("LF", low_frequency), ("HF", high_frequency)):
        values = np.array(
            [
                approximation(Setting(k, b, RATIO * k, float(cells.attrs["I_MSM"])))
                for k, b in zip(stiffness.values.ravel(), damping.values.ravel(), strict=True)
            ]
        )
        pairs[name] = xr.Dataset(
            {
                "K": (stiffness.dims, values[:, 0].reshape(stiffness.shape)),
                "B": (stiffness.dims, values[:, 1].reshape(stiffness.shape)),
            },
            stiffness.coords,
        )
    return pairs


def _distances(cells: xr.Dataset) -> dict[str, Any]:
    """Count cells by the relative distance to the nearest approximation of Table 1."""
    pairs = approximations(cells)
    away = {
        name: [abs(cells[name] / pair[name] - 1).values for pair in pairs.values()]
        for name in ("K", "B")
    }
    nearest = {
        "K": np.minimum(*away["K"]),
        "B": np.minimum(*away["B"]),
        "K_and_B": np.minimum(*(np.maximum(k, b) for k, b in zip(*away.values(), strict=True))),
        "K_to_K_CE": abs(cells.K / cells.K_CE - 1).values,
        "B_to_B_CE": abs(cells.B / cells.B_CE - 1).values,
    }
    edges = [0.0, *DISTANCES, np.inf]
    low, high = pairs["LF"], pairs["HF"]
    between = {
        name: (cells[name] >= np.minimum(low[name], high[name]))
        & (cells[name] <= np.maximum(low[name], high[name]))
        for name in ("K", "B")
    }
    return {
        **{name: np.histogram(values, edges)[0].tolist() for name, values in nearest.items()},
        "K_between": int(between["K"].sum()),
        "B_between": int(between["B"].sum()),
        "both_between": int((between["K"] & between["B"]).sum()),
        "B_below": int((np.minimum(low.B, high.B) > cells.B).sum()),
        "cells": int(cells.E.size),
    }


def _comparison(cells: xr.Dataset) -> dict[str, Any]:
    low = approximations(cells)["LF"]
    return {
        "E": _quartiles(cells.E.values),
        "K_over_K_LF": _quartiles((cells.K / low.K).values),
        "B_over_B_LF": _quartiles((cells.B / low.B).values),
        "I_over_I_MSM": _quartiles(cells.I.values / cells.attrs["I_MSM"]),
        "dK_over_K": _quartiles(relative_change(cells, "K")),
        "dB_over_B": _quartiles(relative_change(cells, "B")),
        "cells": int(cells.E.size),
        "cells_at_bound": int((cells.at_bound > 0).sum()),
    }


def _bounds(data: xr.Dataset) -> list[dict[str, Any]]:
    return [
        {
            "perturbation": str(key),
            "ratio": float(ratio),
            "T": float(T),
            "parameter": name,
            "cells": int((cells.at_bound.values & (1 << i) > 0)[cells.at_bound.values > 0].sum()),
        }
        for key, ratio, T, cells in _computed(data)
        for i, name in enumerate(PARAMETERS)
        if ((cells.at_bound.values > 0) & (cells.at_bound.values & (1 << i) > 0)).any()
    ]
