"""What became of one task of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Arrays = dict[str, np.ndarray]
Status = Literal["done", "failed", "crashed", "timed out"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one task.

    Attributes
    ----------
    name : str
    status : {"done", "failed", "crashed", "timed out"}
        It returned, raised, its process died, or it took longer than it may.
    arrays : dict of str to array, or None
        What the task returned; None unless it is done.
    cause : str
        Why it is not done, in one line.
    resumed : bool
        Whether the result was found on disk.
    seconds : float
        Time it took; NaN for a resumed task.
    """

    name: str
    status: Status
    arrays: Arrays | None = None
    cause: str = ""
    resumed: bool = False
    seconds: float = float("nan")
