"""What every view of where a model fails has: what it found, its words, and its panels.

A view is one file with one subclass of `View`, and one line in `views.VIEWS`. `locate`, the record,
the report and the figure know no view by name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from identifiability.investigation.where.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Panel:
    """A panel of the figure of where a model fails.

    Attributes
    ----------
    title : str
    draw : callable
        Draws what a view found on the axes that it is handed.
    width : int
        Of the three columns that a row of panels has.
    """

    title: str
    draw: Callable[[Axes], None]
    width: int = 1


@dataclass(frozen=True, eq=False)
class View(ABC):
    """What one view of where a model fails found; its fields are all its numbers.

    Attributes
    ----------
    name : str
        Its name among the views, the same for all of a class.
    significant : bool
    noise_known : bool
        Whether the residual is judged by the noise before the perturbations, or else by its own
        typical level.
    """

    name: ClassVar[str]

    significant: bool
    noise_known: bool

    @classmethod
    @abstractmethod
    def of(cls, scene: Scene) -> Self:
        """Look at a model's residuals.

        Parameters
        ----------
        scene : Scene
        """

    @abstractmethod
    def words(self) -> str:
        """What was found, in one sentence; or why these trials do not allow the view."""

    @abstractmethod
    def panels(self) -> tuple[Panel, ...]:
        """Panels of the figure: none where there is nothing to draw."""

    @property
    def reference(self) -> str:
        """What the residual is judged by, in words."""
        return "the noise" if self.noise_known else "its typical level (the noise is unknown)"
