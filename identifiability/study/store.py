"""The atlas as one labelled data set, in a NetCDF file."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from identifiability.files import replacing
from identifiability.joint.model import KBI
from identifiability.provenance import stamp
from identifiability.study.atlas import N_DRAWS, Plan
from identifiability.sweep.outcome import Outcome

CELL = ("K_CE", "B_CE", "ratio", "T", "perturbation", "reading")
SIDES = ("lower", "upper")


class Field(NamedTuple):
    """A stored quantity.

    Attributes
    ----------
    dims : tuple of str
        Dimensions beyond those of the cell.
    kind : str
        ``"f4"``, ``"f4"``, ``"u4"``, ``"?"`` or ``"U"`` (text).
    description : str
    units : str
        "parameter" where it is in the unit of each parameter; "" for a text.
    """

    dims: tuple[str, ...]
    kind: str
    description: str
    units: str = ""


_P, _ENDS = ("parameter",), ("parameter", "side")

FIELDS: dict[str, Field] = {
    "verdict": Field((), "U", "worst verdict on the quadratic width of any parameter"),
    "reason": Field((), "U", "reason of that verdict"),
    "status": Field((), "U", "done, failed, crashed or timed out"),
    "cause": Field((), "U", "why the cell has no result"),
    "E": Field((), "f4", "error criterion E at the optimum, over the samples", "1"),
    "step": Field((), "U", "step of the sampling ladder"),
    "step_reason": Field((), "U", "why that step"),
    "acceptance": Field((), "f4", "mean acceptance fraction of the sampler", "1"),
    "seconds": Field((), "f4", "processor time", "s"),
    "seed": Field((), "u4", "seed of the cell's sampler", "1"),
    "optimum": Field(_P, "f8", "best value", "parameter"),
    "at_bound": Field(_P, "?", "whether the optimum lies on a bound"),
    "slice": Field(_P, "f4", "sd with the other parameters held", "parameter"),
    "quadratic": Field(_P, "f4", "sd from the full Hessian", "parameter"),
    "change": Field(_P, "f4", "largest change that raises E by dE (Eq. 15), size", "parameter"),
    "gauss_newton": Field(_P, "f4", "sd from J'J", "parameter"),
    "sandwich": Field(_P, "f4", "scatter of the optimum over repetitions", "parameter"),
    "profile": Field(_P, "f4", "half the 68 % profile interval", "parameter"),
    "profile_68": Field(_ENDS, "f4", "68 % profile interval", "parameter"),
    "profile_95": Field(_ENDS, "f4", "95 % profile interval", "parameter"),
    "profile_end": Field(_ENDS, "U", "what ends the 95 % profile interval: closed, bound or open"),
    "posterior_mean": Field(_P, "f4", "posterior mean", "parameter"),
    "posterior_sd": Field(_P, "f4", "posterior standard deviation, sampled", "parameter"),
    "posterior_sd_mcse": Field(_P, "f4", "Monte Carlo error of it", "parameter"),
    "posterior_68": Field(_ENDS, "f4", "68.27 % equal-tailed posterior interval", "parameter"),
    "posterior_95": Field(_ENDS, "f4", "95 % equal-tailed posterior interval", "parameter"),
    "quadrature_mean": Field(_P, "f4", "posterior mean by quadrature", "parameter"),
    "quadrature_sd": Field(_P, "f4", "posterior standard deviation by quadrature", "parameter"),
    "rhat": Field(_P, "f4", "R-hat across independent ensembles", "1"),
    "ess_bulk": Field(_P, "f4", "effective sample size, bulk", "1"),
    "ess_tail": Field(_P, "f4", "effective sample size, tail", "1"),
    "parameter_verdict": Field(_P, "U", "verdict on the quadratic width"),
    "parameter_reason": Field(_P, "U", "reason of that verdict"),
    "draws": Field(("draw", "parameter"), "f4", "thinned posterior draws", "parameter"),
}

_BULKY = ("draws", "parameter_reason", "step_reason")  # stored with the draws, or not at all

_COORDINATES = {
    "K_CE": ("stiffness of the contractile element", "N m rad-1"),
    "B_CE": ("damping of the contractile element", "N m s rad-1"),
    "ratio": ("K_SE / K_CE", "1"),
    "T": ("duration that is fitted", "s"),
}


def to_dataset(plan: Plan, outcomes: Mapping[str, Outcome]) -> xr.Dataset:
    """Arrange the outcomes of an atlas on its grid.

    Parameters
    ----------
    plan : Plan
    outcomes : mapping of str to Outcome
        From `run_atlas`.

    Returns
    -------
    xarray.Dataset
        Dimensions `CELL`, then ``parameter`` (coordinate ``unit``), ``side``, ``draw``; numbers
        are NaN and texts empty in cells without a result.
    """
    axes = plan.axes
    names = [name for name in FIELDS if plan.draws or name not in _BULKY]
    parameters = KBI().parameters
    sizes = {name: len(values) for name, values in axes.items()}
    sizes |= {"parameter": len(parameters), "side": len(SIDES), "draw": N_DRAWS}
    arrays = {
        name: np.full(
            [sizes[d] for d in CELL + field.dims],
            {"U": "", "?": False, "u4": 0}.get(field.kind, np.nan),
            dtype=object if field.kind == "U" else field.kind,
        )
        for name, field in FIELDS.items()
        if name in names
    }
    for name, cell in plan.cells().items():
        outcome = outcomes[name]
        place = tuple(axes[dim].index(getattr(cell, dim)) for dim in CELL)
        values = {
            **(outcome.arrays or {}),
            "status": outcome.status,
            "cause": outcome.cause,
            "seed": cell.own_seed,
        }
        for key in names:
            if key in values:
                arrays[key][place] = np.asarray(values[key]).tolist()
    coordinates = {
        name: xr.DataArray(
            list(values), dims=name, attrs=_attributes(*_COORDINATES.get(name, ("", "")))
        )
        for name, values in axes.items()
    }
    return xr.Dataset(
        {
            name: (CELL + FIELDS[name].dims, arrays[name], _attributes(*FIELDS[name][2:]))
            for name in names
        },
        {
            **coordinates,
            "parameter": list(parameters),
            "unit": ("parameter", [p.unit for p in parameters.values()]),
            "side": list(SIDES),
            "K_SE": (("K_CE", "ratio"), np.outer(plan.K_CE, plan.ratio), {"units": "N m rad-1"}),
        },
        {
            "title": "Widths of K, B and I fitted to a musculoskeletal model",
            **stamp(__name__),
            "plan": json.dumps(asdict(plan)),
        },
    )


def write_atlas(dataset: xr.Dataset, path: Path) -> None:
    """Write the data set as NetCDF, in one piece or not at all."""
    packed: dict[Hashable, dict[str, Any]] = {}
    for name, variable in dataset.data_vars.items():
        if variable.dtype.kind == "f":
            packed[name] = {"zlib": True, "complevel": 6, "shuffle": True}
        elif variable.dtype.kind == "O":
            # Texts of one length are packed; those of any length would not be.
            packed[name] = {"dtype": "S1", "zlib": True, "complevel": 6}
    with replacing(path) as temporary:
        dataset.to_netcdf(temporary, engine="h5netcdf", encoding=packed)


def _attributes(description: str, units: str) -> dict[str, str]:
    texts = {
        "long_name": description,
        "units": "see the coordinate unit" if units == "parameter" else units,
    }
    return {name: text for name, text in texts.items() if text}
