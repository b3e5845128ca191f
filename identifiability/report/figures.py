"""The figures of a report: in its page, and beside it in the formats that journals ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from identifiability.measurement.cutting import is_cut
from identifiability.measurement.prepared import Prepared
from identifiability.plots.recording import cut_recordings, cuts_figure
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

    def show_cuts(self, trials: Iterable[Prepared]) -> None:
        """Show where recordings were cut into trials, where any was."""
        # As they were recorded, about no operating point.
        as_recorded = [
            p.trial.less(-p.treatment.torque, -p.treatment.angle, "put back")
            for p in trials
            if is_cut(p.trial)
        ]
        for number, cut in enumerate(cut_recordings(as_recorded), start=1):
            self.show(
                "cuts" if number == 1 else f"cuts_{number}",
                partial(cuts_figure, cut),
                f"{cut[0].source or 'The recording'}, cut into {len(cut)} trials: one from "
                "before each perturbation (dashed: where it starts) to the next one's.",
                "Imposed signal and response in time, with the trials shaded and numbered.",
            )
