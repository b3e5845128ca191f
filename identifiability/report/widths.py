"""Widths as text, and their record, posterior and corner plot in a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from identifiability.files import write_json
from identifiability.inference.archive import write_netcdf
from identifiability.inference.problem import Problem
from identifiability.inference.records import widths_record
from identifiability.inference.widths import Widths
from identifiability.investigation.wording.values import width_in_words
from identifiability.plots.corner import corner_figure
from identifiability.plots.style import save


def write_widths(
    problem: Problem,
    result: Widths,
    out: Path,
    title: str,
    conditions: Mapping[str, Any] | None = None,
) -> None:
    """Write ``posterior.nc``, ``corner.png`` and ``widths.json`` into a folder.

    Parameters
    ----------
    problem : Problem
    result : Widths
    out : Path
    title : str
        Of the corner plot.
    conditions : mapping, optional
        What the record says of setting and measurement.
    """
    write_netcdf(problem, result, out / "posterior.nc")
    save(corner_figure(result, problem, title=title), out / "corner.png")
    write_json(out / "widths.json", widths_record(result, conditions or {}))


def widths_text(result: Widths) -> str:
    """All widths side by side, as text."""
    columns = [
        ("optimum", "optimum"),
        ("slice", "slice"),
        ("quadratic", "quadratic"),
        ("Gauss-N.", "gauss_newton"),
        ("sandwich", "sandwich"),
        ("profile", "profile"),
        ("posterior", "posterior_sd"),
        ("quadrature", "quadrature_sd"),
    ]
    head = f"{'':24}" + "".join(f"{title:>11}" for title, _ in columns) + "  width"
    lines = [head]
    for row in result.rows:
        cells = "".join(f"{getattr(row, field):>11.4g}" for _, field in columns)
        lines.append(f"{row.name + ' [' + row.unit + ']':24}{cells}  {width_in_words(row.verdict)}")
    return "\n".join(lines)
