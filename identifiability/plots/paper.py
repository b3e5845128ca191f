"""The figures of Kistemaker & Rozendaal (2011), drawn from our own computation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from identifiability.palette import BLACK, BLUE, GREEN, GREY, VERMILLION
from identifiability.plots.style import CYCLE, MAP, MARKERS, SECOND_MAP, letter, styled
from identifiability.study.paper import PanelFit, Surface, Valley
from identifiability.study.paper_record import RATIO, SINUSOID_K, approximations, relative_change

_SYMBOLS = {"K": "K [Nm/rad]", "B": "B [Nms/rad]", "I": "I [kg m²]"}


@styled()
def figure2(panels: Sequence[PanelFit]) -> Figure:
    """Responses of the joint and of KBI, and below each what KBI misses."""
    figure, axes = _four_panels()
    for (upper, lower), fit in zip(axes, panels, strict=True):
        K, B, inertia = fit.optimum.values
        found = f"K = {K:.3g},  B = {B:.3g},  I = {inertia:.3g}\nE* = {_power(fit.optimum.E)}"
        _panel(upper, lower, fit, [("KBI, fitted", fit.fitted)], found)
    return figure


@styled()
def figure7(panels: Sequence[PanelFit]) -> Figure:
    """Responses of KBI moved from its optimum along Eq. 15, either way."""
    figure, axes = _four_panels()
    for (upper, lower), fit in zip(axes, panels, strict=True):
        (K, B, _), (dK, dB, _) = fit.optimum.values, fit.optimum.change
        found = (
            f"+Δ:  K = {K + dK:.3g},  B = {B + dB:.3g}\n−Δ:  K = {K - dK:.3g},  B = {B - dB:.3g}"
        )
        names = ("KBI, optimum + Δ", "KBI, optimum − Δ")
        responses = list(zip(names, fit.changed, strict=True))
        _panel(upper, lower, fit, responses, found.replace("-", "−"))
    return figure


def _four_panels() -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """Four panels, each with a strip below it."""
    figure = Figure(figsize=(11, 9))
    grid = figure.subplots(4, 2, height_ratios=(3, 1, 3, 1))
    axes = [(grid[row, column], grid[row + 1, column]) for row in (0, 2) for column in (0, 1)]
    for (upper, lower), name in zip(axes, "ABCD", strict=True):
        lower.sharex(upper)
        upper.tick_params(labelbottom=False)
        upper.set_ylabel("angle [10⁻³ rad]")
        lower.set_ylabel("KBI − MSM\n[% of peak]")
        lower.set_xlabel("time [ms]")
        letter(upper, name)
    figure.align_ylabels()
    return figure, axes


def _panel(
    upper: Axes,
    lower: Axes,
    fit: PanelFit,
    responses: Sequence[tuple[str, np.ndarray]],
    found: str,
) -> None:
    """Draw responses above, their differences from the joint's below, the numbers in a corner."""
    time, reference, s = 1000 * fit.time, fit.reference, fit.panel.setting
    upper.plot(time, 1000 * reference, color=GREY, lw=5, alpha=0.5, label="MSM")
    lower.axhline(0, color=GREY, lw=0.8)
    styles = (("-", BLUE), ("--", VERMILLION))
    for (name, response), (style, color) in zip(responses, styles, strict=False):
        upper.plot(time, 1000 * response, style, color=color, label=name)
        difference = 100 * (response - reference) / np.max(np.abs(reference))
        lower.plot(time, difference, style, color=color)
    if fit.panel.letter == "A":
        upper.legend(loc="upper left")
    # A response that falls leaves the upper corner free, one that rises the lower corner.
    falls = reference[-1] < 0.5 * reference.max()
    low, high = upper.get_ylim()
    upper.set_ylim(low - (0 if falls else 0.15) * (high - low), high + 0.1 * (high - low))
    text = (
        f"MSM: {s.K_CE:g}, {s.B_CE:g}, {s.K_SE:g}, {s.I:g}\n"
        f"{fit.panel.perturbation.key}, T = {1000 * fit.panel.window:.0f} ms\n{found}"
    )
    upper.text(
        0.98,
        0.97 if falls else 0.04,
        text,
        transform=upper.transAxes,
        ha="right",
        va="top" if falls else "bottom",
        fontsize=10,
    )


