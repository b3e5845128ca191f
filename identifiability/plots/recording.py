"""Figures of a fit to recordings: overlay and residual, and K, B, I against the window."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from identifiability.inference.recordings import RecordingFit
from identifiability.palette import BLACK, BLUE, GREY, VERMILLION
from identifiability.plots.style import LONGEST_SHOWN, styled

_MOST_TRIALS = 6


def overlay_figure(result: RecordingFit) -> Figure:
    """Imposed signal, measured and fitted response, and residual, for up to six trials.

    Of a long record three seconds are shown, from its first perturbation on.
    """
    shown = result.prepared[:_MOST_TRIALS]
    with styled():
        figure = Figure(figsize=(max(7.5, 3.4 * len(shown)), 7.2))
        axes = figure.subplots(
            3,
            len(shown),
            sharex="col",
            sharey="row",
            squeeze=False,
            height_ratios=(1, 2, 1),
        )
        for i, prepared in enumerate(shown):
            column, prediction = axes[:, i], result.predictions[i]
            torque_driven = prepared.trial.driven == "torque"
            first = max(0, prepared.onsets[0] - round(0.1 / prepared.interval))
            part = slice(first, first + round(LONGEST_SHOWN / prepared.interval) + 1)
            time = prepared.trial.time[part]
            imposed = prepared.drive.signals[part, 0]
            column[0].plot(time, imposed, color=GREY)
            column[1].plot(time, prepared.response[part], color=BLACK, lw=2.4, label="measured")
            column[1].plot(time, prediction[part], color=VERMILLION, lw=1.4, label="fitted")
            column[2].plot(time, (prediction - prepared.response)[part], color=BLUE)
            column[2].axhline(0, color=GREY, lw=0.8)
            column[0].set_title(prepared.trial.name if len(prepared.trial.name) < 30 else "")
            column[2].set_xlabel("time [s]")
            if i == 0:
                imposed_name, response = ("torque [Nm]", "angle [rad]")
                if not torque_driven:
                    imposed_name, response = response, imposed_name
                column[0].set_ylabel(f"imposed\n{imposed_name}")
                column[1].set_ylabel(f"response\n{response}")
                unit = response[response.index("[") :]
                column[2].set_ylabel(f"fit - measured\n{unit}")
                column[1].legend(loc="best")
        quality = result.goodness
        more = len(result.prepared) - len(shown)
        extra = f"; {more} more trials not shown" if more else ""
        figure.suptitle(f"E = {quality.error:.3g}, VAF = {quality.vaf:.2f} %{extra}")
    return figure


def windows_figure(result: RecordingFit) -> Figure:
    """Fitted K, B and I against the window T, with 95 % posterior intervals."""
    rows = result.widths.rows
    parameters = result.problem.model.parameters
    lengths = [1000 * w.window for w in result.windows]
    with styled():
        figure = Figure(figsize=(3.6 * len(rows), 3.8))
        axes = figure.subplots(1, len(rows), squeeze=False)
        for i, (panel, row) in enumerate(zip(axes[0], rows, strict=True)):
            inside = [w.widths.rows[i] for w in result.windows]
            centres = np.array([r.optimum for r in inside])
            ends = np.array([r.posterior_95 for r in inside]).T
            panel.axhspan(*row.posterior_95, color=GREY, alpha=0.25, lw=0)
            panel.axhline(row.optimum, color=GREY, lw=1.2, label="whole record")
            panel.vlines(lengths, ends[0], ends[1], color=BLUE, lw=2.2)
            panel.plot(lengths, centres, "o", color=BLUE, label="optimum, 95 % interval")
            panel.set_xlabel("window T [ms]")
            panel.set_ylabel(f"${parameters[row.name].symbol}$ [{row.unit}]")
            panel.set_xticks(lengths)
            panel.margins(x=0.15)
            panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
        axes[0, 0].legend(loc="best")
        figure.suptitle("A joint that is K, B and I has the same ones in every window")
    return figure
