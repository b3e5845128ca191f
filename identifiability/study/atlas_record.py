"""The atlas summarised as plain numbers: what its page, its tests and other programs read."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.stats
import xarray as xr

from identifiability.inference.convergence import ESS_LIMIT, RHAT_LIMIT
from identifiability.inference.curvature import NORMAL_95
from identifiability.inference.widths import (
    END_TOLERANCE,
    HEAVY_TAIL,
    VERDICTS,
    WIDTH_TOLERANCE,
)
from identifiability.joint.model import KBI
from identifiability.provenance import stamp
from identifiability.study.store import CELL
from identifiability.study.tracking import PREDICTIONS, relative, structural, tracking, within

SCHEMA = 2
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
# Classes of the optimum's distance from the nearest lower bound, in quadratic widths.
DISTANCES = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 15.0, np.inf)

# From this distance on, an optimum counts as lying away from impossible values.
AWAY = 2.0
# Monte Carlo errors beyond which sampled and integrated widths do not differ by chance.
DISAGREEMENT = 5.0

Record = dict[str, Any]


def record(
    data: xr.Dataset,
    *,
    command: str,
    figures: Sequence[Mapping[str, str]] = (),
    corners: Sequence[Mapping[str, str]] = (),
) -> Record:
    """Numbers of the atlas, ready for JSON.

    Parameters
    ----------
    data : Dataset
        From `store.to_dataset`.
    command : str
        What was typed to make it.
    figures, corners : sequence of mapping
        Figures that belong to it, each with ``file``, relative to the page, and ``caption``; a
        corner plot also with ``verdict`` and ``reason``.

    Returns
    -------
    dict
        Every group counts finished cells only.
    """
    cells = data.stack(cell=CELL)
    done = cells.isel(cell=np.flatnonzero(cells["status"].values == "done"))

    def groups(*axes: str) -> list[tuple[Record, xr.Dataset]]:
        """Parts of the finished cells that are not empty, in the order of the grid."""
        parts: list[tuple[Record, xr.Dataset]] = [({}, done)]
        for axis in axes:
            parts = [
                ({**place, axis: value}, _at(part, axis, value))
                for place, part in parts
                for value in data[axis].values.tolist()
            ]
        return [(place, part) for place, part in parts if part.sizes["cell"]]

    return {
        "schema": SCHEMA,
        **stamp(__name__),
        "command": command,
        "plan": json.loads(data.attrs["plan"]),
        "criteria": {
            "width_tolerance": WIDTH_TOLERANCE,
            "end_tolerance": END_TOLERANCE,
            "heavy_tail": HEAVY_TAIL,
            "rhat_limit": RHAT_LIMIT,
            "ess_limit": ESS_LIMIT,
        },
        "cells": {
            "total": cells.sizes["cell"],
            "done": done.sizes["cell"],
            "failed": _failed(cells),
            "seconds": _quantiles(done["seconds"].values),
        },
        "verdicts": [{**place, **_counts(part)} for place, part in groups("reading", "T")],
        "along": {
            axis: [{**place, **_counts(part)} for place, part in groups("reading", axis)]
            for axis in ("perturbation", "ratio", "K_CE", "B_CE")
        },
        "ratios": [
            {**place, **_ratios(part)} for place, part in groups("reading", "T", "parameter")
        ],
        "bounds": [{**place, **_bounds(part)} for place, part in groups("reading")],
        "causes": [
            {**place, "verdict": verdict, **_causes(part.isel(cell=chosen))}
            for place, part in groups("reading")
            for verdict in VERDICTS
            if (chosen := np.flatnonzero(part["verdict"].values == verdict)).size
        ],
        "distances": [
            {**place, "classes": _distance_classes(part)} for place, part in groups("reading")
        ],
        "associations": [
            {**place, **_associations(part, least)}
            for place, part in groups("reading")
            for least in (0.0, AWAY)
        ],
        "tracking": [
            {**place, "prediction": prediction, **tracking(part, prediction)}
            for place, part in groups("reading", "T", "parameter")
            for prediction in PREDICTIONS
        ],
        "tolerances": [{**place, "within": within(part)} for place, part in groups("reading", "T")],
        "relative": [{**place, **relative(part)} for place, part in groups("reading", "T")],
        "structural": [{**place, **structural(part)} for place, part in groups("reading", "T")],
        "sampler": _sampler(done),
        "referee": _referee(done),
        "figures": [dict(figure) for figure in figures],
        "corners": [dict(corner) for corner in corners],
    }


def _at(part: xr.Dataset, axis: str, value: float | str) -> xr.Dataset:
    if axis == "parameter":
        return part.sel(parameter=value)
    return part.isel(cell=np.flatnonzero(part[axis].values == value))


def _counts(part: xr.Dataset) -> Record:
    verdicts = part["verdict"].values.tolist()
    found = {v: verdicts.count(v) for v in VERDICTS}
    off = abs(part["posterior_sd"] / part["quadratic"] - 1).max("parameter", skipna=False)
    return {
        "of": len(verdicts),
        "counts": {v: n for v, n in found.items() if n},
        "width_alone": int(np.sum(off.values <= WIDTH_TOLERANCE)),
    }


def _failed(cells: xr.Dataset) -> list[Record]:
    found = []
    for i in np.flatnonzero(cells["status"].values != "done"):
        cell = cells.isel(cell=i)
        place = {name: cell[name].item() for name in CELL}
        found.append({**place, "status": cell["status"].item(), "cause": cell["cause"].item()})
    return found


def _quantiles(values: np.ndarray) -> Record:
    """Quantiles and ends of what is finite, and how many are."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"of": int(values.size), "finite": 0}
    found = {f"q{round(100 * q)}": float(np.quantile(finite, q)) for q in QUANTILES}
    return {
        "of": int(values.size),
        "finite": int(finite.size),
        "smallest": float(finite.min()),
        **found,
        "largest": float(finite.max()),
    }


