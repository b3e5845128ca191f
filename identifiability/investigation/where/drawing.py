"""What the panels of several views share; axes are handed in, so no plotter is imported."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from identifiability.palette import BLUE, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_LABELS = 12
"""Values that are written beside as many bars; twice as many names fit below them."""
_LOGARITHMIC = 5.0  # ratio from which an axis is
_LONG = 40  # letters of all names together from which they are turned


def curve(panel: Axes, edges: np.ndarray, ratio: np.ndarray, colour: str, label: str = "") -> None:
    """Draw the root of mean squares in bins of the time since the perturbation [s]."""
    panel.stairs(np.sqrt(ratio), 1000 * edges, color=colour, label=label, baseline=None)


def points(panel: Axes, x: np.ndarray, y: np.ndarray, flags: np.ndarray) -> None:
    """Draw points, filled where they are flagged."""
    panel.plot(x[flags], y[flags], "o", color=BLUE)
    panel.plot(x[~flags], y[~flags], "o", color=BLUE, mfc="white")


def unity(panel: Axes) -> None:
    """Draw the line at which the residual is as large as what it is judged by."""
    panel.axhline(1.0, color=GREY, lw=1.0, ls="--")


def is_logarithmic(largest: float) -> bool:
    """Whether ratios up to this one need a logarithmic axis."""
    return largest > _LOGARITHMIC


def logarithmic(panel: Axes) -> None:
    """Make the vertical axis logarithmic, with numbers at powers of ten alone."""
    panel.set_yscale("log")
    panel.yaxis.set_minor_formatter("")


def ratios(panel: Axes, largest: float) -> None:
    """Make the vertical axis ready for ratios up to this one."""
    if is_logarithmic(largest):
        logarithmic(panel)
    else:
        panel.set_ylim(0, 1.15 * max(largest, 1.5))


def ratios_by_time(panel: Axes, largest: float, noise_known: bool) -> None:
    """Make axes ready for ratios of sizes against the time since the perturbation."""
    unity(panel)
    ratios(panel, largest)
    panel.set_ylabel(f"residual / {'noise' if noise_known else 'typical'}, r.m.s.")
    panel.set_xlabel("time since the perturbation [ms]")


def room_above(panel: Axes, share: float) -> None:
    """Stretch the vertical axis upward by a share of its height."""
    low, high = panel.get_ylim()
    if panel.get_yscale() == "log":
        panel.set_ylim(low, high * (high / low) ** share)
    else:
        panel.set_ylim(low, high + share * (high - low))


def legend_above(panel: Axes) -> None:
    """Draw the legend above the curves."""
    rows = len(panel.get_legend_handles_labels()[1])
    room_above(panel, 0.05 + 0.2 * rows)
    panel.legend(loc="upper right")


def label_below(panel: Axes, names: Sequence[str], turned: bool = False) -> None:
    """Write names at the bottom, turned where they are long, thinned out where they are many."""
    step = -(-len(names) // (2 * MOST_LABELS))
    place = np.arange(0, len(names), step)
    long = turned or len(names) * max(len(name) for name in names) > _LONG
    panel.set_xticks(
        place,
        [names[k] for k in place.tolist()],
        rotation=40 if long else 0,
        ha="right" if long else "center",
        rotation_mode="anchor",
    )