def _power(value: float) -> str:
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"${mantissa}\\times10^{{{int(exponent)}}}$"


@styled()
def figure3(data: xr.Dataset) -> Figure:
    """Smallest error E* over the grid."""
    impulse = data.sel(perturbation="impulse", ratio=RATIO)
    figure = Figure(figsize=(12, 4.2))
    _maps(figure, impulse.E, "smallest error E*", cmap=SECOND_MAP)
    return figure


@styled()
def figure4(data: xr.Dataset) -> Figure:
    """Fitted stiffness, and the same in units of its slow limit."""
    return _estimates(data, "K")


@styled()
def figure5(data: xr.Dataset) -> Figure:
    """Fitted damping, and the same in units of its slow limit."""
    return _estimates(data, "B")


def _estimates(data: xr.Dataset, name: str) -> Figure:
    impulse = data.sel(perturbation="impulse", ratio=RATIO)
    slow = approximations(impulse)["LF"][name]
    figure = Figure(figsize=(12, 8))
    above, below = np.asarray(figure.subfigures(2, 1))
    _maps(above, impulse[name], f"fitted {_SYMBOLS[name]}")
    _maps(below, impulse[name] / slow, f"{name} / {name}$_\\mathrm{{LF}}$", cmap=SECOND_MAP)
    return figure


@styled()
def figure8(data: xr.Dataset) -> Figure:
    """Relative change of K for a rise of E by dE."""
    return _changes(data, "K")


@styled()
def figure9(data: xr.Dataset) -> Figure:
    """Relative change of B for a rise of E by dE."""
    return _changes(data, "B")


def _changes(data: xr.Dataset, name: str) -> Figure:
    impulse = data.sel(perturbation="impulse", ratio=RATIO)
    change = impulse[name].copy(data=100 * relative_change(impulse, name))
    figure = Figure(figsize=(12, 4.2))
    _maps(figure, change, f"|Δ{name}| / {name} [%]")
    return figure


@styled()
def grids(data: xr.Dataset, ratio: float) -> Figure:
    """E*, K and B over the grid for one ratio of K_SE to K_CE."""
    impulse = data.sel(perturbation="impulse", ratio=ratio)
    figure = Figure(figsize=(12, 12))
    parts = np.asarray(figure.subfigures(3, 1))
    _maps(parts[0], impulse.E, "smallest error E*", cmap=SECOND_MAP)
    _maps(parts[1], impulse.K, f"fitted {_SYMBOLS['K']}")
    _maps(parts[2], impulse.B, f"fitted {_SYMBOLS['B']}")
    figure.suptitle(f"$K_\\mathrm{{SE}}$ = {ratio:g} $K_\\mathrm{{CE}}$, impulse")
    return figure