def _ratios(part: xr.Dataset) -> Record:
    return _quantiles((part["posterior_sd"] / part["quadratic"]).values)


def _bounds(part: xr.Dataset) -> Record:
    """In how many truncated cells which bound ends a 95 % profile interval."""
    truncated = part.isel(cell=np.flatnonzero(part["verdict"].values == "truncated"))
    counts = {}
    for name, parameter in KBI().parameters.items():
        for side, value in (("lower", parameter.lower), ("upper", parameter.upper)):
            ends = truncated["profile_end"].sel(parameter=name, side=side).values
            sign = ">=" if side == "lower" else "<="
            counts[f"{name} {sign} {value:g}"] = int(np.sum(ends == "bound"))
    return {"of": truncated.sizes["cell"], "counts": {k: n for k, n in counts.items() if n}}


def _distance(part: xr.Dataset) -> np.ndarray:
    """Distance of the optimum from the nearest lower bound, in quadratic widths; shape (n,)."""
    lower = xr.DataArray(KBI().lower, dims="parameter")
    distance = (part["optimum"] - lower) / part["quadratic"]
    values = distance.min("parameter", skipna=False).values
    return np.where(np.isfinite(values), values, np.nan)


def _bend(part: xr.Dataset) -> np.ndarray:
    """Largest ratio of full-Hessian and Gauss-Newton width, either way up; shape (n,)."""
    ratio = part["quadratic"] / part["gauss_newton"]
    return ratio.where(ratio >= 1, 1 / ratio).max("parameter", skipna=False).values


def _shift(part: xr.Dataset) -> np.ndarray:
    """Largest distance of an end of a 95 % interval from the Gaussian's, in widths; shape (n,)."""
    signs = xr.DataArray([-1.0, 1.0], dims="side")
    ends = (part["posterior_95"] - part["optimum"]) / part["quadratic"]
    return abs(ends - NORMAL_95 * signs).max(["parameter", "side"], skipna=False).values


