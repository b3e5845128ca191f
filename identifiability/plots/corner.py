"""Corner plot: the posterior, the Hessian's ellipse, the profiles and the optimum in one figure."""

from __future__ import annotations

import textwrap
from collections.abc import Callable

import corner
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch

from identifiability.inference.problem import Problem
from identifiability.inference.widths import Widths
from identifiability.investigation.wording.values import width_in_words
from identifiability.palette import BLACK, BLUE, GREEN, GREY, VERMILLION
from identifiability.plots.style import PAGE, printed

# Mass inside 1 and 2 standard deviations of a two-dimensional Gaussian: 1 - exp(-r²/2).
LEVELS = (0.3935, 0.8647)
_SHADE = 0.35  # of what no parameter can be


@printed
def corner_figure(result: Widths, problem: Problem, *, title: str = "") -> Figure:
    """Draw the posterior of all parameters with everything it is compared to.

    Parameters
    ----------
    result : Widths
    problem : Problem
        That they are of: its bounds are shaded where they are near.
    title : str

    Returns
    -------
    Figure
        Contours and ellipse hold 39.3 % (and, contours only, 86.5 %) of their mass in two
        dimensions.
    """
    names, draws = result.names, result.posterior.flat
    parameters = problem.model.parameters
    labels = [f"${parameters[n].symbol}$ [{parameters[n].unit}]" for n in names]
    optimum, covariance = result.fit.values, result.curvature.covariance
    low, high = np.quantile(draws, [0.001, 0.999], axis=0)
    low, high = np.minimum(low, optimum), np.maximum(high, optimum)
    margin = 0.04 * (high - low)
    limits = list(zip(low - margin, high + margin, strict=True))
    k = len(names)
    # corner places its panels itself.
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        figure = Figure(figsize=(PAGE, PAGE))
    corner.corner(
        draws,
        fig=figure,
        range=limits,
        bins=50,
        levels=LEVELS,
        color=BLUE,
        smooth=1.0,
        plot_datapoints=False,
        fill_contours=True,
        no_fill_contours=False,
        labels=labels,
        max_n_ticks=4,
        labelpad=0.02,
        hist_kwargs={"density": True, "linewidth": 1.2},
    )
    axes = np.array(figure.axes).reshape(k, k)
    bounds = list(zip(problem.lower, problem.upper, strict=True))
    bounded = False
    for i in range(k):
        _marginal(axes[i, i], result, i)
        for panel in axes[i:, i]:
            bounded |= _shade(panel.axvspan, limits[i], bounds[i])
        for j in range(i):
            panel = axes[i, j]
            _shade(panel.axhspan, limits[i], bounds[i])
            panel.plot(optimum[j], optimum[i], "+", color=BLACK, markersize=8, mew=1.2)
            _ellipse(panel, optimum[[j, i]], covariance[np.ix_([j, i], [j, i])])
    figure.legend(
        handles=[
            Patch(facecolor=BLUE, alpha=0.5, label="posterior (39.3 % and 86.5 % in 2-D)"),
            Line2D([], [], color=VERMILLION, label="quadratic: Hessian (39.3 % in 2-D)"),
            Line2D([], [], color=GREEN, ls="--", label="profile likelihood"),
            Line2D([], [], color=BLACK, marker="+", ls=":", label="optimum"),
            *([Patch(facecolor=GREY, alpha=_SHADE, label="beyond a bound")] if bounded else []),
            *(
                Line2D([], [], ls="none", label=f"{r.name}: {width_in_words(r.verdict)}")
                for r in result.rows
            ),
        ],
        loc="upper right",
        bbox_to_anchor=(0.985, 0.985),
        title=textwrap.fill(title, 44) or None,
    )
    return figure


def _shade(
    span: Callable[..., object], limits: tuple[float, float], bounds: tuple[float, float]
) -> bool:
    """Shade what of an axis lies beyond a parameter's bounds; whether any does."""
    pairs = ((limits[0], bounds[0]), (bounds[1], limits[1]))
    beyond = [ends for ends in pairs if ends[0] < ends[1]]
    for ends in beyond:
        span(*ends, color=GREY, alpha=_SHADE, lw=0)
    return bool(beyond)


def _marginal(panel: object, result: Widths, i: int) -> None:
    """Profile likelihood and quadratic approximation over the posterior's histogram."""
    panel.autoscale(False)  # type: ignore[attr-defined]
    top = panel.get_ylim()[1] / 1.1  # type: ignore[attr-defined]
    low, high = panel.get_xlim()  # type: ignore[attr-defined]
    path = result.profiles[i]
    finite = np.isfinite(path.drops)
    x = np.linspace(max(low, path.values[0]), min(high, path.values[-1]), 300)
    drops = np.interp(x, path.values[finite], path.drops[finite])
    panel.plot(x, top * np.exp(-drops), "--", color=GREEN)  # type: ignore[attr-defined]
    row = result.rows[i]
    if np.isfinite(row.quadratic):
        x = np.linspace(low, high, 300)
        bell = np.exp(-0.5 * ((x - row.optimum) / row.quadratic) ** 2)
        panel.plot(x, top * bell, color=VERMILLION)  # type: ignore[attr-defined]
    panel.axvline(row.optimum, color=BLACK, ls=":", lw=1.0)  # type: ignore[attr-defined]


def _ellipse(panel: object, centre: np.ndarray, covariance: np.ndarray) -> None:
    """One-standard-deviation ellipse of a two-dimensional Gaussian."""
    if not np.all(np.isfinite(covariance)):
        return
    values, vectors = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    width, height = 2 * np.sqrt(values[::-1])
    ellipse = Ellipse(
        tuple(centre), width, height, angle=angle, fill=False, edgecolor=VERMILLION, lw=1.2
    )
    panel.add_patch(ellipse)  # type: ignore[attr-defined]
