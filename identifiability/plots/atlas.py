"""Figures of the atlas: spread against predictions, and maps over the muscle's K and B."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from identifiability.files import replacing
from identifiability.inference.widths import VERDICTS, WIDTH_TOLERANCE, widths
from identifiability.palette import BLACK, BLUE, GREY, ORANGE, SKY, VERMILLION, YELLOW
from identifiability.plots.corner import corner_figure
from identifiability.plots.style import MAP, bytes_of, styled
from identifiability.study.atlas import Corner, Plan
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

NO_RESULT = "no result"
_MISSING = "#D8D8D8"
COLOURS = dict(zip(VERDICTS, (BLUE, SKY, YELLOW, ORANGE, VERMILLION, GREY), strict=True)) | {
    NO_RESULT: _MISSING
}

KINDS = ("png", "pdf")
SHOWN = KINDS[0]
"""Of these files of a figure, the one that the page shows."""

_LARGEST_RATIO = 10.0
_SAME_TENDON = 0.4  # share by which a drawn model's tendon may differ from a map's
PREDICTED = {"quadratic": "the quadratic width", "change": "the paper's Eq. 15"}
_AXES = {"quadratic": "quadratic width", "change": "Eq. 15"}


def corner_plot(corner: Corner) -> Arrays:
    """Corner plot of a cell, as the bytes of its files, with the cell's verdict and reason."""
    cell, problem = corner.cell, corner.cell.problem()
    # More draws than the widths of a cell take: here they are seen.
    found = widths(problem, starts=cell.setting.starts(), seed=cell.own_seed)
    figure = corner_figure(found, problem, title=corner.caption)
    return {
        **{kind: np.frombuffer(bytes_of(figure, kind), np.uint8) for kind in KINDS},
        "verdict": np.array(found.verdict),
        "reason": np.array(found.reason),
    }


def draw_corners(
    plan: Plan,
    kept: Path,
    *,
    folder: Path,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    retry_failed: bool = True,
) -> tuple[list[dict[str, str]], dict[str, Outcome]]:
    """Draw the corner plots of an atlas in worker processes, where they can fail without harm.

    Parameters
    ----------
    plan : Plan
    kept : Path
        Folder in which finished plots are kept, so that an interrupted run can go on.
    folder : Path
        For the figures.
    workers, executor, retry_failed
        See `sweep`.

    Returns
    -------
    drawn : list of dict
        ``file``, ``caption``, ``verdict`` and ``reason`` of each figure.
    outcomes : dict of str to Outcome
        By the figures' names without suffix.
    """
    corners = {corner.stem: corner for corner in plan.corners()}
    outcomes = sweep(
        corner_plot,
        corners,
        folder=kept,
        label="corner plots",
        workers=workers,
        executor=executor,
        progress=bool(corners),
        retry_failed=retry_failed,
    )
    drawn = []
    for stem, outcome in outcomes.items():
        if outcome.arrays is None:
            continue
        for kind in KINDS:
            with replacing(folder / f"{stem}.{kind}") as temporary:
                temporary.write_bytes(outcome.arrays[kind].tobytes())
        drawn.append(
            {
                "file": f"{stem}.{SHOWN}",
                "caption": corners[stem].caption,
                "verdict": str(outcome.arrays["verdict"]),
                "reason": str(outcome.arrays["reason"]),
            }
        )
    return drawn, outcomes


class Drawing(NamedTuple):
    """A figure of the atlas.

    Attributes
    ----------
    stem : str
        Name of its file, without suffix.
    kind : {"tracking", "tolerance", "map"}
    caption : str
    draw : function
        Makes the figure.
    """

    stem: str
    kind: str
    caption: str
    draw: Callable[[], Figure]


