"""Figures of where a model fails: responses and residuals, the misfit's views, K, B, I by part."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.fits.candidate import Candidate, Residual
from identifiability.investigation.fits.refits import NAMES, UNITS
from identifiability.investigation.split import Split
from identifiability.investigation.where.compare import Comparison, Constancy
from identifiability.investigation.where.drawing import label_below
from identifiability.investigation.where.imposed import starts
from identifiability.investigation.where.locate import Location
from identifiability.investigation.where.view import Panel
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.measurement.prepared import Prepared
from identifiability.palette import BLACK, BLUE, GREY, SKY, VERMILLION
from identifiability.plots.style import LONGEST_SHOWN, styled

_MOST_TRIALS, _COLUMNS = 8, 4
_LETTER, _BESIDE_LABELS = 0.085, 2.0  # of a legend [inch]: width of a letter, and of all else
_CELLS = 12  # of a row: divided evenly by whatever number of columns its panels have
_BEFORE = 0.05  # seconds before the first perturbation that are shown
_UNITS = {"torque": "rad", "angle": "Nm"}  # of the response to it


def responses_figure(
    split: Split,
    before: Candidate,
    after: Candidate | None = None,
    *,
    of: Literal["fitted", "held_out"] = "fitted",
) -> Figure:
    """Measured and predicted responses of up to eight trials, and under each what is left.

    Where there are more, those are shown that the first model describes worst, each kind once
    before any kind twice. Of a long record three seconds are shown.

    Parameters
    ----------
    split : Split
    before, after : Candidate
        Models whose predictions are drawn.
    of : {"fitted", "held_out"}
        Which trials.

    Returns
    -------
    Figure
    """
    trials: Sequence[Prepared] = getattr(split, of)
    first: Residual = getattr(before, of)
    shown = sorted(np.argsort(first.errors)[::-1][:_MOST_TRIALS].tolist())
    models = [(first, model_in_words(before.keys), VERMILLION)]
    if after is not None:
        models.append((getattr(after, of), model_in_words(after.keys), BLUE))
    in_noise = split.has_noise and all(r.lead.sd > 0 for r in trials)
    unit = _UNITS[split.driven]
    n_columns = min(len(shown), _COLUMNS)
    n_rows = -(-len(shown) // n_columns)
    with styled():
        figure = Figure(figsize=(max(6.5, 3.5 * n_columns), 4.3 * n_rows + 0.5))
        heights = [2.0, 1.3] * n_rows
        axes = figure.subplots(2 * n_rows, n_columns, squeeze=False, height_ratios=heights)
        for place, i in enumerate(shown):
            row, column = divmod(place, n_columns)
            upper, lower = axes[2 * row, column], axes[2 * row + 1, column]
            _overlay(upper, lower, trials[i], [(m.by_trial[i], c) for m, _, c in models])
            errors = ", then ".join(f"{left.errors[i]:.2g}" for left, _, _ in models)
            upper.set_title(f"{trials[i].name}\nE = {errors}", fontsize=10)
            if column == 0:
                upper.set_ylabel("angle [rad]" if unit == "rad" else "torque [Nm]")
                lower.set_ylabel("residual /\nnoise" if in_noise else f"residual\n[{unit}]")
            lower.set_xlabel("time [s]")
        for place in range(len(shown), n_rows * n_columns):
            row, column = divmod(place, n_columns)
            axes[2 * row, column].set_visible(False)
            axes[2 * row + 1, column].set_visible(False)
        handles = [axes[0, 0].lines[k] for k in range(1 + len(models))]
        room = int((figure.get_figwidth() - _BESIDE_LABELS) / (_LETTER * len(models)))
        labels = ["measured", *(fill(label, room) for _, label, _ in models)]
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        more = len(trials) - len(shown)
        if more:
            figure.supxlabel(
                f"{more} more trials, which are described better, are not shown", fontsize=10
            )
    return figure


def _overlay(
    upper: Axes, lower: Axes, ready: Prepared, models: Sequence[tuple[np.ndarray, str]]
) -> None:
    interval = ready.drive.interval
    first = max(0, int(starts(ready)[0]) - round(_BEFORE / interval))
    part = slice(first, first + round(LONGEST_SHOWN / interval) + 1)
    time = ready.trial.time[ready.first : ready.last][part]
    measured = ready.compared
    noise = ready.lead.sd if ready.lead.n_samples and ready.lead.sd > 0 else 1.0
    upper.plot(time, measured[part], color=BLACK, lw=3.0, alpha=0.55)
    for (left, colour), width in zip(models, (1.6, 1.2), strict=False):
        upper.plot(time, (measured - left)[part], color=colour, lw=width)
        lower.plot(time, (left / noise)[part], color=colour, lw=0.9)
    if noise != 1.0:
        lower.axhspan(-NORMAL_95, NORMAL_95, color=GREY, alpha=0.25, lw=0, zorder=0)
    lower.axhline(0, color=GREY, lw=0.8)
    upper.tick_params(labelbottom=False)


def where_figure(location: Location) -> Figure:
    """The panels of all views of where a model fails; what is significant is filled or marked.

    Parameters
    ----------
    location : Location

    Returns
    -------
    Figure
    """
    rows = _rows([panel for view in location.views.values() for panel in view.panels()])
    with styled():
        if not rows:
            return _empty("There is nothing to draw of where the model fails.")
        figure = Figure(figsize=(15.0, 3.5 * len(rows) + 1.0))
        grid = figure.add_gridspec(len(rows), _CELLS)
        for i, row in enumerate(rows):
            first = 0
            for panel in row:
                last = first + _CELLS * panel.width // _width(row)
                axes = figure.add_subplot(grid[i, first:last])
                axes.set_title(panel.title, loc="left")
                panel.draw(axes)
                first = last
        what = "the noise" if location.noise_known else "its typical level: the noise is unknown"
        figure.suptitle(
            f"Where the model fails: residual against {what}. Filled: significant "
            f"(false discovery rate {100 * location.level:g} %)"
        )
    return figure


def _rows(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Panels in their order, in rows of up to four columns."""
    rows: list[list[Panel]] = []
    for panel in panels:
        if not rows or _width(rows[-1]) + panel.width > _COLUMNS:
            rows.append([])
        rows[-1].append(panel)
    return rows


