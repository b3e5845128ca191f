"""Figures of an investigation's decisions: every effect alone, the error ladder, the widths."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from identifiability.inference.widths import Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.ladder.found import Found
from identifiability.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION
from identifiability.plots.style import styled

_DIVERGED = 1e3  # E of a prediction that has nothing to do with the trial any more
_LEAST = 1.0  # nats: what is less is drawn at this length, the axis being logarithmic


def error_text(error: float, digits: int = 3) -> str:
    """E as text; "diverges" where a prediction has nothing to do with its trial any more."""
    return f"{error:.{digits}g}" if error < _DIVERGED else "diverges"


def alone_figure(found: Found, named: Collection[str] = ()) -> Figure:
    """Log evidence of every effect beside the baseline, physics and measurement in two colours.

    Parameters
    ----------
    found : Found
    named : collection of str
        Effects that are named, alone or as what one of them could be.

    Returns
    -------
    Figure
    """
    with styled():
        figure = Figure(figsize=(9.0, 0.36 * len(found.alone) + 1.9))
        axes = figure.subplots()
        for row, one in enumerate(found.alone):
            colour = ORANGE if one.effect.kind == "measurement" else BLUE
            length = _LEAST if one.failure else max(one.evidence, _LEAST)
            if not one.failure:
                face = colour if one.key in named else "none"
                axes.barh(row, length, color=face, edgecolor=colour, height=0.68)
            axes.annotate(
                "no fit" if one.failure else f"leaves {100 * one.error:.2g} % of the energy",
                (length, row),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                color=VERMILLION if one.failure else BLACK,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
            )
        axes.set_yticks(range(len(found.alone)), [r.key.replace("_", " ") for r in found.alone])
        axes.set_ylim(len(found.alone) - 0.4, -0.6)
        axes.set_xscale("log")
        axes.set_xlim(_LEAST, max([10.0, *(r.evidence for r in found.alone)]) ** 1.4)
        before = ", ".join(k.replace("_", " ") for k in found.baseline.keys) or "K, B, I"
        axes.set_xlabel(f"log evidence above that of {before} alone [nats]")
        axes.legend(
            handles=[
                Patch(color=BLUE, label="physics"),
                Patch(color=ORANGE, label="measurement"),
                Patch(facecolor="none", edgecolor=GREY, label="not named"),
            ],
            loc="lower right",
        )
    return figure


def ladder_figure(findings: Findings) -> Figure:
    """Error on fitted and held-out trials with every effect added, against the noise floor."""
    found, split = findings.found, findings.split
    names = ["K, B, I", *(f"+ {m.key.replace('_', ' ')}" for m in found.missing)]
    rungs = found.ladder
    with styled():
        figure = Figure(figsize=(7.5, 4.2))
        axes = figure.subplots()
        place = np.arange(len(rungs))
        axes.plot(place, [c.fitted.error for c in rungs], "o-", color=BLUE, label="fitted trials")
        if split.held_out:
            held = [c.held_out.error for c in rungs]
            axes.plot(place, held, "s--", color=VERMILLION, label="held-out trials")
        floor = split.noise_floor()
        if floor is not None:
            axes.axhline(floor, color=GREEN, lw=1.5, label="noise floor")
            share = 2 * split.floor_uncertainty()
            axes.axhspan(
                floor * max(1 - share, 0.05), floor * (1 + share), color=GREEN, alpha=0.15, lw=0
            )
        axes.set_yscale("log")
        axes.set_xticks(place, names)
        axes.margins(x=0.15)
        axes.set_ylabel("error E (Eq. 3), pooled over trials")
        axes.set_title("Error ladder", loc="left")
        axes.legend()
    return figure


def widths_figure(result: Widths) -> Figure:
    """Each parameter's widths side by side, in units of its value; those that there are."""
    rows = result.rows
    known = [None if row.verdict == "not converged" else row.posterior_sd for row in rows]
    kinds: tuple[tuple[str, str, Sequence[float | None]], ...] = (
        ("slice (others held)", GREY, [row.slice for row in rows]),
        ("quadratic (Hessian)", VERMILLION, [row.quadratic for row in rows]),
        ("profile", ORANGE, [row.profile for row in rows]),
        ("posterior sd", BLUE, known),
    )
    with styled():
        figure = Figure(figsize=(8.5, 0.62 * len(rows) + 1.8))
        axes = figure.subplots()
        for k, (name, colour, widths) in enumerate(kinds):
            places = [
                (width / (abs(row.optimum) or 1.0), i + 0.16 * (k - 1.5))
                for i, (row, width) in enumerate(zip(rows, widths, strict=True))
                if width is not None and np.isfinite(width) and width > 0
            ]
            if places:
                axes.plot(*np.transpose(places), "o", color=colour, ms=7, label=name)
        axes.axvline(1.0, color=BLACK, lw=1, ls=":")
        axes.set_xscale("log")
        labels = [f"{r.name.replace('_', ' ')}\n({r.verdict})" for r in rows]
        axes.set_yticks(range(len(rows)), labels)
        axes.invert_yaxis()
        axes.set_xlabel("width over value; dotted: as wide as the value itself")
        figure.legend(loc="outside upper center", ncols=4)
    return figure