def drawings(data: xr.Dataset) -> Iterator[Drawing]:
    """All figures of an atlas: spread against predictions, tolerances, and maps.

    Parameters
    ----------
    data : Dataset
        From `study.store`.
    """
    for field, title in PREDICTED.items():
        yield Drawing(
            f"tracking_{field}",
            "tracking",
            f"Posterior standard deviation of every cell against {title}; on the line they are "
            "equal.",
            partial(tracking_figure, data, field),
        )
    yield Drawing(
        "tolerance",
        "tolerance",
        "Share of cells in which none of the three quadratic widths is off by more than a "
        "tolerance; the dotted line is the one of the verdicts. What lies below some 4 % is the "
        "sampler's own error.",
        partial(tolerance_figure, data),
    )
    for reading in data["reading"].values.tolist():
        part = data.sel(reading=reading)
        yield Drawing(
            f"verdict_{reading}",
            "map",
            f"{reading.capitalize()} noise: does the quadratic width hold, and if not, why not. "
            "Circles: models whose posteriors are drawn above. Single cells that stand out lie at "
            "a limit, on either side of which the sampler's own error may put them.",
            partial(verdict_figure, part),
        )
        for name in data["parameter"].values.tolist():
            yield Drawing(
                f"ratio_{name}_{reading}",
                "map",
                f"{reading.capitalize()} noise: posterior standard deviation of {name}, divided "
                "by its quadratic width (grey: no result, or a Hessian that gives no width).",
                partial(ratio_figure, part, name),
            )
    for perturbation in data["perturbation"].values.tolist():
        yield Drawing(
            f"optimum_{perturbation}",
            "map",
            f"{_words(perturbation)}: error E*, stiffness K and damping B at the optimum.",
            partial(optimum_figure, data.sel(perturbation=perturbation)),
        )


def _words(key: str) -> str:
    return key.replace("_", " ").capitalize()


@styled()
def tracking_figure(data: xr.Dataset, field: str) -> Figure:
    """Posterior sd against a prediction of it, a point a cell, by parameter and duration.

    Parameters
    ----------
    data : Dataset
        From `study.store`.
    field : str
        A key of `PREDICTED`.
    """
    names, durations = data["parameter"].values.tolist(), data["T"].values.tolist()
    figure = Figure(figsize=(3.1 * len(durations) + 0.9, 2.8 * len(names) + 0.9))
    axes = figure.subplots(len(names), len(durations), squeeze=False, sharex="row", sharey="row")
    readings = data["reading"].values.tolist()
    for row, name in zip(axes, names, strict=True):
        unit = data["unit"].sel(parameter=name).item()
        for panel, T in zip(row, durations, strict=True):
            cells = data.sel(parameter=name, T=T)
            for reading, colour in zip(readings, (VERMILLION, BLUE), strict=False):
                x, y = (
                    cells[f].sel(reading=reading).values.ravel() for f in (field, "posterior_sd")
                )
                shown = (x > 0) & (y > 0) & np.isfinite(x)
                panel.loglog(
                    x[shown],
                    y[shown],
                    ".",
                    ms=2.5,
                    alpha=0.5,
                    color=colour,
                    label=f"{reading} noise",
                    rasterized=True,
                )
            if name == names[0]:
                panel.set_title(f"T = {1000 * T:g} ms")
        # The panels of a row share their limits, which are known once all are drawn.
        limits = row[0].get_xlim(), row[0].get_ylim()
        for panel in row:
            panel.axline((1e-3, 1e-3), (1.0, 1.0), color=BLACK, lw=0.9)
            panel.set(xlim=limits[0], ylim=limits[1])
        row[0].set_ylabel(f"posterior sd of {name} [{unit}]")
        for panel in row:
            panel.set_xlabel(f"{_AXES[field]} of {name} [{unit}]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, markerscale=4)
    return figure


@styled()
def tolerance_figure(data: xr.Dataset) -> Figure:
    """Share of cells in which the widths hold, against what is called holding.

    Parameters
    ----------
    data : Dataset
        From `study.store`.
    """
    figure = Figure(figsize=(7.2, 4.2))
    panel = figure.subplots()
    styles = ("-", "--")
    colours = (VERMILLION, ORANGE, BLUE, SKY, GREY)
    worst = abs(data["posterior_sd"] / data["quadratic"] - 1).max("parameter", skipna=False)
    for reading, style in zip(data["reading"].values.tolist(), styles, strict=False):
        for T, colour in zip(data["T"].values.tolist(), colours, strict=False):
            part = data.sel(reading=reading, T=T)["status"].values == "done"
            values = worst.sel(reading=reading, T=T).values[part]
            off = np.sort(np.where(np.isfinite(values), values, np.inf))
            if not off.size:
                continue
            shares = np.arange(1, off.size + 1) / off.size
            label = f"{1000 * T:g} ms, {reading}"
            panel.step(off, 100 * shares, style, where="post", color=colour, label=label)
    panel.axvline(WIDTH_TOLERANCE, color=BLACK, lw=1, ls=":")
    panel.set(
        xscale="log",
        xlim=(0.01, 2.0),
        ylim=(0, 101),
        xlabel="largest relative error of a quadratic width",
        ylabel="cells [%]",
    )
    panel.set_xticks([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2])
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g} %"))
    panel.xaxis.set_minor_locator(NullLocator())
    if panel.get_lines()[1:]:
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled()
def verdict_figure(part: xr.Dataset) -> Figure:
    """Verdicts over (K_CE, B_CE), for each perturbation, tendon and duration.

    Parameters
    ----------
    part : Dataset
        One reading of the atlas.
    """
    names = list(COLOURS)
    colours = ListedColormap(list(COLOURS.values()))
    norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
    figure, axes = _grid(part)
    present = set()
    for panel, cells in _panels(part, axes):
        words = np.where(cells["status"] == "done", cells["verdict"], NO_RESULT)
        present |= set(words.ravel().tolist())
        _image(panel, np.vectorize(names.index)(words).astype(float), norm, colours, cells)
    figure.legend(
        handles=[
            Patch(facecolor=COLOURS[name], edgecolor=GREY, label=name)
            for name in names
            if name in present
        ],
        loc="outside lower center",
        ncols=len(present),
    )
    return figure


