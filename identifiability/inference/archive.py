"""Widths as a labelled tree of arrays, in a NetCDF file that ArviZ and xarray read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from identifiability.files import replacing
from identifiability.inference.problem import Problem
from identifiability.inference.widths import Widths
from identifiability.provenance import stamp

if TYPE_CHECKING:
    import xarray


def to_datatree(problem: Problem, result: Widths) -> xarray.DataTree:
    """Arrange widths in groups, with ArviZ's names where it has them.

    Returns
    -------
    xarray.DataTree
        Groups ``posterior`` and ``sample_stats`` (chain, draw), ``observed_data``, ``optimum``,
        ``laplace`` (Hessian, Gauss-Newton, covariances), ``profile`` and, where it was done,
        ``quadrature``.
    """
    import xarray

    names = list(result.names)
    posterior, shape = result.posterior, result.curvature
    units = {row.name: {"units": row.unit} for row in result.rows}
    square = ("parameter", "parameter_bis")
    labels = {"parameter": names, "parameter_bis": names}
    groups = {
        "posterior": xarray.Dataset(
            {
                name: (("chain", "draw"), posterior.draws[:, :, i], units[name])
                for i, name in enumerate(names)
            }
        ),
        "sample_stats": xarray.Dataset({"lp": (("chain", "draw"), posterior.log_probability)}),
        "observed_data": xarray.Dataset(
            {
                f"response_{i}": (f"sample_{i}", o.measured)
                for i, o in enumerate(problem.observations)
            }
        ),
        "optimum": xarray.Dataset(
            {"value": ("parameter", result.fit.values)}, {"parameter": names}
        ),
        "laplace": xarray.Dataset(
            {
                "hessian": (square, shape.hessian),
                "gauss_newton": (square, shape.gauss_newton),
                "covariance": (square, shape.covariance),
                "sandwich_covariance": (square, shape.sandwich_covariance),
            },
            labels,
        ),
        "profile": xarray.Dataset(
            {
                key: (f"{p.name}_point", values)
                for p in result.profiles
                for key, values in ((f"{p.name}_value", p.values), (f"{p.name}_drop", p.drops))
            }
        ),
    }
    if result.moments is not None:
        groups["quadrature"] = xarray.Dataset(
            {
                "mean": ("parameter", result.moments.mean),
                "sd": ("parameter", result.moments.sd),
                "covariance": (square, result.moments.covariance),
                "log_evidence": result.moments.log_evidence,
            },
            labels,
        )
    for dataset in groups.values():
        for dimension in ("chain", "draw"):
            if dimension in dataset.sizes:
                dataset.coords[dimension] = np.arange(dataset.sizes[dimension])
    tree = xarray.DataTree.from_dict(groups)
    tree.attrs = {
        **stamp(__name__),
        "model": repr(problem.model),
        "seed": posterior.seed,
        "sampler": posterior.step,
        "sampler_reason": posterior.reason,
        "independent_chains": 1,
        "verdict": result.verdict,
        "reason": result.reason,
    }
    return tree


def write_netcdf(problem: Problem, result: Widths, path: Path) -> None:
    """Write the tree of `to_datatree` to a NetCDF file, in one piece or not at all."""
    tree = to_datatree(problem, result)
    with replacing(path) as temporary:
        tree.to_netcdf(temporary, engine="h5netcdf")
