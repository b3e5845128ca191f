"""A drawing of the joint: where each effect stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

from identifiability.joint.effects import Effect
from identifiability.palette import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION
from identifiability.plots.style import PAGE, printed

_HEIGHT = 2.75  # inches; all that is drawn is placed in inches, but for the margin
_WALL, _LIMB, _APPARATUS = 6.9, (2.75, 3.4), (0.15, 1.35)
_ABOVE, _BESIDE = 2.3, 0.72  # heights of muscle and tendon, and of what acts beside them
_COLUMN, _LINE = 1.4, 0.125  # inches
_COLOURS = {
    "series": BLUE,
    "muscle": VERMILLION,
    "joint": GREEN,
    "coupling": PURPLE,
    "sensor": ORANGE,
}


@printed
def joint_scheme_figure(effects: Mapping[str, type[Effect]]) -> Figure:
    """Apparatus, limb, muscle and tendon, each with the names of the effects that stand there.

    Parameters
    ----------
    effects : mapping of str to type of Effect
    """
    figure = Figure(figsize=(PAGE, _HEIGHT))
    axes = figure.subplots()
    axes.set(xlim=(0, PAGE), ylim=(0, _HEIGHT))
    axes.set_axis_off()
    names = {
        place: [k.replace("_", " ") for k, kind in effects.items() if kind.place == place]
        for place in _COLOURS
    }
    middle = 0.5 * (_ABOVE + _BESIDE)
    axes.add_patch(Rectangle((_WALL, 0.15), 0.08, 2.45, color=GREY))
    _box(axes, _APPARATUS, (middle - 0.35, middle + 0.35), BLACK, "apparatus:\nimposes, measures")
    _box(axes, _LIMB, (_BESIDE - 0.2, _ABOVE + 0.2), BLACK, "limb\n$I$")

    _spring(axes, _APPARATUS[1], _LIMB[0], middle, _COLOURS["coupling"])
    _named(axes, 2.05, middle - 0.15, "between them", names["coupling"])
    axes.plot([0.75, 0.75], [middle - 0.35, 0.78], color=_COLOURS["sensor"], ls=":")
    _named(axes, 0.75, 0.74, "in the recorder", names["sensor"])

    _spring(axes, _LIMB[1], 5.0, _ABOVE, _COLOURS["series"])
    _named(axes, 4.2, _ABOVE - 0.15, "in series", names["series"])
    _box(axes, (5.0, 6.5), (_ABOVE - 0.25, _ABOVE + 0.3), _COLOURS["muscle"], "muscle\n$K$, $B$")
    axes.plot([6.5, _WALL], [_ABOVE, _ABOVE], color=BLACK)
    _named(axes, 5.75, _ABOVE - 0.31, "in the muscle", names["muscle"])

    axes.plot([_LIMB[1], 3.65], [_BESIDE, _BESIDE], color=BLACK)
    axes.plot([6.65, _WALL], [_BESIDE, _BESIDE], color=BLACK)
    _box(axes, (3.65, 6.65), (_BESIDE - 0.58, _BESIDE + 0.42), _COLOURS["joint"], "")
    _named(axes, 5.15, _BESIDE + 0.4, "beside the muscle", names["joint"], 2)
    return figure


def _box(
    axes: Axes, across: tuple[float, float], up: tuple[float, float], colour: str, text: str
) -> None:
    size = across[1] - across[0], up[1] - up[0]
    style = "round,pad=0,rounding_size=0.06"
    axes.add_patch(
        FancyBboxPatch((across[0], up[0]), *size, boxstyle=style, fc="white", ec=colour, lw=1.2)
    )
    axes.text(0.5 * sum(across), 0.5 * sum(up), text, ha="center", va="center", linespacing=1.4)


def _spring(axes: Axes, start: float, stop: float, height: float, colour: str) -> None:
    """A spring between two bodies."""
    turns = np.tile([0.07, -0.07], 5)
    inner = np.linspace(0.3, 0.7, turns.size + 2)
    x = start + (stop - start) * np.concatenate([[0.0], inner, [1.0]])
    axes.plot(x, height + np.concatenate([[0, 0], turns, [0, 0]]), color=colour)


def _named(
    axes: Axes, x: float, top: float, place: str, names: Sequence[str], columns: int = 1
) -> None:
    """The effects of one place, below its name, in so many columns."""
    axes.text(x, top - 0.1, place, ha="center", fontweight="bold")
    for i, name in enumerate(names):
        row, column = divmod(i, columns)
        at = x + _COLUMN * (column - 0.5 * (columns - 1))
        axes.text(at, top - 0.1 - _LINE * (row + 1.1), name, ha="center", fontsize=7)
