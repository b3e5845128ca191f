"""Figures of recordings: their cuts, a fit's overlay and residual, K, B, I against the window."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from identifiability.inference.recordings import RecordingFit
from identifiability.measurement.cutting import is_cut
from identifiability.measurement.trials import Trial, onsets
from identifiability.palette import BLACK, BLUE, GREY, SKY, VERMILLION
from identifiability.plots.style import LONGEST_SHOWN, PAGE, printed

_MOST_TRIALS, _TITLE = 4, 96  # letters of titles side by side
_MOST_CUTS = 8


@printed
def overlay_figure(result: RecordingFit) -> Figure:
    """Imposed signal, measured and fitted response, and residual, for up to four trials.

    Of a long record three seconds are shown, from its first perturbation on.
    """
    shown = result.prepared[:_MOST_TRIALS]
    figure = Figure(figsize=(PAGE, 4.4))
    axes = figure.subplots(
        3, len(shown), sharex="col", sharey="row", squeeze=False, height_ratios=(1, 2, 1)
    )
    for i, prepared in enumerate(shown):
        column, prediction = axes[:, i], result.predictions[i]
        torque_driven = prepared.trial.driven == "torque"
        first = max(0, prepared.onsets[0] - round(0.1 / prepared.interval))
        part = slice(first, first + round(LONGEST_SHOWN / prepared.interval) + 1)
        time = prepared.trial.time[part]
        imposed = prepared.drive.signals[part, 0]
        column[0].plot(time, imposed, color=GREY)
        response = prepared.response[part]
        column[1].plot(time, response, color=BLACK, lw=2.6, alpha=0.4, label="measured")
        column[1].plot(time, prediction[part], color=VERMILLION, label="fitted")
        column[2].plot(time, (prediction - prepared.response)[part], color=BLUE, lw=0.8)
        column[2].axhline(0, color=GREY, lw=0.6)
        column[0].set_title(fill(prepared.trial.name, _TITLE // len(shown)))
        column[2].set_xlabel("time [s]")
        if i == 0:
            imposed_name, response_name = ("torque [Nm]", "angle [rad]")
            if not torque_driven:
                imposed_name, response_name = response_name, imposed_name
            column[0].set_ylabel(f"imposed\n{imposed_name}")
            column[1].set_ylabel(f"response\n{response_name}")
            unit = response_name[response_name.index("[") :]
            column[2].set_ylabel(f"fit - measured\n{unit}")
            column[1].legend(loc="best")
    figure.align_ylabels(axes[:, 0])
    if more := len(result.prepared) - len(shown):
        figure.suptitle(f"{more} more trials are not shown")
    return figure


def cut_recordings(trials: Iterable[Trial]) -> list[list[Trial]]:
    """Trials that were cut from one recording (`cut_at_onsets`), in its order; by recording."""
    by_recording: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        if is_cut(trial):
            by_recording.setdefault((trial.source, trial.sha256), []).append(trial)
    return [sorted(found, key=lambda t: t.time[0]) for found in by_recording.values()]


@printed
def cuts_figure(trials: Sequence[Trial]) -> Figure:
    """Where a recording was cut: trials that follow each other, and their perturbations.

    Parameters
    ----------
    trials : sequence of Trial
        Of one recording, in its order, as `cut_at_onsets` gives them. The first eight are shown.
    """
    shown = trials[:_MOST_CUTS]
    figure = Figure(figsize=(PAGE, 2.8))
    upper, lower = figure.subplots(2, 1, sharex=True)
    channels = {"torque": "torque [Nm]", "angle": "angle [rad]"}
    imposed = shown[0].driven
    response = "angle" if imposed == "torque" else "torque"
    for number, trial in enumerate(shown):
        start, end = trial.time[0], trial.time[-1]
        for axes, channel in ((upper, imposed), (lower, response)):
            axes.plot(trial.time, getattr(trial, channel), color=BLACK, lw=0.9)
            axes.axvline(trial.time[onsets(trial)[0]], color=VERMILLION, lw=0.9, ls="--")
            if number % 2 == 0:
                axes.axvspan(start, end, color=SKY, alpha=0.25, lw=0)
        upper.annotate(
            str(number + 1),
            ((start + end) / 2, 1.0),
            xycoords=upper.get_xaxis_transform(),
            va="bottom",
            ha="center",
        )
    upper.set_ylabel(f"imposed\n{channels[imposed]}")
    lower.set_ylabel(f"response\n{channels[response]}")
    lower.set_xlabel("time [s]")
    lower.set_xlim(shown[0].time[0], shown[-1].time[-1])
    figure.align_ylabels([upper, lower])
    if more := len(trials) - len(shown):
        figure.suptitle(f"the first {len(shown)} trials; {more} more are not shown")
    return figure


@printed
def windows_figure(result: RecordingFit) -> Figure:
    """Fitted K, B and I against the window T, with 95 % posterior intervals."""
    rows = result.widths.rows
    parameters = result.problem.model.parameters
    lengths = [1000 * w.window for w in result.windows]
    figure = Figure(figsize=(PAGE, 2.1))
    axes = figure.subplots(1, len(rows), squeeze=False)
    for i, (panel, row) in enumerate(zip(axes[0], rows, strict=True)):
        inside = [w.widths.rows[i] for w in result.windows]
        centres = np.array([r.optimum for r in inside])
        ends = np.array([r.posterior_95 for r in inside]).T
        panel.axhspan(*row.posterior_95, color=GREY, alpha=0.25, lw=0)
        panel.axhline(row.optimum, color=GREY, lw=1.2, label="whole record")
        panel.vlines(lengths, ends[0], ends[1], color=BLUE, lw=1.8)
        panel.plot(lengths, centres, "o", color=BLUE, label="window, 95 % interval")
        panel.set_xlabel("window T [ms]")
        panel.set_ylabel(f"${parameters[row.name].symbol}$ [{row.unit}]")
        panel.set_xticks(lengths)
        panel.margins(x=0.15)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure
