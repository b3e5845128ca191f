"""Figure of two models where they differ most."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from identifiability.investigation.rivals import Rivals, left_of
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.palette import BLACK, BLUE, GREEN, GREY
from identifiability.plots.style import LONGEST_SHOWN, PAGE, printed

_AROUND = 0.04  # seconds before and after the time at which two models differ most


@printed
def rivals_figure(rivals: Rivals) -> Figure:
    """The trial in which two models differ most: measured, both predictions, and what each leaves.

    On the right the same about the time at which they differ most.

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
    spans = (0.5 * LONGEST_SHOWN, _AROUND)
    figure = Figure(figsize=(PAGE, 3.3))
    axes = figure.subplots(2, 2, height_ratios=[2.0, 1.4], sharex="col")
    for (upper, lower), around in zip(axes.T, spans, strict=True):
        part = np.abs(time - rivals.time) <= around
        upper.plot(time[part], measured[part], color=BLACK, lw=2.6, alpha=0.4, label="measured")
        for one, colour, line in ((rivals.first, BLUE, "-"), (rivals.second, GREEN, "--")):
            left = left_of(one)[number][part]
            name = model_in_words(one.keys)
            upper.plot(time[part], measured[part] - left, color=colour, ls=line, label=name)
            lower.plot(time[part], left, color=colour, lw=0.8)
        for panel in (upper, lower):
            panel.axvline(rivals.time, color=GREY, lw=0.8, ls=":")
        lower.axhline(0, color=GREY, lw=0.6)
        lower.set_xlabel("time [s]")
    axes[0, 0].set_title(ready.trial.name, loc="left")
    axes[0, 1].set_title("where the two differ most", loc="left")
    axes[0, 0].set_ylabel("angle [rad]" if unit == "rad" else "torque [Nm]")
    axes[1, 0].set_ylabel(f"residual [{unit}]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=1 if _long(labels) else 3)
    return figure


def _long(labels: list[str]) -> bool:
    """Whether labels do not fit side by side."""
    return sum(map(len, labels)) > 90
