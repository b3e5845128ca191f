"""Starts of a fit: of many shapes those that leave least once their sizes are fitted.

Given the shapes of its effects (a delay, a time constant) a model is all but linear in K, B, I and
the sizes of its effects: in one step these are found for every shape of a grid (variable
projection; Golub & Pereyra 1973, SIAM J Numer Anal 10:413-432). Without it a fit ends in the basin
of the shape that it happened to start from.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from identifiability.inference.problem import Problem
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.noises import Weighed, Weights, raw_residuals
from identifiability.joint.programs import THREADS

_TRIED = 4  # starts whose sizes are evaluated with their torque as it is, not linear
_SHARES = (1.0, 0.3)  # of a step, where the whole one leads astray


@dataclass(frozen=True, eq=False)
class Beginnings:
    """Starts of one model, with what it leaves at each and its derivatives.

    Attributes
    ----------
    problem : Problem
    band : Band
    points : array, shape (n_starts, n_free)
    raw : list
        Of `raw_residuals`, by start.
    """

    problem: Problem
    band: Band
    points: np.ndarray
    raw: list[tuple[list[np.ndarray], list[np.ndarray] | None]]

    @classmethod
    def of(cls, problem: Problem, band: Band, points: np.ndarray) -> Beginnings:
        """Evaluate a model at its starts, shape (n_starts, n_free)."""
        first = raw_residuals(problem, band, points[0])  # compiled before the threads ask for it
        with ThreadPoolExecutor(THREADS) as pool:
            rest = list(pool.map(lambda x: raw_residuals(problem, band, x), points[1:]))
        return cls(problem, band, points, [first, *rest])

    def best(self, weights: Weights, n: int) -> np.ndarray:
        """The best so many of the starts, sizes fitted, as given noise weighs them."""
        weighed = Weighed(self.problem, self.band, weights)
        if len(self.points) == 1:
            return self.points
        squares, stepped, expected = [], [], []
        for x, raw in zip(self.points, self.raw, strict=True):
            white = weighed.of(*raw)
            step, left = self._step(x, *weighed.linear(*white))
            squares.append(weighed.squares_of(*white))
            stepped.append(step)
            expected.append(left)
        costs, ends = [], []
        for i in np.argsort(expected, kind="stable")[: max(_TRIED, n)]:
            x, before = self.points[i], squares[i]
            for share in _SHARES:
                end = x + share * stepped[i]
                after = weighed.squares(end)
                if after < before:
                    x, before = end, after
                    break
            costs.append(before)
            ends.append(x)
        return np.array(ends)[np.argsort(costs, kind="stable")[:n]]

    def _step(
        self, x: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Step of the sizes within their bounds, and the sum of squares that it should leave."""
        problem = self.problem
        nulls = [problem.model.parameters[name].null for name in problem.names]
        sized = np.array(
            [
                name in ("K", "B", "I") or (null is not None and bool(np.isfinite(null)))
                for name, null in zip(problem.names, nulls, strict=True)
            ]
        )
        step = np.zeros(x.size)
        columns = np.column_stack([jacobian[:, sized], residuals])
        corner = np.asarray(np.linalg.qr(columns, mode="r"))
        size = np.maximum(np.linalg.norm(corner[:, :-1], axis=0), 1e-300)
        room = (problem.lower - x)[sized] * size, (problem.upper - x)[sized] * size
        found = lsq_linear(corner[:, :-1] / size, -corner[:, -1], bounds=room, method="bvls")
        step[sized] = found.x / size
        return step, float(2 * found.cost)
