"""Figures of where a model fails: responses and residuals, the misfit's views, K, B, I by part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import NAMES, UNITS
from identifiability.investigation.split import Split
from identifiability.investigation.where.by_trial import TrialView
from identifiability.investigation.where.compare import Comparison, Constancy
from identifiability.investigation.where.imposed import starts
from identifiability.investigation.where.in_state import Curve
from identifiability.investigation.where.locate import Location
from identifiability.measurement.prepared import Prepared
from identifiability.plots.style import BLACK, BLUE, GREY, ORANGE, SKY, VERMILLION, styled

_MOST_TRIALS, _COLUMNS = 8, 4
_BEFORE, _LONGEST = 0.05, 3.0  # seconds before the first perturbation, and in all, that are shown
_MOST_LABELS = 12
_INTERVAL = 1.96  # standard errors of a 95 % interval
_UNITS = {"torque": "rad", "angle": "Nm"}  # of the response to it


def responses_figure(split: Split, before: Candidate, after: Candidate | None = None) -> Figure:
    """Measured and predicted responses of up to eight trials, and under each what is left.

    Where there are more, those are shown that the first model describes worst, each kind once
    before any kind twice. Of a long record three seconds are shown.

    Parameters
    ----------
    split : Split
    before, after : Candidate
        Models whose predictions are drawn.

    Returns
    -------
    Figure
    """
    trials = split.fitted
    shown = sorted(np.argsort(before.fitted.errors)[::-1][:_MOST_TRIALS].tolist())
    models = [(before, _title(before), VERMILLION)]
    if after is not None:
        models.append((after, _title(after), BLUE))
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
            _overlay(upper, lower, trials[i], [(m, m.fitted.by_trial[i], c) for m, _, c in models])
            upper.set_title(f"{trials[i].name}, E = {before.fitted.errors[i]:.2g}", fontsize=10)
            if after is not None:
                upper.set_title(
                    f"{trials[i].name}\nE = {before.fitted.errors[i]:.2g}, then "
                    f"{after.fitted.errors[i]:.2g}",
                    fontsize=10,
                )
            if column == 0:
                upper.set_ylabel("angle [rad]" if unit == "rad" else "torque [Nm]")
                lower.set_ylabel("residual /\nnoise" if in_noise else f"residual\n[{unit}]")
            lower.set_xlabel("time [s]")
        for place in range(len(shown), n_rows * n_columns):
            row, column = divmod(place, n_columns)
            axes[2 * row, column].set_visible(False)
            axes[2 * row + 1, column].set_visible(False)
        handles = [axes[0, 0].lines[k] for k in range(1 + len(models))]
        labels = ["measured", *(label for _, label, _ in models)]
        figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
        more = len(trials) - len(shown)
        if more:
            figure.supxlabel(
                f"{more} more trials, which are described better, are not shown", fontsize=10
            )
    return figure


def _overlay(
    upper: Axes, lower: Axes, ready: Prepared, models: Sequence[tuple[Candidate, np.ndarray, str]]
) -> None:
    interval = ready.drive.interval
    first = max(0, int(starts(ready)[0]) - round(_BEFORE / interval))
    part = slice(first, first + round(_LONGEST / interval) + 1)
    time = ready.trial.time[ready.first : ready.last][part]
    measured = ready.compared
    noise = ready.lead.sd if ready.lead.n_samples and ready.lead.sd > 0 else 1.0
    upper.plot(time, measured[part], color=BLACK, lw=3.0, alpha=0.55)
    for (_, left, colour), width in zip(models, (1.6, 1.2), strict=False):
        upper.plot(time, (measured - left)[part], color=colour, lw=width)
        lower.plot(time, (left / noise)[part], color=colour, lw=0.9)
    if noise != 1.0:
        lower.axhspan(-_INTERVAL, _INTERVAL, color=GREY, alpha=0.25, lw=0, zorder=0)
    lower.axhline(0, color=GREY, lw=0.8)
    upper.tick_params(labelbottom=False)


def _title(candidate: Candidate) -> str:
    return " + ".join(["K, B, I", *(key.replace("_", " ") for key in candidate.keys)])


def where_figure(location: Location) -> Figure:
    """One panel a view of where a model fails; what is significant is filled or marked.

    Parameters
    ----------
    location : Location

    Returns
    -------
    Figure
    """
    with styled():
        alone = max(len(location.trials.names), len(location.conditions.names)) < 2
        figure = Figure(figsize=(15.0, 8.0 if alone else 11.5))
        axes = figure.subplot_mosaic("TTTF;SVDA" if alone else "TTTF;SVDA;KKKC")
        _time(axes["T"], location)
        _frequency(axes["F"], location)
        state = location.state
        _state(axes["S"], state.angle, "angle [rad]", state.sentence)
        _state(axes["V"], state.velocity, "velocity [rad/s]", state.sentence)
        _direction(axes["D"], location)
        _amplitude(axes["A"], location)
        if not alone:
            known = location.noise_known
            _trials(axes["K"], location.trials, "by trial", known)
            _trials(axes["C"], location.conditions, "by kind of perturbation", known)
        what = "the noise" if location.noise_known else "its typical level: the noise is unknown"
        figure.suptitle(
            f"Where the model fails: residual against {what}. Filled: significant "
            f"(false discovery rate {100 * location.level:g} %)"
        )
    return figure


def _size(location: Location) -> str:
    return "residual / noise, r.m.s." if location.noise_known else "residual / typical, r.m.s."


def _empty(panel: Axes, title: str, sentence: str) -> None:
    """A view that is not possible, with its reason."""
    panel.set_title(title, loc="left")
    panel.set_axis_off()
    words, lines = sentence.split(), [""]
    for word in words:
        if len(lines[-1]) + len(word) > 38:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    panel.text(0.02, 0.9, "\n".join(lines), transform=panel.transAxes, va="top", color=GREY)


def _curve(panel: Axes, edges: np.ndarray, ratio: np.ndarray, colour: str, label: str) -> None:
    """Root mean square against the time since the perturbation."""
    panel.stairs(np.sqrt(ratio), 1000 * edges, color=colour, lw=1.8, label=label, baseline=None)


def _ready_for_ratios(panel: Axes, location: Location, largest: float) -> None:
    panel.axhline(1.0, color=GREY, lw=1.0, ls="--")
    if largest > 5:
        panel.set_yscale("log")
    else:
        panel.set_ylim(0, 1.15 * max(largest, 1.5))
    panel.set_ylabel(_size(location))
    panel.set_xlabel("time since the perturbation [ms]")


def _time(panel: Axes, location: Location) -> None:
    view = location.time
    panel.set_title("by time", loc="left")
    sizes = np.sqrt(view.ratio)
    _curve(panel, view.edges, view.ratio, BLUE, "")
    centres = 500 * (view.edges[:-1] + view.edges[1:])
    panel.plot(centres[view.flags], sizes[view.flags], "o", color=BLUE, ms=5)
    panel.plot(centres[~view.flags], sizes[~view.flags], "o", color=BLUE, ms=5, mfc="white")
    _ready_for_ratios(panel, location, float(sizes.max()))
    if view.latency:
        low, high = panel.get_ylim()
        panel.set_ylim(low, high * 2 if panel.get_yscale() == "log" else high)
        panel.axvline(1000 * view.latency, color=VERMILLION, lw=1.4)
        panel.annotate(
            f"K, B and I suffice until {1000 * view.latency:.0f} ms",
            (1000 * view.latency, 0.98),
            xycoords=("data", "axes fraction"),
            xytext=(5, 0),
            textcoords="offset points",
            color=VERMILLION,
            va="top",
        )


def _frequency(panel: Axes, location: Location) -> None:
    view = location.frequency
    if not (view.ratio.size if location.noise_known else np.isfinite(view.coherence).any()):
        _empty(panel, "by frequency", view.sentence)
        return
    panel.set_title("by frequency", loc="left")
    centres = np.sqrt(view.edges[:-1] * view.edges[1:])
    if location.noise_known:
        panel.stairs(view.ratio, view.edges, color=BLUE, baseline=None, lw=1.8)
        panel.plot(centres[~view.flags], view.ratio[~view.flags], "o", color=BLUE, mfc="white")
        panel.plot(centres[view.flags], view.ratio[view.flags], "o", color=BLUE)
        both = view.flags & view.coherent
        panel.plot(
            centres[both],
            view.ratio[both],
            "o",
            mfc="none",
            mec=VERMILLION,
            ms=11,
            mew=1.6,
            label=f"coherent with the {location.driven}",
        )
        panel.axhline(1.0, color=GREY, lw=1.0, ls="--")
        panel.set_yscale("log")
        panel.set_ylabel("residual / noise, power")
        if both.any():
            panel.legend(loc="upper right")
    else:
        panel.stairs(np.nan_to_num(view.coherence), view.edges, color=BLUE, lw=1.8, baseline=None)
        panel.plot(centres[view.coherent], view.coherence[view.coherent], "o", color=BLUE)
        panel.set_ylim(0, 1)
        panel.set_ylabel(f"coherence with the {location.driven}")
    panel.set_xscale("log")
    panel.set_xlabel("frequency [Hz]")


def _state(panel: Axes, curve: Curve | None, what: str, sentence: str) -> None:
    title = f"by {what.split()[0]}"
    if curve is None:
        _empty(panel, title, sentence)
        return
    panel.set_title(title, loc="left")
    panel.axhline(0, color=GREY, lw=0.8)
    panel.errorbar(
        curve.at, curve.torque, _INTERVAL * curve.errors, color=BLUE, lw=1.4, elinewidth=1.2
    )
    flags = curve.flags
    panel.plot(curve.at[~flags], curve.torque[~flags], "o", color=BLUE, mfc="white")
    panel.plot(curve.at[flags], curve.torque[flags], "o", color=BLUE)
    panel.set_xlabel(what)
    panel.set_ylabel("unexplained torque [Nm]")
    panel.annotate(
        f"explains {100 * curve.share:.0f} % of the misfit",
        (0.98, 0.98),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=9,
    )
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.15 * (high - low))


def _direction(panel: Axes, location: Location) -> None:
    view = location.direction
    if not view.pairs:
        _empty(panel, "by direction", view.sentence)
        return
    panel.set_title("by direction", loc="left")
    marks = {True: " (significant)", False: ""}
    even = f"keeps its sign{marks[view.even_significant]}"
    odd = f"turns its sign{marks[view.odd_significant]}"
    _curve(panel, view.edges, view.odd, BLUE, odd)
    _curve(panel, view.edges, view.even, ORANGE, even)
    largest = float(np.sqrt(max(view.even.max(), view.odd.max())))
    _ready_for_ratios(panel, location, largest)
    _legend(panel)


def _amplitude(panel: Axes, location: Location) -> None:
    view = location.amplitude
    if not view.pairs:
        _empty(panel, "by size", view.sentence)
        return
    panel.set_title("by size", loc="left")
    mark = " (significant)" if view.significant else ""
    _curve(panel, view.edges, view.ratio, BLUE, f"does not scale{mark}")
    _ready_for_ratios(panel, location, float(np.sqrt(view.ratio.max())))
    _legend(panel)


def _legend(panel: Axes) -> None:
    """Legend above the curves."""
    low, high = panel.get_ylim()
    panel.set_ylim(low, high * 4 if panel.get_yscale() == "log" else 1.3 * high)
    panel.legend(loc="upper right")


def _trials(panel: Axes, view: TrialView, title: str, known: bool) -> None:
    if len(view.names) < 2:
        _empty(panel, title, view.sentence)
        return
    panel.set_title(title, loc="left")
    place = np.arange(len(view.names))
    panel.set_xlim(-0.7, max(place.size, 4) - 0.3)
    ratio = np.sqrt(view.ratio)
    colours = [BLUE if flag else "none" for flag in view.flags]
    panel.bar(place, ratio, color=colours, edgecolor=BLUE, width=0.65)
    for x, y, error in zip(place, ratio, view.errors, strict=True):
        if len(place) <= _MOST_LABELS:
            panel.annotate(
                f"E {error:.1g}",
                (x, y),
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
    panel.axhline(1.0, color=GREY, lw=1.0, ls="--")
    if ratio.max() > 5:
        panel.set_yscale("log")
        panel.set_ylim(bottom=min(0.5, 0.8 * ratio.min()), top=2 * ratio.max())
    panel.set_ylabel("residual / noise, r.m.s." if known else "residual / others', r.m.s.")
    _label(panel, view.names)


def _label(panel: Axes, names: Sequence[str], turned: bool = False) -> None:
    """Names at the bottom, turned where they are long, thinned out where they are too many."""
    step = -(-len(names) // (2 * _MOST_LABELS))
    place = np.arange(0, len(names), step)
    long = turned or len(names) * max(len(name) for name in names) > 40
    panel.set_xticks(
        place,
        [names[k] for k in place.tolist()],
        rotation=40 if long else 0,
        ha="right" if long else "center",
        rotation_mode="anchor",
        fontsize=9,
    )


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
            figure = Figure(figsize=(6.0, 1.2))
            figure.text(0.5, 0.5, "There are no parts to compare.", ha="center", color=GREY)
            return figure
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
            _label(panel, [group.label for group in constancy.groups], turned=True)
        figure.align_ylabels(axes[:, 0])
        figure.suptitle(
            "A joint that is what the model says has one K, B and I in every part", fontsize=12
        )
    return figure


def _limits(comparison: Comparison, shown: Sequence[Constancy], i: int) -> tuple[float, float]:
    """Range of one parameter's axis; estimates that say next to nothing do not stretch it."""
    centre = float(comparison.overall.values[i])
    spread = _INTERVAL * float(comparison.overall.errors[i])
    spread = min(spread, 2 * abs(centre)) if np.isfinite(spread) else 0.0
    low, high = [centre - spread], [centre + spread]
    for constancy in shown:
        for group in constancy.groups:
            value, error = float(group.values[i]), _INTERVAL * float(group.errors[i])
            reach = min(error, 0.5 * abs(centre))
            if error < 2 * abs(centre):
                low.append(value - reach)
                high.append(value + reach)
    margin = 0.06 * max(max(high) - min(low), 0.02 * abs(centre))
    return min(low) - margin, max(high) + margin


def _estimates(panel: Axes, comparison: Comparison, constancy: Constancy, i: int) -> None:
    values = np.array([group.values[i] for group in constancy.groups])
    errors = np.array([group.errors[i] for group in constancy.groups])
    place = np.arange(values.size)
    colour = VERMILLION if constancy.significant else BLUE
    overall, spread = comparison.overall.values[i], _INTERVAL * comparison.overall.errors[i]
    panel.axhspan(overall - spread, overall + spread, color=SKY, alpha=0.3, lw=0)
    panel.axhline(overall, color=GREY, lw=1.0)
    reach = _INTERVAL * np.where(np.isfinite(errors), errors, 1e6)
    panel.vlines(place, values - reach, values + reach, color=colour, lw=1.8)
    panel.plot(place, values, "o", color=colour)
    panel.margins(x=0.12)
