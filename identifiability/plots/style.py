"""The one look of all figures, and the one way to save them."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from math import log10
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, NullFormatter, ScalarFormatter
from PIL import Image

from identifiability.files import replacing
from identifiability.numerals import power_of_ten
from identifiability.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

CYCLE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK)
MODEL_COLOURS = (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY)  # of models side by side
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

# Maps for quantities of one sign: `MAP` by default, `SECOND_MAP` where two quantities meet.
MAP, SECOND_MAP = "viridis", "cividis"

DPI, _DPI_SHOWN, _DPI_PRINTED = 130, 96, 300

# Widths [inch] that journals print figures in: 85 and 180 mm.
COLUMN, PAGE = 85 / 25.4, 180 / 25.4
PRINTED_AS = (".svg", ".pdf", ".png")

# Without the writer's version, or the date, the bytes depend on the figure alone.
_WRITER: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}

LONGEST_SHOWN = 3.0  # seconds of a record: of more, nothing could be made out

_STYLE: Any = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "legend.fontsize": 10,
    "figure.titlesize": 13,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.formatter.use_mathtext": True,
    "axes.formatter.limits": (-3, 5),
    "lines.linewidth": 1.8,
    "lines.markersize": 5,
    "image.cmap": MAP,
    "figure.constrained_layout.use": True,
    "text.hinting": "none",  # letters fitted to dots are wider at one resolution than at another
    "savefig.dpi": DPI,
    "svg.hashsalt": "identifiability",
    "pdf.fonttype": 42,  # letters that an editor of figures can edit
}

# No letter below 7 points, at the width that is printed.
_PRINT: Any = {
    "figure.dpi": 100,  # in notebooks
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
    "figure.titlesize": 8,
    "figure.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
}

P = ParamSpec("P")


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the package's style within a ``with`` block, then bring back the user's own."""
    with mpl.rc_context(_STYLE):
        yield


def printed(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Have a function draw its figure for print: `COLUMN` or `PAGE` wide, in small letters."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(_STYLE | _PRINT):
            figure = draw(*args, **kwargs)
            _label_by_text(figure)
            # Ticks are made while drawing, and others where the layout has changed the room for
            # them; after that it is kept, being what takes the longest.
            for _ in range(2):
                figure.draw_without_rendering()
            # None at all: with one that does nothing, every save would draw twice.
            with mpl.rc_context({"figure.constrained_layout.use": False}):
                figure.set_layout_engine(None)
        return figure

    return drawn


class _Numbers(ScalarFormatter):
    """Numbers of ticks whose common power of ten is text."""

    def get_offset(self) -> str:
        """Common power of ten, and what is added to all."""

        def as_text(found: re.Match[str]) -> str:
            power = power_of_ten(int(found[1].replace("−", "-") + found[2]))
            return power if found.start() else f"×{power}"

        return re.sub(r"(?<![\d.])1e([−-]?)(\d+)", as_text, super().get_offset())


def _label_by_text(figure: Figure) -> None:
    """Have no formulas at ticks: their numbers would take half the time of a figure."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            _as_text(axis)


def _as_text(axis: Axis) -> None:
    """Label an axis by text, unless it was given labels of its own."""
    formatter = axis.get_major_formatter()
    low, high = sorted(axis.get_view_interval())
    if type(formatter) is ScalarFormatter and axis.isDefault_majfmt:
        axis.set_major_formatter(_Numbers(useMathText=False))
    elif isinstance(formatter, LogFormatterSciNotation) and high >= 10 * low > 0:
        axis.set_major_formatter(lambda value, _: power_of_ten(round(log10(value))))
        axis.set_minor_formatter(NullFormatter())


def save(figure: Figure, path: Path | str, *, dpi: int = DPI) -> Path:
    """Write a figure; the file appears whole or not at all.

    Parameters
    ----------
    figure : Figure
    path : path
        Its suffix says the format; folders are made where they are missing.
    dpi : int
        Of what is stored in dots.

    Returns
    -------
    Path
    """
    path = Path(path)
    with replacing(path) as temporary:
        temporary.write_bytes(bytes_of(figure, path.suffix[1:], dpi=dpi))
    return path


def bytes_of(figure: Figure, kind: str, *, dpi: int = DPI) -> bytes:
    """Bytes of a figure's file.

    Parameters
    ----------
    figure : Figure
    kind : {"png", "svg", "pdf"}
    dpi : int
        Of what is stored in dots.
    """
    drawn = io.BytesIO()
    # Ticks are made while drawing, so the style is needed here too.
    with styled():
        _label_by_text(figure)
        figure.savefig(drawn, format=kind, dpi=dpi, metadata=_WRITER[kind])
    return drawn.getvalue()


def save_printed(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure in each format that journals ask for: see `PRINTED_AS`."""
    return [save(figure, folder / f"{name}{kind}", dpi=_DPI_PRINTED) for kind in PRINTED_AS]


def png_of(figure: Figure) -> bytes:
    """Bytes of a figure, as large as a notebook or a page shows it."""
    packed = io.BytesIO()
    drawn = Image.open(io.BytesIO(bytes_of(figure, "png", dpi=_DPI_SHOWN)))
    # Nothing shows through, so notebooks need not keep how much does.
    drawn.convert("RGB").save(packed, "png", optimize=True)
    return packed.getvalue()


def letter(axes: Axes, text: str) -> None:
    """Put a panel's letter above its upper left corner."""
    axes.set_title(text, loc="left", fontweight="bold")