@styled()
def ratio_figure(part: xr.Dataset, name: str) -> Figure:
    """Posterior over quadratic width of one parameter over (K_CE, B_CE).

    Parameters
    ----------
    part : Dataset
        See `verdict_figure`.
    name : str
        Parameter.
    """
    part = part.sel(parameter=name)
    ratios = part["posterior_sd"] / part["quadratic"]
    finite = np.abs(np.log(ratios.values[np.isfinite(ratios.values) & (ratios.values > 0)]))
    # Nearly all of the cells, so that the few that are furthest off do not bleach the rest.
    far = np.quantile(finite, 0.98) if finite.size else 0.0
    most = float(np.clip(np.exp(far), 1.25, _LARGEST_RATIO))
    norm = LogNorm(1 / most, most)
    figure, axes = _grid(part)
    images = [
        _image(panel, (cells["posterior_sd"] / cells["quadratic"]).values, norm, "PuOr_r", cells)
        for panel, cells in _panels(part, axes)
    ]
    bar = figure.colorbar(
        images[0],
        ax=axes,
        label=f"posterior sd / quadratic width of {name}",
        extend="both",
        shrink=0.8,
    )
    steps = [0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1, 1.1, 1.25, 1.4, 2, 3, 5, 10]
    ticks = [t for t in steps if 1 / most <= t * 1.001 and t <= most * 1.001]
    if most > 2:
        ticks = [t for t in ticks if t not in (0.7, 0.8, 0.9, 1.1, 1.25, 1.4)]
    bar.ax.yaxis.set_major_locator(FixedLocator(ticks))
    _plain_ticks(bar)
    return figure


@styled()
def optimum_figure(part: xr.Dataset) -> Figure:
    """E*, K and B at the optimum over (K_CE, B_CE), for each tendon and duration.

    The optimum of a noise-free response depends on the reading of the noise only where the noise
    is correlated; the first reading is drawn.

    Parameters
    ----------
    part : Dataset
        One perturbation of the atlas.
    """
    part = part.isel(reading=0)
    quantities = {
        "E*": part["E"],
        "K [Nm/rad]": part["optimum"].sel(parameter="K"),
        "B [Nms/rad]": part["optimum"].sel(parameter="B"),
    }
    figure, axes = _grid(part, len(quantities))
    for row, (label, values) in zip(axes, quantities.items(), strict=True):
        positive = values.values[values.values > 0]
        largest = positive.max(initial=1e-12)
        # E* spans many decades; a B below a ten-thousandth of the largest is as good as zero.
        smallest = max(positive.min(initial=largest), largest * (0 if label == "E*" else 1e-4))
        norm = LogNorm(smallest, largest if largest > smallest else 2 * smallest)
        for panel, place in zip(row, _columns(part), strict=True):
            cells = part.sel(place)
            image = _image(panel, values.sel(place).values, norm, MAP, cells, floor=smallest)
        below = "min" if np.any(values.values < smallest) else "neither"
        bar = figure.colorbar(image, ax=row.tolist(), label=label, extend=below, shrink=0.9)
        if label != "E*":
            bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            _plain_ticks(bar)
    return figure


