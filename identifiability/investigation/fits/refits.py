"""K, B and I fitted anew to a part of the samples, everything else of a candidate held.

All parts are fitted with the one compiled program that the candidate itself was fitted with: it
gives the residuals of all trials, of which a selection takes its share.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.optimize

from identifiability.inference.bounds import onto, size_of, strictly_inside, touching
from identifiability.inference.problem import Problem
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.pieces import places

NAMES = ("K", "B", "I")
UNITS = ("Nm/rad", "Nms/rad", "kg m²")
_EVALUATIONS = 40
_NEAR = 1e-5  # of a parameter's size: these fits end earlier than others
UNKNOWN_LEVEL = 1e3
"""Size of an offset that is unknown altogether, in units of the noise."""

Take = Callable[[int, np.ndarray], np.ndarray]
"""Takes a trial's number and columns over its compared samples, shape (n, k), and gives the rows
to be fitted, shape (m, k), in units in which they weigh alike. It must be linear."""


@dataclass(frozen=True, eq=False)
class Refit:
    """K, B and I that fit a selection best.

    Attributes
    ----------
    values : array, shape (3,)
    rows : tuple of array
        What is left, one array a trial, in the selection's units.
    cost : float
        Its sum of squares.
    information : array, shape (3, 3)
        Gauss-Newton matrix in those units.
    at_bound : tuple of str
    """

    values: np.ndarray
    rows: tuple[np.ndarray, ...]
    cost: float
    information: np.ndarray
    at_bound: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Refits:
    """Refits of K, B and I about a candidate.

    Attributes
    ----------
    bench : Workbench
    candidate : Candidate
    """

    bench: Workbench
    candidate: Candidate

    @cached_property
    def values(self) -> np.ndarray:
        """K, B and I of the candidate."""
        return np.array([self.candidate.values[name] for name in NAMES])

    @cached_property
    def _problem(self) -> Problem:
        fitted = self.bench.split.fitted
        one = self.candidate
        return self.bench.problem(one.model, fitted, refined=one.refined, scheme=one.scheme)

    @cached_property
    def _places(self) -> list[tuple[np.ndarray, float]]:
        """Where a trial's samples are among the problem's residuals, and their weight's scale."""
        split = self.bench.split
        sds = split.weights_sd(split.fitted)
        found = places(self._problem.observations)
        return [(at, float(sd)) for at, sd in zip(found, sds, strict=True)]

    def linearised(self, values: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Residuals of the trials, and the derivatives of the predictions.

        Parameters
        ----------
        values : array, shape (3,)
            K, B and I.

        Returns
        -------
        list of array, shape (n, 1)
            Measured minus predicted response at the compared samples, one a trial.
        list of array, shape (n, 3)
            Derivatives of the predicted response.
        """
        problem = self._problem
        x = problem.free_vector(self.candidate.values)
        x[:3] = values
        white, jacobian = problem.residuals(x), problem.jacobian(x)[:, :3]
        left = [-sd * white[at][:, None] for at, sd in self._places]
        return left, [sd * jacobian[at] for at, sd in self._places]

    def fit(self, take: Take, start: np.ndarray | None = None) -> Refit:
        """Fit K, B and I to a selection by bounded least squares.

        Parameters
        ----------
        take : callable
        start : array, shape (3,), optional
            The candidate's values by default.
        """

        def rows(values: np.ndarray) -> list[np.ndarray]:
            return [take(i, left)[:, 0] for i, left in enumerate(self.linearised(values)[0])]

        def slopes(values: np.ndarray) -> np.ndarray:
            return np.concatenate([take(i, s) for i, s in enumerate(self.linearised(values)[1])])

        lower, upper = self._problem.lower[:3], self._problem.upper[:3]
        x = strictly_inside(self.values if start is None else start, lower, upper)
        # Where the response overflows about the start, that stays.
        with contextlib.suppress(ValueError, np.linalg.LinAlgError):
            x = scipy.optimize.least_squares(
                lambda values: -np.concatenate(rows(values)),
                x,
                jac=slopes,
                bounds=(lower, upper),
                x_scale="jac",
                ftol=1e-7,
                xtol=1e-7,
                gtol=1e-10,
                max_nfev=_EVALUATIONS,
            ).x
        at_lower, at_upper = touched = touching(x, lower, upper, _NEAR * size_of(x))
        x, on = onto(x, lower, upper, touched), at_lower | at_upper
        left, slope = rows(x), slopes(x)
        return Refit(
            x,
            tuple(left),
            float(sum(r @ r for r in left)),
            slope.T @ slope,
            tuple(name for name, is_on in zip(NAMES, on, strict=True) if is_on),
        )


def without_levels(columns: np.ndarray, level: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Columns freed of unknown offsets, group by group.

    White noise of variance 1 plus an offset with this level has the covariance 1 + v v', whose
    inverse square root is applied. Of a level that is unknown altogether nothing is left.

    Parameters
    ----------
    columns : array, shape (m, k)
    level : array, shape (m,)
        What an offset of one standard deviation looks like; infinite sizes are not allowed, but
        large ones are.
    group : array of int, shape (m,)
        Rows that share an offset.
    """
    if not group.size or not np.any(level):
        return columns
    energy = np.bincount(group, level**2)
    safe = np.where(energy > 0, energy, 1.0)
    share = np.where(energy > 0, (1 - 1 / np.sqrt(1 + energy)) / safe, 0.0)
    out = np.array(columns, float)
    for column in out.T:
        column -= level * (np.bincount(group, level * column) * share)[group]
    return out
