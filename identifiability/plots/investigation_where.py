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
from identifiability.investigation.wording.numbers import error_text
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.measurement.prepared import Prepared
from identifiability.palette import BLACK, BLUE, GREY, SKY, VERMILLION
from identifiability.plots.style import COLUMN, LONGEST_SHOWN, MODEL_COLOURS, PAGE, printed

_MOST_TRIALS, _COLUMNS = 8, 3
_TITLE = 96  # letters of titles side by side
_LETTER, _BESIDE_LABEL = 0.055, 0.45  # of a legend [inch]: width of a letter, and of its line
_FEW_PARTS = 8  # into which trials are cut, that fit side by side in one column
_BEFORE = 0.05  # seconds before the first perturbation that are shown
_UNITS = {"torque": "rad", "angle": "Nm"}  # of the response to it
_LINES = ("--", "-", "-.", ":", (0, (5, 1)), (0, (1, 1)))  # told apart without colours
_FAR = 5.0  # times the noise's band, from which what lies in the band is not to vanish


@printed
def responses_figure(
    split: Split, *models: Candidate, of: Literal["fitted", "held_out"] = "fitted"
) -> Figure:
    """Measured and predicted responses of up to eight trials, and under each what is left.

    Where there are more, those are shown that the first model describes worst, each kind once
    before any kind twice. Of a long record three seconds are shown.

    Parameters
    ----------
    split : Split
    *models : Candidate
        Models whose predictions are drawn, up to six.
    of : {"fitted", "held_out"}
        Which trials.

    Returns
    -------
    Figure
    """
    trials: Sequence[Prepared] = getattr(split, of)
    left: list[Residual] = [getattr(one, of) for one in models]
    shown = sorted(np.argsort(left[0].errors)[::-1][:_MOST_TRIALS].tolist())
    in_noise = split.has_noise and all(r.lead.sd > 0 for r in trials)
    unit = _UNITS[split.driven]
    n_columns = 2 if len(shown) == 4 else min(len(shown), _COLUMNS)
    n_rows = -(-len(shown) // n_columns)
    figure = Figure(figsize=(PAGE, 2.9 * n_rows + 0.3))
    heights = [2.0, 1.3] * n_rows
    axes = figure.subplots(2 * n_rows, n_columns, squeeze=False, height_ratios=heights)
    for place, i in enumerate(shown):
        row, column = divmod(place, n_columns)
        upper, lower = axes[2 * row, column], axes[2 * row + 1, column]
        _overlay(upper, lower, trials[i], [one.by_trial[i] for one in left])
        errors = ", then ".join(error_text(float(one.errors[i]), 2) for one in left)
        upper.set_title(fill(f"{trials[i].name}: E = {errors}", _TITLE // n_columns))
        if column == 0:
            upper.set_ylabel("angle [rad]" if unit == "rad" else "torque [Nm]")
            lower.set_ylabel("residual /\nnoise" if in_noise else f"residual\n[{unit}]")
        lower.set_xlabel("time [s]")
    for place in range(len(shown), n_rows * n_columns):
        row, column = divmod(place, n_columns)
        axes[2 * row, column].set_visible(False)
        axes[2 * row + 1, column].set_visible(False)
    handles = axes[0, 0].lines[: 1 + len(models)]
    labels = ["measured", *(model_in_words(one.keys) for one in models)]
    room = PAGE / (_BESIDE_LABEL + _LETTER * max(map(len, labels)))
    n_beside = min(max(int(room), 1), len(labels))
    most = int((PAGE / n_beside - _BESIDE_LABEL) / _LETTER)
    figure.legend(
        handles, [fill(label, most) for label in labels], loc="outside upper center", ncols=n_beside
    )
    if more := len(trials) - len(shown):
        figure.supxlabel(f"{more} more trials, which are described better, are not shown")
    return figure


def _overlay(upper: Axes, lower: Axes, ready: Prepared, left: Sequence[np.ndarray]) -> None:
    interval = ready.drive.interval
    first = max(0, int(starts(ready)[0]) - round(_BEFORE / interval))
    part = slice(first, first + round(LONGEST_SHOWN / interval) + 1)
    time = ready.trial.time[ready.first : ready.last][part]
    measured = ready.compared
    known = bool(ready.lead.n_samples and ready.lead.sd > 0)
    noise = ready.lead.sd if known else 1.0
    upper.plot(time, measured[part], color=BLACK, lw=2.6, alpha=0.4)
    for one, colour, line in zip(left, MODEL_COLOURS, _LINES, strict=False):
        upper.plot(time, (measured - one)[part], color=colour, ls=line)
        lower.plot(time, (one / noise)[part], color=colour, lw=0.8)
    if known:
        lower.axhspan(-NORMAL_95, NORMAL_95, color=GREY, alpha=0.3, lw=0, zorder=0)
        largest = max(float(np.abs(one[part]).max()) for one in left) / noise
        if largest > _FAR * NORMAL_95:
            # What is noise is seen beside what is many times as large.
            lower.set_yscale("symlog", linthresh=2 * NORMAL_95, linscale=0.6)
            powers = 10.0 ** np.arange(1, np.log10(largest) + 0.3)
            lower.set_yticks([*-powers, 0, *powers], minor=False)
            lower.yaxis.set_major_formatter("{x:g}")
    lower.axhline(0, color=GREY, lw=0.6)
    upper.tick_params(labelbottom=False)


@printed
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
    if not rows:
        raise ValueError("there is nothing to draw of where the model fails")
    figure = Figure(figsize=(PAGE, 1.8 * len(rows) + 0.3))
    bands = figure.subfigures(len(rows), 1, squeeze=False)[:, 0]
    for band, row in zip(bands, rows, strict=True):
        places = band.subplots(
            1, len(row), squeeze=False, width_ratios=[panel.width for panel in row]
        )[0]
        for axes, panel in zip(places, row, strict=True):
            axes.set_title(panel.title, loc="left")
            panel.draw(axes)
            for text in axes.texts:  # for words inside a panel no room is made beside it
                text.set_in_layout(False)
    what = "the noise" if location.noise_known else "its typical level: the noise is unknown"
    figure.suptitle(
        f"Residual against {what}. Filled: significant "
        f"(false discovery rate {100 * location.level:g} %)"
    )
    return figure


def _rows(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Panels in rows of up to three columns, each in the first row that has room for it."""
    rows: list[list[Panel]] = []
    for panel in panels:
        room = [row for row in rows if _width(row) + panel.width <= _COLUMNS]
        if not room:
            rows.append([])
        (room or rows[-1:])[0].append(panel)
    return rows


def _width(row: Sequence[Panel]) -> int:
    return sum(panel.width for panel in row)


@printed
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
    if not shown:
        raise ValueError("there are no parts to compare")
    counts = [max(len(c.groups), 2.5) for c in shown]
    figure = Figure(figsize=(PAGE if sum(counts) > _FEW_PARTS else COLUMN, 5.2))
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
    panel.vlines(place, values - reach, values + reach, color=colour)
    panel.plot(place, values, "o", color=colour)
    panel.margins(x=0.12)