def _columns(part: xr.Dataset) -> list[dict[str, float]]:
    """Tendon and duration of each column of panels."""
    return [
        {"ratio": ratio, "T": T}
        for ratio in part["ratio"].values.tolist()
        for T in part["T"].values.tolist()
    ]


def _grid(part: xr.Dataset, rows: int | None = None) -> tuple[Figure, np.ndarray]:
    columns = _columns(part)
    n_rows = part["perturbation"].size if rows is None else rows
    figure = Figure(figsize=(1.75 * len(columns) + 2.0, 1.7 * n_rows + 1.2))
    axes = figure.subplots(n_rows, len(columns), squeeze=False, sharex=True, sharey=True)
    for panel, place in zip(axes[0], columns, strict=True):
        tendon = rf"$K_{{SE}} = {place['ratio']:g}\,K_{{CE}}$"
        panel.set_title(f"{tendon}\n{1000 * place['T']:g} ms", fontsize=11)
    for panel in axes[-1]:
        panel.set_xlabel(r"$K_{CE}$ [Nm/rad]")
    for panel in axes[:, 0]:
        panel.set_ylabel(r"$B_{CE}$ [Nms/rad]")
    return figure, axes


def _panels(part: xr.Dataset, axes: np.ndarray) -> Iterator[tuple[Axes, xr.Dataset]]:
    """Each panel with the cells that belong there: a row a perturbation."""
    for row, perturbation in zip(axes, part["perturbation"].values.tolist(), strict=True):
        row[-1].annotate(
            _words(perturbation).replace(" ", "\n", 1),
            (1.06, 0.5),
            xycoords="axes fraction",
            rotation=270,
            ha="left",
            va="center",
            fontsize=11,
        )
        for panel, place in zip(row, _columns(part), strict=True):
            yield panel, part.sel({"perturbation": perturbation, **place})


def _plain_ticks(bar: Colorbar) -> None:
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _image(
    panel: Axes,
    values: np.ndarray,
    norm: Normalize,
    colours: Colormap | str,
    cells: xr.Dataset,
    *,
    floor: float = 0.0,
) -> AxesImage:
    """Draw values of shape (K_CE, B_CE), one square a cell whatever the steps of the grid."""
    values = values.T
    panel.set_facecolor(_MISSING)
    image = panel.imshow(
        np.ma.masked_invalid(np.maximum(values, floor)),
        norm=norm,
        cmap=colours,
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    for axis, name in ((panel.xaxis, "K_CE"), (panel.yaxis, "B_CE")):
        labels = cells[name].values
        shown = np.unique(np.linspace(0, labels.size - 1, 4).round().astype(int))
        axis.set_ticks(shown, [f"{labels[i]:g}" for i in shown])
    for axis, n in ((panel.xaxis, values.shape[1]), (panel.yaxis, values.shape[0])):
        axis.set_ticks(np.arange(n + 1) - 0.5, minor=True)
    panel.grid(which="minor", color="white", linewidth=0.3)
    panel.tick_params(which="both", length=0)
    for spine in panel.spines.values():
        spine.set_visible(False)
    for K_CE, B_CE, K_SE, _ in json.loads(cells.attrs["plan"])["corner"]:
        if abs(float(cells["ratio"]) * K_CE / K_SE - 1) > _SAME_TENDON:
            continue
        at = (
            np.interp(value, cells[name].values, np.arange(cells[name].size))
            for value, name in ((K_CE, "K_CE"), (B_CE, "B_CE"))
        )
        where = tuple(at)
        panel.plot(*where, "o", ms=6, mfc="none", mec="white", mew=2.6)
        panel.plot(*where, "o", ms=6, mfc="none", mec=BLACK, mew=1.1)
    return image
