"""The figures of a report: in its page, and beside it in the formats that journals ask for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from identifiability.plots.style import COLUMN, save_printed
from identifiability.report.page import Page

FOLDER = "figures"
"""Beside the page, where the figures are."""


@dataclass(frozen=True)
class Figures:
    """Draws figures into a page and a folder.

    Attributes
    ----------
    page : Page
    out : Path
        The page's folder.
    written : list of str
        Files, relative to that.
    """

    page: Page
    out: Path
    written: list[str] = field(default_factory=list)

    def show(self, name: str, draw: Callable[[], Any], caption: str, alt: str) -> None:
        """Draw a figure, or say why it cannot be: it must not take the report with it."""
        try:
            figure = draw()
        except (ValueError, ArithmeticError, IndexError, KeyError) as error:
            self.page.paragraph(f"(A figure could not be drawn: {error}.)")
            return
        files = save_printed(figure, self.out / FOLDER, name)
        self.written.extend(f"{FOLDER}/{file.name}" for file in files)
        wide = figure.get_figwidth() > COLUMN
        self.page.figure(files[0].read_bytes(), caption, alt=alt, wide=wide)
