"""Figures of what a model leaves: the torque that is missing, and the kinds of explanation."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch

from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.split import Split
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.unexplained.readouts import (
    MemoryKernel,
    MissingTorque,
    StaticMap,
)
from identifiability.palette import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from identifiability.plots.style import LONGEST_SHOWN, PAGE, printed

_MOST_TRIALS, _MOST_FAMILIES = 4, 8
_LINE = 44  # letters of a family's name in one line
_LINE_HEIGHT = 0.13  # inches
_COLOURS = {"sensor": ORANGE, "drift": ORANGE, "none": GREY, "unrepeatable": PURPLE}
_MEANINGS = {
    BLUE: "a function of the motion",
    ORANGE: "measurement",
    PURPLE: "differs by trial",
    GREY: "noise",
}


@printed
def missing_torque_figure(split: Split, rest: Unexplained) -> Figure:
    """The torque that is missing, by the state of the joint and in time.

    Parameters
    ----------
    split : Split
        The trials that `rest` is of.
    rest : Unexplained

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(PAGE, 2.7))
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.0, 1.25))[0]
    axes = left.subplots()
    if rest.static_map is not None:
        _map(axes, rest.static_map)
    else:
        _paths(axes, split, rest.torque)
    _torques(right, rest.torque, columns=2)
    return figure


@printed
def unexplained_figure(rest: Unexplained, *, with_torque: bool = True) -> Figure:
    """Kinds of explanation by evidence, what the missing torque depends on, and itself in time.

    Parameters
    ----------
    rest : Unexplained
    with_torque : bool
        Whether the torque is drawn in time, with its band.

    Returns
    -------
    Figure
    """
    detail = rest.memory_kernel is not None or rest.static_map is not None
    shown = rest.families[:_MOST_FAMILIES]
    names = [fill(f.name + (" + a rest" if f.remainder else ""), _LINE) for f in shown]
    lines = len(names) * max(name.count("\n") + 1 for name in names)
    heights = [max(2.3 if with_torque else 2.6, 0.9 + _LINE_HEIGHT * lines)]
    heights += [2.3] * with_torque
    figure = Figure(figsize=(PAGE, sum(heights)))
    halves = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    left, *right = np.atleast_1d(
        halves[0].subplots(1, 2 if detail else 1, width_ratios=(1.4, 1.0) if detail else None)
    )
    _families(left, rest, names)
    if rest.memory_kernel is not None:
        _kernel(right[0], rest.memory_kernel)
    elif rest.static_map is not None:
        _map(right[0], rest.static_map)
    if with_torque:
        _torques(halves[1], rest.torque, columns=_MOST_TRIALS)
    return figure


def _families(axes: Axes, rest: Unexplained, names: Sequence[str]) -> None:
    """The first kinds of explanation, by names that may take several lines."""
    shown = rest.families[: len(names)]
    powers = np.array([f.log_evidence for f in shown]) / np.log(10)
    colours = [_COLOURS.get(f.kind, BLUE) for f in shown]
    axes.barh(range(len(shown)), powers, color=colours, height=0.7)
    axes.set_yticks(range(len(shown)), names)
    axes.invert_yaxis()
    axes.axvline(0, color=GREY, lw=0.8)
    axes.axvline(powers[0] - rest.decisive / np.log(10), color=GREY, lw=0.8, ls="--")
    axes.set_xlabel("powers of ten by which it is more probable than noise")
    axes.legend(
        handles=[Patch(color=c, label=words) for c, words in _MEANINGS.items() if c in colours],
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.99),
        ncols=2,
    )


def _kernel(axes: Axes, kernel: MemoryKernel) -> None:
    lag = 1000 * kernel.lag
    axes.fill_between(
        lag,
        kernel.h - NORMAL_95 * kernel.sd,
        kernel.h + NORMAL_95 * kernel.sd,
        color=BLUE,
        alpha=0.25,
        lw=0,
    )
    axes.plot(lag, kernel.h, color=BLUE)
    axes.axhline(0, color=GREY, lw=0.8)
    axes.set_xlabel("time after a step of angle [ms]")
    axes.set_ylabel("torque / angle [Nm/rad], 95 %")
    axes.set_title("its memory", loc="left")


def _map(axes: Axes, static: StaticMap) -> None:
    clear = np.where(np.abs(static.torque) > static.sd, static.torque, np.nan)
    shown = np.where(np.isfinite(clear), clear, 0.0)
    shown = np.where(np.isfinite(static.torque), shown, np.nan)
    most = float(np.nanmax(np.abs(shown))) or 1.0
    # The nodes are dense about rest, so they are drawn evenly and labelled with their values.
    image = axes.imshow(
        shown.T, origin="lower", aspect="auto", cmap="PuOr", norm=TwoSlopeNorm(0, -most, most)
    )
    # Values side by side need more room than values one below the other.
    ticks = ((axes.set_xticks, static.angle, 3), (axes.set_yticks, static.velocity, 5))
    for place, nodes, most_ticks in ticks:
        at = np.unique(np.linspace(0, nodes.size - 1, most_ticks).round().astype(int))
        place(at, [f"{nodes[i]:.2g}" for i in at])
    axes.figure.colorbar(image, ax=axes, label="torque [Nm]")
    axes.set_xlabel("angle [rad]")
    axes.set_ylabel("velocity [rad/s]")
    axes.set_title("missing torque by state", loc="left")


def _paths(axes: Axes, split: Split, torques: Sequence[MissingTorque]) -> None:
    """Draw the torque along the way that the state takes, where no map of it is known."""
    angles = {r.name: r.trial for r in split.fitted}
    most = max(float(np.abs(t.mean).max()) for t in torques) or 1.0
    norm = TwoSlopeNorm(0, -most, most)
    for t in torques:
        trial = angles[t.trial]
        angle = np.interp(t.time, trial.time, trial.angle)
        ways = np.column_stack([angle, np.gradient(angle, t.time)])
        lines = LineCollection([*np.stack([ways[:-1], ways[1:]], axis=1)], cmap="PuOr", norm=norm)
        lines.set_array(t.mean[:-1])
        lines.set_linewidth(2.0)
        axes.add_collection(lines)
    axes.autoscale()
    axes.set_facecolor("0.85")
    axes.figure.colorbar(lines, ax=axes, label="torque [Nm]")
    axes.set_xlabel("angle [rad]")
    axes.set_ylabel("velocity [rad/s]")
    axes.set_title("missing torque by state", loc="left")


def _torques(figure: SubFigure, torques: Sequence[MissingTorque], *, columns: int) -> None:
    sizes = [float(np.max(np.abs(t.mean))) for t in torques]
    shown = sorted(np.argsort(sizes)[::-1][:_MOST_TRIALS].tolist())
    columns = min(columns, len(shown))
    rows = -(-len(shown) // columns)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, i in zip(grid.flat, shown, strict=False):
        t = torques[i]
        part = slice(0, int(np.searchsorted(t.time, t.time[0] + LONGEST_SHOWN)) + 1)
        time, mean, sd = t.time[part], t.mean[part], t.sd[part]
        axes.fill_between(
            time, mean - NORMAL_95 * sd, mean + NORMAL_95 * sd, color=VERMILLION, alpha=0.25, lw=0
        )
        axes.plot(time, mean, color=VERMILLION, lw=0.9)
        axes.axhline(0, color=GREY, lw=0.6)
        axes.set_title(t.trial)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    figure.supxlabel("time [s]")
    figure.supylabel("missing torque [Nm], 95 %")
