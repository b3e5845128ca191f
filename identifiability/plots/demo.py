"""The demo in one picture: a good fit of a wrong model, and what mends it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identifiability.inference.recordings import RecordingFit
from identifiability.investigation.findings import Findings
from identifiability.palette import BLACK, BLUE, GREEN, GREY, VERMILLION
from identifiability.plots.style import letter, styled


def demo_figure(recording: RecordingFit, findings: Findings, stiffness: float) -> Figure:
    """Held-out trial and what is left of it, the stiffness by every fit, and the error.

    Parameters
    ----------
    recording : RecordingFit
        K, B and I of the trials, by window.
    findings : Findings
        What they miss.
    stiffness : float
        The joint's own [Nm/rad].
    """
    with styled():
        figure = Figure(figsize=(11.0, 4.3))
        ((left, middle, right),) = figure.subfigures(
            1, 3, squeeze=False, width_ratios=(1.25, 1.15, 0.85)
        )
        upper, lower = left.subplots(2, 1, sharex=True, height_ratios=(1.5, 1))
        _held_out(upper, lower, findings)
        _stiffness(middle.subplots(), recording, findings, stiffness)
        _error(right.subplots(), findings)
    return figure


def _held_out(upper: Axes, lower: Axes, findings: Findings) -> None:
    trial, found = findings.split.held_out[0], findings.found
    chosen = slice(trial.first, trial.last)
    time, measured = 1000 * trial.trial.time[chosen], trial.response[chosen]
    upper.plot(time, measured, color=BLACK, lw=3, label="measured")
    for model, label, colour, line in (
        (found.baseline, "K, B, I", VERMILLION, "-"),
        (found.final, "with a tendon", BLUE, "--"),
    ):
        left = model.held_out.by_trial[0]
        upper.plot(time, measured - left, color=colour, ls=line, label=label)
        lower.plot(time, 1e3 * left, color=colour, lw=1.2)
    upper.set_ylabel("angle [rad]")
    upper.legend(fontsize=9)
    upper.set_title("a trial that was not fitted", fontsize=11)
    letter(upper, "a")
    lower.set_ylabel("left [mrad]")
    lower.set_xlabel("time [ms]")


def _stiffness(axes: Axes, recording: RecordingFit, findings: Findings, stiffness: float) -> None:
    fits = [(f"{1000 * w.window:g} ms", w.widths["K"]) for w in recording.windows]
    rows = [(name, r.optimum, r.posterior_sd, VERMILLION) for name, r in fits]
    rows.append(("whole\nrecord", recording.least_squares["K"], 0.0, VERMILLION))
    assert findings.widths is not None
    last = findings.widths["K"]
    rows.append(("with a\ntendon", last.optimum, last.posterior_sd, BLUE))
    for place, (_, value, sd, colour) in enumerate(rows):
        axes.errorbar(place, value, 1.96 * sd, fmt="o", color=colour, capsize=3, lw=1.8)
    axes.axhline(stiffness, color=GREEN, lw=1.5)
    axes.annotate(
        "the muscle's own",
        (2.3, stiffness),
        xytext=(0, 5),
        textcoords="offset points",
        color=GREEN,
        fontsize=9,
    )
    axes.set_xticks(range(len(rows)), [name for name, *_ in rows], fontsize=9)
    axes.set_ylabel("K, 95 % interval [Nm/rad]")
    axes.set_ylim(bottom=0)
    axes.margins(x=0.1)
    axes.set_title("stiffness, by what was fitted", fontsize=11)
    letter(axes, "b")


def _error(axes: Axes, findings: Findings) -> None:
    found, floor = findings.found, findings.split.noise_floor(findings.split.held_out)
    errors = [rung.held_out.error for rung in found.ladder]
    axes.plot(range(len(errors)), errors, color=GREY, lw=1.2, zorder=1)
    axes.scatter(range(len(errors)), errors, color=[VERMILLION, BLUE], s=45, zorder=2)
    if floor is not None:
        axes.axhline(floor, color=GREEN, lw=1.5)
        axes.annotate(
            "noise alone",
            (0.0, floor),
            xytext=(0, 5),
            textcoords="offset points",
            color=GREEN,
            fontsize=9,
        )
    axes.set_yscale("log")
    axes.set_xticks(range(len(errors)), ["K, B, I", "with a\ntendon"], fontsize=9)
    axes.set_ylim(0.5 * min([*errors, floor or np.inf]), 2 * max(errors))
    axes.set_ylabel("error E, not fitted")
    axes.margins(x=0.3)
    axes.set_title("error", fontsize=11)
    letter(axes, "c")
