"""Maps of the atlas over stiffness and damping of the muscle."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
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
from identifiability.inference.widths import VERDICTS
from identifiability.palette import BLUE, GREY, ORANGE, SKY, VERMILLION, YELLOW
from identifiability.plots.corner import corner_figure
from identifiability.plots.style import DPI, MAP, styled
from identifiability.study.atlas import Corner, Plan
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

NO_RESULT = "no result"
_MISSING = "#D8D8D8"
COLOURS = dict(zip(VERDICTS, (BLUE, SKY, YELLOW, ORANGE, VERMILLION, GREY), strict=True)) | {
    NO_RESULT: _MISSING
}

_MOST_LABELLED = 8  # cells along an axis that still have room for a number
_LARGEST_RATIO = 10.0


def corner_plot(corner: Corner) -> Arrays:
    """Corner plot of a cell, as the bytes of a PNG file, with the cell's verdict and reason."""
    problem = corner.cell.problem()
    found = corner.cell.widths(problem)
    figure = corner_figure(found, problem.model, title=corner.caption)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return {
        "png": np.frombuffer(buffer.getvalue(), np.uint8),
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
) -> tuple[list[dict[str, str]], dict[str, Outcome]]:
    """Draw the corner plots of an atlas in worker processes, where they can fail without harm.

    Parameters
    ----------
    plan : Plan
    kept : Path
        Folder in which finished plots are kept, so that an interrupted run can go on.
    folder : Path
        For the figures.
    workers, executor
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
    )
    drawn = []
    for stem, outcome in outcomes.items():
        if outcome.arrays is None:
            continue
        path = folder / f"{stem}.png"
        with replacing(path) as temporary:
            temporary.write_bytes(outcome.arrays["png"].tobytes())
        drawn.append(
            {
                "file": path.name,
                "caption": corners[stem].caption,
                "verdict": str(outcome.arrays["verdict"]),
                "reason": str(outcome.arrays["reason"]),
            }
        )
    return drawn, outcomes


class Map(NamedTuple):
    """A figure of the atlas.

    Attributes
    ----------
    stem : str
        Name of its file, without suffix.
    caption : str
    draw : function
        Makes the figure.
    """

    stem: str
    caption: str
    draw: Callable[[], Figure]


def maps(data: xr.Dataset) -> Iterator[Map]:
    """All figures of an atlas: verdicts, ratios of widths, and optima, for each tendon and torque.

    Parameters
    ----------
    data : Dataset
        From `study.store`.
    """
    for perturbation in data["perturbation"].values.tolist():
        for ratio in data["ratio"].values.tolist():
            part = data.sel(perturbation=perturbation, ratio=ratio)
            torque = perturbation.replace("_", " ").capitalize()
            where = f"{torque}, K_SE = {ratio:g} K_CE"
            title = rf"{torque}, $K_{{SE}} = {ratio:g}\,K_{{CE}}$"
            suffix = f"{perturbation}_{ratio:g}"
            yield Map(
                f"verdict_{suffix}",
                f"{where}: does the quadratic width hold, and if not, why not.",
                lambda part=part, title=title: verdict_figure(part, title),  # type: ignore[misc]
            )
            for name in data["parameter"].values.tolist():
                yield Map(
                    f"ratio_{name}_{suffix}",
                    f"{where}: posterior standard deviation of {name}, divided by its quadratic "
                    "width (grey: no result, or a Hessian that gives no width).",
                    lambda part=part, title=title, name=name: ratio_figure(  # type: ignore[misc]
                        part, title, name
                    ),
                )
            yield Map(
                f"optimum_{suffix}",
                f"{where}: error E*, stiffness K and damping B at the optimum.",
                lambda part=part, title=title: optimum_figure(part, title),  # type: ignore[misc]
            )


@styled()
def verdict_figure(part: xr.Dataset, title: str) -> Figure:
    """Verdicts over (K_CE, B_CE), for each duration and reading.

    Parameters
    ----------
    part : Dataset
        One perturbation and ratio of the atlas.
    title : str
        Which, in words.
    """
    names = list(COLOURS)
    colours = ListedColormap(list(COLOURS.values()))
    norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
    figure, axes = _grid(part, part["reading"].size)
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
    figure.suptitle(f"Verdict on the quadratic widths\n{title}")
    return figure


@styled()
def ratio_figure(part: xr.Dataset, title: str, name: str) -> Figure:
    """Posterior over quadratic width of one parameter over (K_CE, B_CE).

    Parameters
    ----------
    part, title
        See `verdict_figure`.
    name : str
        Parameter.
    """
    part = part.sel(parameter=name)
    ratios = part["posterior_sd"] / part["quadratic"]
    finite = np.abs(np.log(ratios.values[np.isfinite(ratios.values) & (ratios.values > 0)]))
    most = float(np.clip(np.exp(finite.max(initial=0.0)), 1.25, _LARGEST_RATIO))
    norm = LogNorm(1 / most, most)
    figure, axes = _grid(part, part["reading"].size)
    images = [
        _image(
            panel,
            (cells["posterior_sd"] / cells["quadratic"]).values,
            norm,
            "PuOr_r",
            cells,
            number=lambda value: f"{value:.2f}",
        )
        for panel, cells in _panels(part, axes)
    ]
    bar = figure.colorbar(
        images[0],
        ax=axes,
        label="posterior sd / quadratic width",
        extend="both" if most == _LARGEST_RATIO else "neither",
        shrink=0.8,
    )
    steps = [0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1, 1.1, 1.25, 1.4, 2, 3, 5, 10]
    ticks = [t for t in steps if 1 / most <= t * 1.001 and t <= most * 1.001]
    if most > 2:
        ticks = [t for t in ticks if t not in (0.7, 0.8, 0.9, 1.1, 1.25, 1.4)]
    bar.ax.yaxis.set_major_locator(FixedLocator(ticks))
    _plain_ticks(bar)
    figure.suptitle(f"Width of {name}: posterior / quadratic\n{title}")
    return figure


@styled()
def optimum_figure(part: xr.Dataset, title: str) -> Figure:
    """E*, K and B at the optimum over (K_CE, B_CE), for each duration.

    The optimum of a noise-free response depends on the reading of the noise only where the noise
    is correlated; the first reading is drawn.

    Parameters
    ----------
    part, title
        See `verdict_figure`.
    """
    part = part.isel(reading=0)
    quantities = {
        "E*": part["E"],
        "K [Nm/rad]": part["optimum"].sel(parameter="K"),
        "B [Nms/rad]": part["optimum"].sel(parameter="B"),
    }
    figure, axes = _grid(part, len(quantities))
    for panel, T in zip(axes[0], part["T"].values, strict=True):
        panel.set_title(f"T = {1000 * T:g} ms")
    for row, (label, values) in zip(axes, quantities.items(), strict=True):
        positive = values.values[values.values > 0]
        largest = positive.max(initial=1e-12)
        # E* spans many decades; a B below a ten-thousandth of the largest is as good as zero.
        smallest = max(positive.min(initial=largest), largest * (0 if label == "E*" else 1e-4))
        norm = LogNorm(smallest, largest if largest > smallest else 2 * smallest)
        for panel, T in zip(row, part["T"].values, strict=True):
            image = _image(
                panel, values.sel(T=T).values, norm, MAP, part, number=_short, floor=smallest
            )
        below = "min" if np.any(values.values < smallest) else "neither"
        bar = figure.colorbar(image, ax=row.tolist(), label=label, extend=below, shrink=0.9)
        if label != "E*":
            bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            _plain_ticks(bar)
    figure.suptitle(f"Best fit of KBI\n{title}")
    return figure


def _grid(part: xr.Dataset, rows: int) -> tuple[Figure, np.ndarray]:
    columns = part["T"].size
    figure = Figure(figsize=(3.1 * columns + 1.6, 2.5 * rows + 1.3))
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for panel in axes[-1]:
        panel.set_xlabel(r"$K_{CE}$ [Nm/rad]")
    for panel in axes[:, 0]:
        panel.set_ylabel(r"$B_{CE}$ [Nms/rad]")
    return figure, axes


def _panels(part: xr.Dataset, axes: np.ndarray) -> Iterator[tuple[Axes, xr.Dataset]]:
    """Each panel with the cells that belong there: readings are rows, durations columns."""
    for panel, T in zip(axes[0], part["T"].values, strict=True):
        panel.set_title(f"T = {1000 * T:g} ms")
    for row, reading in zip(axes, part["reading"].values, strict=True):
        row[-1].annotate(
            f"{reading} noise",
            (1.03, 0.5),
            xycoords="axes fraction",
            rotation=270,
            va="center",
            fontsize=12,
        )
        for panel, T in zip(row, part["T"].values, strict=True):
            yield panel, part.sel(reading=reading, T=T)


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
    number: Callable[[float], str] | None = None,
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
        shown = np.arange(0, labels.size, -(-labels.size // 7))
        axis.set_ticks(shown, [f"{labels[i]:g}" for i in shown])
    for axis, n in ((panel.xaxis, values.shape[1]), (panel.yaxis, values.shape[0])):
        axis.set_ticks(np.arange(n + 1) - 0.5, minor=True)
    panel.grid(which="minor", color="white", linewidth=0.8)
    panel.tick_params(which="both", length=0)
    for spine in panel.spines.values():
        spine.set_visible(False)
    if number is not None and max(values.shape) <= _MOST_LABELLED:
        for (i, j), value in np.ndenumerate(values):
            if np.isfinite(value):
                red, green, blue, _ = image.cmap(norm(max(value, floor)))
                light = 0.299 * red + 0.587 * green + 0.114 * blue > 0.55
                panel.text(
                    j,
                    i,
                    number(value),
                    ha="center",
                    va="center",
                    fontsize=8.5,
                    color="black" if light else "white",
                )
    return image


def _short(value: float) -> str:
    if value == 0 or 0.001 <= value < 1e4:
        return f"{value:.2g}" if value < 100 else f"{value:.0f}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}".replace("-", "−")