def _causes(part: xr.Dataset) -> Record:
    return {
        "of": part.sizes["cell"],
        "E": _quantiles(part["E"].values),
        "shift": _quantiles(_shift(part)),
        "distance": _quantiles(_distance(part)),
        "bend": _quantiles(_bend(part)),
    }


def _distance_classes(part: xr.Dataset) -> list[Record]:
    distance, agrees = _distance(part), part["verdict"].values == "agrees"
    found = []
    for low, high in itertools.pairwise(DISTANCES):
        inside = (distance >= low) & (distance < high)
        found.append(
            {
                "from": low,
                "to": high if np.isfinite(high) else None,
                "of": int(inside.sum()),
                "agrees": int(np.sum(inside & agrees)),
            }
        )
    return found


def _associations(part: xr.Dataset, least: float) -> Record:
    """Rank correlation of how wrong the width is with what might make it so.

    Of the cells whose distance from a bound is at least so many quadratic widths.
    """
    part = part.isel(cell=np.flatnonzero(_distance(part) >= least))
    wrong = _shift(part)
    found: Record = {"least_distance": least}
    for name, values in {
        "E": part["E"].values,
        "nearness": -_distance(part),
        "bend": _bend(part),
    }.items():
        both = np.isfinite(wrong) & np.isfinite(values)
        # A rank correlation needs a few cells, and some spread among them.
        usable = both.sum() >= 10 and np.ptp(wrong[both]) > 0 and np.ptp(values[both]) > 0
        found[name] = {
            "of": int(both.sum()),
            "spearman": float(scipy.stats.spearmanr(wrong[both], values[both]).statistic)
            if usable
            else None,
        }
    return found


def _sampler(done: xr.Dataset) -> Record:
    steps = done["step"].values.tolist()
    empty = done.sizes["cell"] == 0
    return {
        "of": done.sizes["cell"],
        "steps": {step: steps.count(step) for step in dict.fromkeys(steps)},
        "not_converged": int(np.sum(done["verdict"].values == "not converged")),
        "rhat_largest": None if empty else float(done["rhat"].max()),
        "ess_bulk_smallest": None if empty else float(done["ess_bulk"].min()),
        "ess_tail_smallest": None if empty else float(done["ess_tail"].min()),
        "acceptance": _quantiles(done["acceptance"].values),
    }


def _referee(done: xr.Dataset) -> Record:
    """Compare sampled with integrated standard deviations, in Monte Carlo errors."""
    off = (done["posterior_sd"] - done["quadrature_sd"]) / done["posterior_sd_mcse"]
    relative = (done["posterior_sd"] / done["quadrature_sd"] - 1).values
    finite = off.values[np.isfinite(off.values)]
    if not finite.size:
        return {"of": 0}
    disagreeing = []
    for i in np.flatnonzero((abs(off) > DISAGREEMENT).any("parameter").values):
        cell = done.isel(cell=i)
        worst = cell.isel(parameter=int(np.nanargmax(abs(off).isel(cell=i).values)))
        disagreeing.append(
            {
                **{name: cell[name].item() for name in CELL},
                "parameter": worst["parameter"].item(),
                "sampled": worst["posterior_sd"].item(),
                "integrated": worst["quadrature_sd"].item(),
                "verdict": cell["verdict"].item(),
            }
        )
    return {
        "of": int(finite.size),
        "rms": float(np.sqrt(np.mean(finite**2))),
        "largest": float(np.abs(finite).max()),
        # What the largest of so many standard normal numbers comes to, in the middle.
        "expected_largest": float(scipy.stats.norm.isf((1 - 0.5 ** (1 / finite.size)) / 2)),
        "largest_relative": float(np.nanmax(np.abs(relative))),
        "limit": DISAGREEMENT,
        "disagreeing": disagreeing,
    }
