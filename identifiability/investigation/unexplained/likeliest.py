"""The hyperparameters and the noise by which residuals are likeliest, by the evidence's slope."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from identifiability.investigation.unexplained.linear_gaussian import (
    Columns,
    Slope,
    TrialNoise,
    log_evidence_slope,
    renewed,
)
from identifiability.investigation.unexplained.terms import Term

HIGHEST_RHO = 0.99
"""Highest correlation of the noise from one sample to the next."""
_SDS = np.log([1e-6, 1e6])  # of the noise's standard deviations over those of a start
_ENOUGH, _MATTERS = 3e-3, 0.1  # nats that a step must bring, and a search, to be followed by others
_MOST_RUNS = 5
_RENEWED = 3  # steps of expectation maximisation, which lead to noise of the right order
_IMPOSSIBLE = 1e30  # cost of values whose evidence cannot be computed
_STEP = 1e-4  # of a logarithm, to either side, for the derivative of a prior's root

PriorRoots = Callable[[Sequence[np.ndarray]], tuple[list[np.ndarray], np.ndarray]]
"""Roots of the priors of each trial's local weights and of the common ones, from the values."""


@dataclass(frozen=True, eq=False)
class Likeliest:
    """Where a search ended.

    Attributes
    ----------
    values : list of array
        Hyperparameters of each term.
    noise : TrialNoise
    log_evidence : float
    """

    values: list[np.ndarray]
    noise: TrialNoise
    log_evidence: float


def likeliest(
    terms: Sequence[Term],
    columns: Sequence[Columns],
    roots: PriorRoots,
    values: Sequence[np.ndarray],
    noise: TrialNoise,
    *,
    sizes_only: bool = False,
) -> Likeliest:
    """Maximise the evidence over hyperparameters and noise, from one start.

    The noise's correlation is held at first: where it is free, coloured noise takes over what the
    terms, far from their best values yet, do not explain.

    Parameters
    ----------
    terms : sequence of Term
    columns : sequence of Columns
        Of these terms and the background, by trial.
    roots : callable
    values : sequence of array
        Of each term's hyperparameters, to start from.
    noise : TrialNoise
        To start from.
    sizes_only : bool
        Whether shapes stay as they are at the start.

    Raises
    ------
    LinAlgError
        Where no evidence can be computed.
    """
    with np.errstate(all="ignore"):
        at = roots(values)
        for _ in range(_RENEWED):
            noise = renewed(columns, noise, *at)
        search = _Search(terms, columns, roots, values, noise, sizes_only)
        x = search.start
        reached, _ = search.cost(x)
        for run in range(_MOST_RUNS):
            x, found = search.descend(x, reached, rho_held=run == 0 and bool(terms))
            # One that met values which cannot be computed ends early; another goes on from there.
            if run and reached - found < _MATTERS:
                break
            reached = found
    if found == _IMPOSSIBLE:
        raise np.linalg.LinAlgError("found no values whose evidence can be computed")
    ended, noise = search.made(x)
    return Likeliest(ended, noise, -found)


@dataclass(frozen=True, eq=False)
class _Search:
    """The evidence as a function of logarithms; of the noise counted by how fast it bends."""

    terms: Sequence[Term]
    columns: Sequence[Columns]
    roots: PriorRoots
    values: Sequence[np.ndarray]
    noise: TrialNoise
    sizes_only: bool

    @cached_property
    def _n_values(self) -> int:
        return sum(len(v) for v in self.values)

    @cached_property
    def _unit(self) -> np.ndarray:
        n = np.array([c.n_samples for c in self.columns])
        return np.concatenate([np.ones(self._n_values), [n.sum() ** -0.5], (2 * n) ** -0.5])

    def _held(self, term: Term) -> np.ndarray:
        """Which of its hyperparameters stay as they are."""
        return self.sizes_only & (np.arange(len(term.start)) >= term.n_scales)

    @cached_property
    def _limits(self) -> np.ndarray:
        bounds = np.concatenate([*(t.bounds for t in self.terms), np.zeros((0, 2))])
        held = np.concatenate([*map(self._held, self.terms), np.zeros(0, bool)])
        bounds[held] = np.log(np.concatenate([*self.values, []]))[held, None]
        correlation = [[0.0, -np.log(1 - HIGHEST_RHO)]]
        return np.vstack([bounds, correlation, np.tile(_SDS, (len(self.columns), 1))])

    @property
    def start(self) -> np.ndarray:
        """Where the search begins."""
        logs = np.log(np.concatenate([*self.values, []]))
        noise = [-np.log(1 - self.noise.rho), *np.zeros(len(self.columns))]
        return np.clip(np.concatenate([logs, noise]), *self._limits.T) / self._unit

    def made(self, x: np.ndarray) -> tuple[list[np.ndarray], TrialNoise]:
        """Hyperparameters of each term, and the noise."""
        logs, correlation, sds = np.split(self._unit * x, [self._n_values, self._n_values + 1])
        ends = np.cumsum([len(v) for v in self.values])
        values = np.split(np.exp(logs), ends[:-1]) if self.values else []
        noise = TrialNoise(self.noise.sds * np.exp(sds), float(1 - np.exp(-correlation[0])))
        return values, noise

    def descend(self, x: np.ndarray, cost: float, *, rho_held: bool) -> tuple[np.ndarray, float]:
        """Where steps downhill lead to from a point of this cost, and the cost there."""
        limits = self._limits / self._unit[:, None]
        if rho_held:
            limits[self._n_values] = x[self._n_values]
        found = minimize(
            self.cost,
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=limits,
            options={"ftol": _ENOUGH / max(abs(cost), 1.0), "gtol": 0.0},
        )
        return found.x, float(found.fun)

    def cost(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the evidence, and its slope."""
        values, noise = self.made(x)
        try:
            found = log_evidence_slope(self.columns, noise, *self.roots(values))
            by_logs = [*self._by_logs(values, found)]
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE, np.zeros(x.size)
        slope = self._unit * [*by_logs, found.rho * (1 - noise.rho), *found.log_sds]
        if not np.all(np.isfinite([found.value, *slope])):
            return _IMPOSSIBLE, np.zeros(x.size)
        return -found.value, -slope

    def _by_logs(self, values: Sequence[np.ndarray], found: Slope) -> Iterator[float]:
        """By the logarithms of the hyperparameters, in turn."""
        used = {True: np.zeros(1, int), False: np.zeros(len(self.columns), int)}
        for t, v in zip(self.terms, values, strict=True):
            slopes = [found.common] if t.shared else found.local
            sizes = np.array([c.shape[1] for c in t.columns[: len(slopes)]])
            first, used[t.shared] = used[t.shared], used[t.shared] + sizes
            own = [s[a : a + m, a : a + m] for s, a, m in zip(slopes, first, sizes, strict=True)]
            for k, held in enumerate(self._held(t)):
                if held:
                    yield 0.0
                    continue
                step = np.where(np.arange(len(v)) == k, _STEP, 0.0)
                pairs = zip(own, t.roots(v * np.exp(step)), t.roots(v * np.exp(-step)), strict=True)
                yield sum(np.sum(s * (high - low)) for s, high, low in pairs) / (2 * _STEP)