def _width(row: Sequence[Panel]) -> int:
    return sum(panel.width for panel in row)


def _empty(reason: str) -> Figure:
    figure = Figure(figsize=(6.0, 1.2))
    figure.text(0.5, 0.5, reason, ha="center", color=GREY)
    return figure


def comparison_figure(comparison: Comparison) -> Figure:
    """K, B and I fitted to parts of the trials, with 95 % intervals, one column an aspect.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    Figure
    """
    shown = [c for c in comparison.constancy if c.groups]
    with styled():
        if not shown:
            return _empty("There are no parts to compare.")
        counts = [max(len(c.groups), 2.5) for c in shown]
        figure = Figure(figsize=(min(max(4.0 + 0.55 * sum(counts), 7.5), 15.0), 8.0))
        axes = figure.subplots(
            3, len(shown), sharex="col", sharey="row", squeeze=False, width_ratios=counts
        )
        for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
            low, high = _limits(comparison, shown, i)
            for panel, constancy in zip(axes[i], shown, strict=True):
                _estimates(panel, comparison, constancy, i)
                panel.set_ylim(low, high)
            axes[i, 0].set_ylabel(f"${name}$ [{unit}]")
        titles = {"window": "window T", "amplitude": "size", "condition": "kind"}
        for panel, constancy in zip(axes[0], shown, strict=True):
            title = titles.get(constancy.by, constancy.by)
            panel.set_title(f"{title}\n{'changes' if constancy.significant else 'same'}")
        for panel, constancy in zip(axes[2], shown, strict=True):
            label_below(panel, [group.label for group in constancy.groups], turned=True)
        figure.align_ylabels(axes[:, 0])
        figure.suptitle(
            "A joint that is what the model says has one K, B and I in every part", fontsize=12
        )
    return figure


def _limits(comparison: Comparison, shown: Sequence[Constancy], i: int) -> tuple[float, float]:
    """Range of one parameter's axis; estimates that say next to nothing do not stretch it."""
    centre = float(comparison.overall.values[i])
    # At a bound of 0 the parts say how large the parameter may be.
    parts = [abs(float(group.values[i])) for constancy in shown for group in constancy.groups]
    size = abs(centre) or max(parts) or 1.0
    spread = NORMAL_95 * float(comparison.overall.errors[i])
    spread = min(spread, 2 * size) if np.isfinite(spread) else 0.0
    low, high = [centre - spread], [centre + spread]
    for constancy in shown:
        for group in constancy.groups:
            value, error = float(group.values[i]), NORMAL_95 * float(group.errors[i])
            reach = min(error, 0.5 * size)
            if error < 2 * size:
                low.append(value - reach)
                high.append(value + reach)
    margin = 0.06 * max(max(high) - min(low), 0.02 * size)
    return min(low) - margin, max(high) + margin


def _estimates(panel: Axes, comparison: Comparison, constancy: Constancy, i: int) -> None:
    values = np.array([group.values[i] for group in constancy.groups])
    errors = np.array([group.errors[i] for group in constancy.groups])
    place = np.arange(values.size)
    colour = VERMILLION if constancy.significant else BLUE
    overall, spread = comparison.overall.values[i], NORMAL_95 * comparison.overall.errors[i]
    panel.axhspan(overall - spread, overall + spread, color=SKY, alpha=0.3, lw=0)
    panel.axhline(overall, color=GREY, lw=1.0)
    reach = NORMAL_95 * np.where(np.isfinite(errors), errors, 1e6)
    panel.vlines(place, values - reach, values + reach, color=colour, lw=1.8)
    panel.plot(place, values, "o", color=colour)
    panel.margins(x=0.12)
