"""Figures of an investigation's decisions: every effect alone, the error ladder, the widths."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from identifiability.inference.widths import Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.ladder.found import Found
from identifiability.investigation.models import fitted_models
from identifiability.investigation.wording.values import name_in_words, width_in_words
from identifiability.investigation.wording.verdict import model_in_words, percent, plain
from identifiability.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION
from identifiability.plots.style import COLUMN, PAGE, printed

_LEAST = 0.3  # powers of ten: what is less is drawn at this length, the axis being logarithmic
_LINE = 22  # letters of a model's name in one line


@printed
def alone_figure(
    found: Found, named: Collection[str] = (), present: Mapping[str, float] | None = None
) -> Figure:
    """Log evidence of every effect beside the baseline, physics and measurement in two colours.

    Parameters
    ----------
    found : Found
    named : collection of str
        Effects that are named, alone or as what one of them could be.
    present : mapping of str to float, optional
        Probability of each effect that it is there, whatever else is: said beside its bar.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(PAGE, 0.2 * len(found.alone) + 0.6))
    axes = figure.subplots()
    longest = max([10.0, *(one.evidence / np.log(10) for one in found.alone)])
    for row, one in enumerate(found.alone):
        colour = ORANGE if one.effect.kind == "measurement" else BLUE
        length = _LEAST if one.failure else max(one.evidence / np.log(10), _LEAST)
        if not one.failure:
            face = colour if one.key in named else "none"
            axes.barh(row, length, color=face, edgecolor=colour, height=0.68)
        words = "no fit" if one.failure else f"leaves {percent(one.error)} of the energy"
        if present is not None and not one.failure:
            words = f"{percent(present.get(one.key, 0.0))} there; alone {words}"
        axes.annotate(
            words,
            (length, row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
            color=VERMILLION if one.failure else BLACK,
        )
    axes.set_yticks(range(len(found.alone)), [plain(one.key) for one in found.alone])
    axes.set_ylim(len(found.alone) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, longest**2 / _LEAST)  # half of it for words
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(
        f"powers of ten by which it is more probable than {model_in_words(found.baseline.keys)} "
        "alone"
    )
    figure.legend(
        handles=[
            Patch(color=BLUE, label="physics"),
            Patch(color=ORANGE, label="measurement"),
            Patch(facecolor="none", edgecolor=GREY, label="not named"),
        ],
        loc="outside upper center",
        ncols=3,
    )
    return figure


@printed
def ladder_figure(findings: Findings) -> Figure:
    """Error on fitted and held-out trials with every effect added, against the noise of each part.

    Models with another effect in the place of one follow, apart.
    """
    split, models = findings.split, fitted_models(findings)
    parts = [("fitted", "fitted trials", "o-", BLUE)]
    if split.held_out:
        parts.append(("held_out", "held-out trials", "s--", VERMILLION))
    n_rungs = len(findings.found.ladder)
    figure = Figure(figsize=(COLUMN if len(models) < 4 else PAGE, 2.6))
    axes = figure.subplots()
    place = np.arange(len(models))
    for part, label, look, colour in parts:
        errors = [getattr(one.candidate, part).error for one in models]
        axes.plot(place[:n_rungs], errors[:n_rungs], look, color=colour, label=label)
        axes.plot(place[n_rungs:], errors[n_rungs:], look[0], color=colour, mfc="white")
        floor = split.noise_floor(getattr(split, part))
        if floor is not None:
            share = 2 * split.floor_uncertainty()
            axes.axhline(floor, color=colour, lw=0.8, ls=":", label=f"noise of {label}")
            axes.axhspan(
                floor * max(1 - share, 0.05), floor * (1 + share), color=colour, alpha=0.12, lw=0
            )
    axes.set_yscale("log")
    axes.set_xticks(place, [fill(name_in_words(one), _LINE) for one in models])
    axes.margins(x=0.15)
    axes.set_ylabel("error E")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@printed
def widths_figure(result: Widths) -> Figure:
    """Each parameter's widths side by side, in units of its value; those that there are."""
    rows = result.rows
    known = [None if row.verdict == "not converged" else row.posterior_sd for row in rows]
    kinds: tuple[tuple[str, str, str, Sequence[float | None]], ...] = (
        ("slice (others held)", GREY, "v", [row.slice for row in rows]),
        ("quadratic (Hessian)", VERMILLION, "s", [row.quadratic for row in rows]),
        ("profile", GREEN, "^", [row.profile for row in rows]),
        ("posterior sd", BLUE, "o", known),
    )
    figure = Figure(figsize=(PAGE, 0.32 * len(rows) + 0.8))
    axes = figure.subplots()
    for k, (name, colour, marker, widths) in enumerate(kinds):
        places = [
            (width / (abs(row.optimum) or 1.0), i + 0.16 * (k - 1.5))
            for i, (row, width) in enumerate(zip(rows, widths, strict=True))
            if width is not None and np.isfinite(width) and width > 0
        ]
        if places:
            axes.plot(*np.transpose(places), marker, color=colour, ms=4, label=name)
    axes.axvline(1.0, color=BLACK, lw=0.8, ls=":")
    axes.set_xscale("log")
    labels = [f"{plain(row.name)} ({width_in_words(row.verdict)})" for row in rows]
    axes.set_yticks(range(len(rows)), labels)
    axes.invert_yaxis()
    axes.set_xlabel("width over value; dotted: as wide as the value itself")
    figure.legend(loc="outside upper center", ncols=4)
    return figure
