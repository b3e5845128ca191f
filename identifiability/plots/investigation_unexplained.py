"""Figure of what a model leaves: the kinds of explanation, and the torque that is missing."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch

from identifiability.inference.curvature import NORMAL_95
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.unexplained.readouts import (
    MemoryKernel,
    MissingTorque,
    StaticMap,
)
from identifiability.palette import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from identifiability.plots.style import LONGEST_SHOWN, styled

_MOST_TRIALS, _MOST_FAMILIES = 4, 8
_LINE = 44  # letters of a family's name in one line
_COLOURS = {"sensor": ORANGE, "drift": ORANGE, "none": GREY, "unrepeatable": PURPLE}
_MEANINGS = {
    BLUE: "a function of the motion",
    ORANGE: "measurement",
    PURPLE: "differs by trial",
    GREY: "noise",
}


def unexplained_figure(rest: Unexplained) -> Figure:
    """Kinds of explanation by evidence, the missing torque with its band, and what it depends on.

    Parameters
    ----------
    rest : Unexplained

    Returns
    -------
    Figure
    """
    detail = rest.memory_kernel is not None or rest.static_map is not None
    with styled():
        figure = Figure(figsize=(11.0, 7.2))
        halves = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.25, 1.0))
        upper, lower = halves[:, 0]
        left, *right = np.atleast_1d(
            upper.subplots(1, 2 if detail else 1, width_ratios=(1.4, 1.0) if detail else None)
        )
        _families(left, rest)
        if rest.memory_kernel is not None:
            _kernel(right[0], rest.memory_kernel)
        elif rest.static_map is not None:
            _map(right[0], rest.static_map)
        _torques(lower, rest.torque)
    return figure


def _families(axes: Axes, rest: Unexplained) -> None:
    shown = rest.families[:_MOST_FAMILIES]
    heights = np.array([f.log_evidence for f in shown])
    colours = [_COLOURS.get(f.kind, BLUE) for f in shown]
    axes.barh(range(len(shown)), heights, color=colours, height=0.7)
    names = [f.name + (" + a rest" if f.remainder else "") for f in shown]
    axes.set_yticks(range(len(shown)), [fill(name, _LINE) for name in names], fontsize=8.5)
    axes.invert_yaxis()
    axes.axvline(0, color=GREY, lw=0.8)
    axes.axvline(heights[0] - rest.decisive, color=GREY, lw=1, ls="--")
    axes.set_xlabel(
        f"log evidence against noise alone [nats]; dashed: {rest.decisive:.0f} below the best"
    )
    axes.set_title("what kind of thing is left", loc="left", pad=24)
    axes.legend(
        handles=[Patch(color=c, label=words) for c, words in _MEANINGS.items() if c in colours],
        loc="lower left",
        bbox_to_anchor=(-0.02, 0.99),
        ncols=len(_MEANINGS),
        fontsize=9,
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
    axes.set_title("memory of the missing torque", loc="left")


def _map(axes: Axes, static: StaticMap) -> None:
    clear = np.where(np.abs(static.torque) > static.sd, static.torque, np.nan)
    shown = np.where(np.isfinite(clear), clear, 0.0)
    shown = np.where(np.isfinite(static.torque), shown, np.nan)
    most = float(np.nanmax(np.abs(shown))) or 1.0
    # The nodes are dense about rest, so they are drawn evenly and labelled with their values.
    image = axes.imshow(
        shown.T, origin="lower", aspect="auto", cmap="PuOr", norm=TwoSlopeNorm(0, -most, most)
    )
    for place, nodes in ((axes.set_xticks, static.angle), (axes.set_yticks, static.velocity)):
        at = np.unique(np.linspace(0, nodes.size - 1, 5).round().astype(int))
        place(at, [f"{nodes[i]:.2g}" for i in at])
    axes.figure.colorbar(image, ax=axes, label="torque [Nm]")
    axes.set_xlabel("angle [rad]")
    axes.set_ylabel("velocity [rad/s]")
    axes.set_title("missing torque by state", loc="left")


def _torques(figure: SubFigure, torques: Sequence[MissingTorque]) -> None:
    sizes = [float(np.max(np.abs(t.mean))) for t in torques]
    shown = sorted(np.argsort(sizes)[::-1][:_MOST_TRIALS].tolist())
    row = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, i in zip(row, shown, strict=True):
        t = torques[i]
        part = slice(0, int(np.searchsorted(t.time, t.time[0] + LONGEST_SHOWN)) + 1)
        time, mean, sd = t.time[part], t.mean[part], t.sd[part]
        axes.fill_between(
            time, mean - NORMAL_95 * sd, mean + NORMAL_95 * sd, color=VERMILLION, alpha=0.25, lw=0
        )
        axes.plot(time, mean, color=VERMILLION, lw=1.2)
        axes.axhline(0, color=GREY, lw=0.8)
        axes.set_title(t.trial, fontsize=10)
        axes.set_xlabel("time [s]")
    row[0].set_ylabel("missing torque [Nm], 95 %")
