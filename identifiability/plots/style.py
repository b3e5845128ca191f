"""The one look of all figures, and the one way to save them."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identifiability.files import replacing
from identifiability.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

CYCLE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

# Maps for quantities of one sign: `MAP` by default, `SECOND_MAP` where two quantities meet.
MAP, SECOND_MAP = "viridis", "cividis"

DPI, _DPI_SHOWN = 130, 80

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
    "savefig.dpi": DPI,
    "svg.hashsalt": "identifiability",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the package's style within a ``with`` block, then bring back the user's own."""
    with mpl.rc_context(_STYLE):
        yield


def save(figure: Figure, path: Path | str) -> Path:
    """Write a figure; the file appears whole or not at all.

    Parameters
    ----------
    figure : Figure
    path : path
        Its suffix says the format; folders are made where they are missing.

    Returns
    -------
    Path
    """
    path = Path(path)
    # Without the writer's version, or the date, the bytes depend on the figure alone.
    metadata = {".png": {"Software": None}, ".svg": {"Date": None, "Creator": None}}
    # Ticks are made while drawing, so the style is needed here too.
    with styled(), replacing(path) as temporary:
        figure.savefig(temporary, dpi=DPI, metadata=metadata.get(path.suffix))
    return path


def png_of(figure: Figure) -> bytes:
    """Bytes of a figure, as large as a notebook or a page shows it."""
    drawn = io.BytesIO()
    with styled():
        figure.savefig(drawn, format="png", dpi=_DPI_SHOWN, metadata={"Software": None})
    return drawn.getvalue()


def letter(axes: Axes, text: str) -> None:
    """Put a panel's letter above its upper left corner."""
    axes.set_title(text, loc="left", fontweight="bold")
