"""Figure of several records of one joint."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from identifiability.investigation.across.agreement import Across
from identifiability.palette import BLUE, GREY, VERMILLION
from identifiability.plots.style import styled

_COLUMNS = 4
_LETTERS = 36  # of a line below one column
_SHORT, _FEW = 7, 4  # letters of names, and how many of them, that there is room for in a panel
_NORMAL_95 = 1.96


def across_figure(found: Across) -> Figure:
    """Every parameter by record, with 95 % intervals; grey, what all records together say.

    Parameters
    ----------
    found : Across

    Returns
    -------
    Figure
    """
    n = len(found.parameters)
    rows = -(-n // _COLUMNS)
    columns = -(-n // rows)
    labels = [record.name for record in found.records]
    short = all(len(label) <= _SHORT for label in labels) and len(labels) <= _FEW
    places = np.arange(len(found.records))
    with styled():
        figure = Figure(figsize=(2.9 * columns, 2.7 * rows + 0.3))
        axes = figure.subplots(rows, columns, squeeze=False)
        for panel in axes.flat[n:]:
            panel.set_visible(False)
        for panel, one in zip(axes.flat, found.parameters, strict=False):
            parameter = found.model.parameters[one.name]
            colour = VERMILLION if one.shared and one.verdict == "differ" else BLUE
            if one.shared and one.sd > 0:
                panel.axhspan(
                    one.value - _NORMAL_95 * one.sd,
                    one.value + _NORMAL_95 * one.sd,
                    color=GREY,
                    alpha=0.35,
                    lw=0,
                )
            for place, record in zip(places, found.records, strict=True):
                panel.errorbar(
                    place,
                    record.values[one.name],
                    _NORMAL_95 * record.sds.get(one.name, 0.0),
                    fmt="o",
                    color=colour,
                    capsize=3,
                )
            panel.set_xticks(places, labels if short else [str(1 + place) for place in places])
            panel.set_xlim(-0.6, len(places) - 0.4)
            unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
            panel.set_ylabel(f"${parameter.symbol}${unit}")
            name = one.name.replace(".", ": ").replace("_", " ")
            panel.set_title(name if one.shared else f"{name} (may differ)", fontsize=9)
        if not short:
            names = ", ".join(f"{1 + i}: {label}" for i, label in enumerate(labels))
            figure.supxlabel(fill(names, int(_LETTERS * columns)), fontsize=10)
    return figure
