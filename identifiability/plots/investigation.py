"""Figures of an investigation's decisions: the ranking of candidates and the error ladder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from identifiability.inference.widths import Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.search.found import Ranking
from identifiability.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION
from identifiability.plots.style import styled

_DIVERGED = 1e3  # E of a prediction that has nothing to do with the trial any more
_FEWEST = 1.0  # evidence below it is drawn at this length: the axis is logarithmic


def error_text(error: float, digits: int = 3) -> str:
    """E as text; "diverges" where a prediction has nothing to do with its trial any more."""
    return f"{error:.{digits}g}" if error < _DIVERGED else "diverges"


def ranking_figure(ranking: Ranking, members: Sequence[str] = ()) -> Figure:
    """Evidence of every candidate beside one model, physics and measurement in two colours.

    Parameters
    ----------
    ranking : Ranking
    members : sequence of str
        Effects that cannot be told apart from the one that was chosen.

    Returns
    -------
    Figure
    """
    ranked = [r for r in ranking.ranked if not r.candidate.failure]
    failed = [r for r in ranking.ranked if r.candidate.failure]
    with styled():
        figure = Figure(figsize=(9.0, 0.36 * len(ranking.ranked) + 1.9))
        axes = figure.subplots()
        for row, r in enumerate(ranked):
            colour = ORANGE if r.effect.kind == "measurement" else BLUE
            axes.barh(
                row,
                max(r.evidence, _FEWEST),
                color=colour if r.passes else "none",
                edgecolor=colour,
                height=0.68,
            )
            mark = "   chosen" if r.key == ranking.chosen else ""
            if r.key in members and r.key != ranking.chosen:
                mark = "   cannot be told apart from it"
            held = r.candidate.held_out.error
            words = f"E held out {error_text(held, 2)}{mark}" if np.isfinite(held) else mark.strip()
            axes.annotate(
                words,
                (max(r.evidence, _FEWEST), row),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                color=BLACK,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
            )
        for row, _ in enumerate(failed, len(ranked)):
            axes.annotate(
                "no fit",
                (_FEWEST, row),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                color=VERMILLION,
            )
        axes.axvline(ranking.decisive, color=GREY, lw=1, ls="--", zorder=0)
        axes.set_yticks(
            range(len(ranking.ranked)), [r.key.replace("_", " ") for r in (*ranked, *failed)]
        )
        axes.set_ylim(len(ranking.ranked) - 0.4, -0.6)
        axes.set_xscale("log")
        top = max([r.evidence for r in ranked] + [10 * ranking.decisive])
        axes.set_xlim(_FEWEST, top**1.5)
        before = ", ".join(k.replace("_", " ") for k in ranking.before.keys) or "K, B, I alone"
        axes.set_xlabel(
            "evidence for adding it (twice log likelihood less penalty); dashed: decisive"
        )
        axes.set_title(f"added to: {before}", loc="left")
        axes.legend(
            handles=[
                Patch(color=BLUE, label="physics"),
                Patch(color=ORANGE, label="measurement"),
                Patch(facecolor="none", edgecolor=GREY, label="not admitted"),
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
