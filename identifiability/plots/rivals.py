"""Figure of two models where they differ most."""

from __future__ import annotations

from matplotlib.figure import Figure

from identifiability.investigation.rivals import Rivals, left_of
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.palette import BLUE, GREY, VERMILLION
from identifiability.plots.style import styled


def rivals_figure(rivals: Rivals) -> Figure:
    """The trial in which two models differ most: measured, both predictions, and what each leaves.

    Parameters
    ----------
    rivals : Rivals

    Returns
    -------
    Figure
    """
    number, _ = rivals.most
    ready = rivals.trials[number]
    measured, time = ready.compared, ready.trial.time[ready.first : ready.last]
    unit = "rad" if rivals.split.driven == "torque" else "Nm"
    with styled():
        figure = Figure(figsize=(7.0, 4.6))
        upper, lower = figure.subplots(2, 1, height_ratios=[2.0, 1.4], sharex=True)
        upper.plot(time, measured, color=GREY, lw=3, label="measured")
        for one, colour in ((rivals.first, VERMILLION), (rivals.second, BLUE)):
            left = left_of(one)[number]
            name = model_in_words(one.keys)
            upper.plot(time, measured - left, color=colour, lw=1.4, label=name)
            lower.plot(time, left, color=colour, lw=1.0)
        for panel in (upper, lower):
            panel.axvline(rivals.time, color=GREY, lw=0.8, ls=":")
        lower.axhline(0, color=GREY, lw=0.8)
        upper.set_title(f"{ready.trial.name}: dotted, where the two differ most", fontsize=10)
        upper.set_ylabel("angle [rad]" if unit == "rad" else "torque [Nm]")
        lower.set_ylabel(f"residual [{unit}]")
        lower.set_xlabel("time [s]")
        upper.legend(fontsize=9)
    return figure
