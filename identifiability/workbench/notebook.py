"""What a session finds shows itself in a notebook, as the session does."""

from __future__ import annotations

import sys

from identifiability.inference.widths import Widths
from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location
from identifiability.workbench.attempt import Attempt
from identifiability.workbench.difference import Difference

_SHOWN = (
    *(Attempt, Difference),
    *(Location, Comparison, Unexplained, Probabilities, Claim, NextExperiment, Widths),
)


def show_in_notebooks() -> None:
    """Tell IPython, where it runs, how results are shown.

    They cannot have it as a method: what finds them is below what draws them. And a figure of its
    own is seen where pictures within a page are not, as on the pages of repositories.
    """
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is not None:
        for kind in _SHOWN:
            shell.display_formatter.ipython_display_formatter.for_type(kind, _show)


def _show(result: object) -> None:
    from IPython.display import HTML, Image, display

    from identifiability.workbench.show import picture, said

    display(HTML(said(result)))
    if (drawn := picture(result)) is not None:
        display(Image(drawn, format="png"))
