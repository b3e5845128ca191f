"""Whether K, B and I are the same however they are fitted: whole records, windows, least squares.

A joint that is K, B and I has the same ones in every window, and whichever way its samples are
weighed. One that is not has as many as there are ways to fit it (Kistemaker & Rozendaal 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Literal

import numpy as np

from identifiability.inference.widths import Width

if TYPE_CHECKING:
    from identifiability.inference.recordings import RecordingFit

_NOTABLE = 3.0  # standard errors

Kind = Literal["depends on the window", "depends on the weights", "the same", "not tested"]


@dataclass(frozen=True)
class Reading:
    """One parameter, fitted in one way.

    Attributes
    ----------
    window : float or None
        T [s] after each perturbation; ``None`` for whole records.
    value : float
    sd : float or None
        ``None`` of least squares, which knows no noise.
    """

    window: float | None
    value: float
    sd: float | None


@dataclass(frozen=True)
class Disagreement:
    """The largest difference of a parameter between two ways to fit it.

    Attributes
    ----------
    name, unit : str
    first, second : Reading
    size : float
        In standard errors of the difference, as if the two shared no samples.
    """

    name: str
    unit: str
    first: Reading
    second: Reading
    size: float


@dataclass(frozen=True)
class Structural:
    """Structural error of a parameter beside its statistical width.

    Attributes
    ----------
    name, unit : str
    width : float
        Standard deviation of the posterior of whole records.
    error : float
        How far windows or least squares differ beyond what the noise explains; 0 where it explains
        all. A lower bound: what is wrong in the same way in all of them is not seen.
    """

    name: str
    unit: str
    width: float
    error: float


@dataclass(frozen=True)
class Consistency:
    """Whether K, B and I are properties of what was recorded.

    Attributes
    ----------
    kind : {"depends on the window", "depends on the weights", "the same", "not tested"}
        The first of these that holds. They depend on the weights where least squares and the
        likelihood, in which the noise is estimated, differ by more than the noise explains.
    windows : tuple of float
        T [s] of those that were fitted.
    largest : tuple of Disagreement
        By parameter the largest, of what the kind says; none where nothing was tested.
    structural : tuple of Structural
        By parameter.
    """

    kind: Kind
    windows: tuple[float, ...]
    largest: tuple[Disagreement, ...]
    structural: tuple[Structural, ...]

    @property
    def notable(self) -> tuple[Disagreement, ...]:
        """Those that are more than the noise explains, K first."""
        return tuple(one for one in self.largest if one.size >= _NOTABLE)


def consistency(result: RecordingFit) -> Consistency:
    """Compare what was fitted to whole records with windows and with least squares.

    Parameters
    ----------
    result : RecordingFit
    """
    windows = tuple(w.window for w in result.windows)
    by_window, by_weights = [], []
    for i, row in enumerate(result.widths.rows):
        fits = [(w.window, w.widths.rows[i]) for w in result.windows]
        by_window.append(_largest([*fits, (None, row)]))
        least = Reading(None, result.least_squares[row.name], None)
        size = abs(least.value - row.optimum) / max(_sd(row), 1e-300)
        by_weights.append(Disagreement(row.name, row.unit, least, _reading(None, row), size))
    structural = tuple(
        Structural(row.name, row.unit, _sd(row), max(map(_beyond_noise, pair)))
        for row, *pair in zip(result.widths.rows, by_window, by_weights, strict=True)
    )
    if windows:
        found = Consistency("depends on the window", windows, tuple(by_window), structural)
        if found.notable:
            return found
    found = Consistency("depends on the weights", windows, tuple(by_weights), structural)
    if found.notable:
        return found
    if windows:
        return Consistency("the same", windows, tuple(by_window), structural)
    return Consistency("not tested", (), (), structural)


def _beyond_noise(one: Disagreement) -> float:
    """What noise leaves of a difference, its variance taken off."""
    if one.size < _NOTABLE:
        return 0.0
    return abs(one.first.value - one.second.value) * float(np.sqrt(1 - one.size**-2))


def _largest(fits: Sequence[tuple[float | None, Width]]) -> Disagreement:
    found = [
        Disagreement(
            one.name,
            one.unit,
            _reading(window, one),
            _reading(later, other),
            abs(one.optimum - other.optimum) / max(float(np.hypot(_sd(one), _sd(other))), 1e-300),
        )
        for (window, one), (later, other) in combinations(fits, 2)
    ] or [Disagreement(fits[0][1].name, fits[0][1].unit, *2 * (_reading(*fits[0]),), 0.0)]
    return max(found, key=lambda one: one.size)


def _reading(window: float | None, row: Width) -> Reading:
    return Reading(window, row.optimum, _sd(row))


def _sd(row: Width) -> float:
    """The sampled posterior's where it converged, else the profile's, which is no Gaussian's."""
    return float(row.profile if row.verdict == "not converged" else row.posterior_sd)