def _maps(part: FigureBase, values: xr.DataArray, title: str, cmap: str = MAP) -> None:
    """One heat map a window over (K_CE, B_CE), one logarithmic colour scale for all of them."""
    finite = values.values[np.isfinite(values.values)]
    norm = LogNorm(finite.min(), finite.max())
    decades = np.log10(finite.max() / finite.min())
    # As many levels as can be told apart: a few a decade, or the decades alone.
    subs = (1, 1.5, 2, 3, 4, 5, 7) if decades < 1 else (1, 2, 5) if decades < 2.5 else (1,)
    powers = np.arange(np.floor(np.log10(finite.min())), np.ceil(np.log10(finite.max())))
    levels = np.sort(np.outer(10.0**powers, subs).ravel())
    axes = part.subplots(1, values.sizes["T"], sharex=True, sharey=True)
    for panel, T in zip(axes, values["T"].values, strict=True):
        shown = values.sel(T=T).transpose("B_CE", "K_CE")
        image = panel.pcolormesh(
            shown.K_CE, shown.B_CE, shown.values, norm=norm, cmap=cmap, shading="nearest"
        )
        inside = levels[(levels > np.nanmin(shown)) & (levels < np.nanmax(shown))]
        if inside.size:
            lines = panel.contour(
                shown.K_CE, shown.B_CE, shown.values, inside, colors="white", linewidths=1.2
            )
            for text in panel.clabel(lines, fmt=_level, fontsize=9, colors="white"):
                text.set_path_effects([withStroke(linewidth=2, foreground="#333333")])
        panel.set_title(f"T = {1000 * T:.0f} ms")
        panel.set_xlabel("$K_\\mathrm{CE}$ [Nm/rad]")
        panel.spines[["top", "right"]].set_visible(True)
    axes[0].set_ylabel("$B_\\mathrm{CE}$ [Nms/rad]")
    bar = part.colorbar(image, ax=axes, pad=0.01, label=title)
    if decades < 2.5:
        _plain_log(bar.ax.yaxis, subs)


def _level(level: float) -> str:
    return f"{level:g}" if 1e-3 < level < 1e4 else f"$10^{{{np.log10(level):.0f}}}$"


def _plain_log(axis: Axis, subs: Sequence[float]) -> None:
    """Ticks of a logarithmic axis at these multiples of the powers of ten, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=tuple(subs)))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())


@styled()
def figure6(surface: Surface, dE: float) -> Figure:
    """E about an optimum over K and B, with the contour of E* + dE, its ellipse and Eq. 15."""
    best, change = surface.optimum.values, surface.optimum.change
    figure = Figure(figsize=(12, 5.4))
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    norm = LogNorm(surface.optimum.E, float(np.max(surface.held)))
    inverse = np.linalg.inv(surface.hessian)
    shapes = (np.linalg.inv(surface.hessian[:2, :2]), inverse[:2, :2])
    titles = ("inertia held at its optimum", "inertia fitted anew at every point")
    values = (surface.held, surface.refitted)
    for panel, title, E, shape in zip(panels, titles, values, shapes, strict=True):
        image = panel.pcolormesh(surface.K, surface.B, E, norm=norm, cmap=MAP, shading="gouraud")
        panel.contour(
            surface.K, surface.B, E, [surface.optimum.E + dE], colors="white", linewidths=2.5
        )
        panel.plot([], [], color="white", lw=2.5, label="E = E* + ΔE")
        _ellipse(panel, best[:2], 2 * dE * shape)
        panel.plot(*best[:2], "+", color="white", ms=12, mew=2, label="optimum")
        ends = np.array([best[:2] - change[:2], best[:2] + change[:2]])
        panel.plot(*ends.T, "-", color=CYCLE[3], lw=2, marker="o", ms=5, label="± Δ of Eq. 15")
        panel.set_title(title)
        panel.set_xlabel(_SYMBOLS["K"])
    panels[0].set_ylabel(_SYMBOLS["B"])
    # On dark, where the white lines show.
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=4,
        labelcolor="white",
        frameon=True,
        facecolor="#333333",
        edgecolor="none",
    )
    figure.colorbar(image, ax=panels, pad=0.01, label="error E")
    s = surface.setting
    figure.suptitle(
        f"MSM {s.K_CE:g}, {s.B_CE:g}, {s.K_SE:g}, {s.I:g}; impulse, "
        f"T = {1000 * surface.window:.0f} ms; E* = {surface.optimum.E:.2g}, ΔE = {dE:g}"
    )
    return figure


def _ellipse(axes: Axes, centre: np.ndarray, shape: np.ndarray) -> None:
    """Contour of a quadratic form: points x with x' inverse(shape) x = 1 about the centre."""
    lengths, directions = np.linalg.eigh(shape)
    axes.add_patch(
        Ellipse(
            (centre[0], centre[1]),
            2 * np.sqrt(lengths[1]),
            2 * np.sqrt(lengths[0]),
            angle=np.degrees(np.arctan2(directions[1, 1], directions[0, 1])),
            fill=False,
            edgecolor=VERMILLION,
            ls="--",
            lw=2,
            label="its ellipse (Hessian)",
        )
    )


@styled()
def perturbations(data: xr.Dataset) -> Figure:
    """Medians and quartiles over the grid, by perturbation and window."""
    grid = data.sel(ratio=RATIO)
    slow = approximations(grid)["LF"]
    quantities = {
        "E*": grid.E,
        "K / K$_\\mathrm{LF}$": grid.K / slow.K,
        "B / B$_\\mathrm{LF}$": grid.B / slow.B,
        "I / I$_\\mathrm{MSM}$": grid.I / grid.attrs["I_MSM"],
        "|ΔK| / K [%]": grid.K.copy(data=100 * relative_change(grid, "K")),
        "|ΔB| / B [%]": grid.B.copy(data=100 * relative_change(grid, "B")),
    }
    figure = Figure(figsize=(12, 7.5))
    windows = grid["T"].values
    for panel, (title, values) in zip(figure.subplots(2, 3).flat, quantities.items(), strict=True):
        quartiles = values.quantile([0.25, 0.5, 0.75], dim=("K_CE", "B_CE"))
        for i, key in enumerate(grid.perturbation.values):
            low, middle, high = quartiles.sel(perturbation=key).values
            panel.errorbar(
                np.arange(len(windows)) + 0.14 * (i - 2),
                middle,
                [middle - low, high - middle],
                fmt=MARKERS[i],
                color=CYCLE[i],
                ms=7,
                label=str(key).replace("_", " "),
            )
        panel.set_xticks(np.arange(len(windows)), [f"{1000 * T:.0f}" for T in windows])
        panel.set_xlabel("T [ms]")
        panel.set_ylabel(title)
        if title == "E*":
            panel.set_yscale("log")
        elif title.startswith("|"):
            panel.set_yscale("log")
            _plain_log(panel.yaxis, (1, 3))
        else:
            panel.set_ylim(bottom=0)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


@styled()
def valley(profiles: Sequence[tuple[PanelFit, Valley]], dE: float) -> Figure:
    """Smallest E for every K: the valley in which the published K of Figure 2B lies."""
    figure = Figure(figsize=(11, 4.8))
    left, right = figure.subplots(1, 2)
    for (fit, found), color in zip(profiles, (GREEN, BLUE), strict=True):
        name = f"{fit.panel.letter}: {fit.panel.perturbation.key}"
        for panel, bounded, unbounded in (
            (left, found.E, found.E_unbounded),
            (right, found.B, found.B_unbounded),
        ):
            panel.plot(found.K, unbounded, "--", color=color, label=f"{name}, B of any sign")
            panel.plot(found.K, bounded, color=color, label=f"{name}, B ≥ 0")
        left.plot(fit.optimum.values[0], fit.optimum.E, "o", color=BLACK)
        right.plot(*fit.optimum.values[:2], "o", color=BLACK)
    for panel in (left, right):
        panel.axvline(SINUSOID_K, color=VERMILLION, ls=":")
        panel.set_xlabel(_SYMBOLS["K"])
    left.axhline(dE, color=GREY, lw=1)
    left.text(2, 1.15 * dE, f"ΔE = {dE:g}", color=GREY, va="bottom")
    left.set_yscale("log")
    left.set_ylabel("smallest E for this K")
    right.axhline(0, color=GREY, lw=1)
    right.set_ylabel("B that goes with it [Nms/rad]")
    right.text(SINUSOID_K + 2, 1.2, f"published\nK = {SINUSOID_K:g}", color=VERMILLION)
    right.legend(loc="lower left")
    return figure
