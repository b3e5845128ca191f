"""The smallest effect that would have been seen, for every effect of the library.

At a candidate size the trials are predicted with the effect, and the smaller model is fitted to
that prediction: what it cannot absorb is the effect's trace. The trace, made shorter by bad luck
with the noise, must then be evidence enough to be claimed, and the size is found by bisection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.optimize

from identifiability.errors import InputError
from identifiability.inference.fitting import inside
from identifiability.inference.problem import Problem
from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import NOTHING, Candidate, Residual
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import Model

_FIRST = 0.01  # share of the nominal size that the bracket is looked for from
_STRIDE, _CLOSE = 8.0, 1.05  # largest step of that, and ratio of the bracket's ends at its end
_SMOOTHED = 7  # lines of a spectrum that a noise's colour tells apart as one
_EVALUATIONS = 20  # of one refit of the smaller model
_SOLVER_SHARE = 0.01  # of a trace's square that the error of its integration may have


@dataclass(frozen=True)
class Detectable:
    """Smallest size of an effect that would have been decisive.

    Attributes
    ----------
    key : str
    parameter : str
        Parameter that measures its size.
    size : float
        In the parameter's unit; where the effect vanishes with infinite stiffness, the largest
        stiffness that would have been seen.
    unit : str
    sentence : str
    values : mapping of str to float
        All parameters of the model with the effect at that size.
    """

    key: str
    parameter: str
    size: float
    unit: str
    sentence: str
    values: Mapping[str, float] = field(default_factory=dict)


def detectable(
    bench: Workbench, candidate: Candidate, library: Mapping[str, type[Effect]]
) -> tuple[Detectable, ...]:
    r"""Smallest effects that would have been seen beside a fitted model.

    The noise is what the model leaves. Its colour is not known beforehand, so that a trace counts
    for no more than a noise with the spectrum of both would have to explain:
    :math:`\lambda = \sum \log(1 + T/N)` over all frequencies, with T and N the spectra of trace
    and noise (Whittle 1953, Ark Mat 2:423-434). In one draw of the noise this is
    :math:`(\sqrt\lambda + z)^2` with z standard normal: the noise lengthens or shortens the trace.
    An effect counts as seen where with a z of minus ``rules.bad_luck`` the evidence raises its
    probability from one among all effects of the library and the unknown to ``rules.claimed``. From
    the evidence is taken what the prior takes: of its size, which may as well make all of the
    response, the ratio of what it may be to what the data leave open; a nat for every other
    parameter. At a third of its size its evidence is a ninth, and chance seldom makes up for that.

    Effects that stay invisible at any size are left out.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        The model in which nothing was found missing.
    library : mapping of str to type of Effect
    """
    found = []
    for key, kind in library.items():
        if key in candidate.keys:
            continue
        try:
            model = candidate.model + kind()
        except InputError:  # it does not go with an effect that is there
            continue
        one = _Hidden(bench, candidate, model, key, len(library)).smallest()
        if one is not None:
            found.append(one)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Hidden:
    """An effect that the trials may hide.

    Attributes
    ----------
    bench : Workbench
    candidate : Candidate
        The model without it.
    model : Model
        The model with it.
    key : str
    n_effects : int
        Number of effects that could be tried.
    """

    bench: Workbench
    candidate: Candidate
    model: Model
    key: str
    n_effects: int

    @cached_property
    def sizes(self) -> list[str]:
        """Its parameters that make it vanish; the first measures its size."""
        return [
            n
            for n, p in self.model.parameters.items()
            if n.startswith(f"{self.key}.") and p.null is not None and p.plain is None
        ]

    @cached_property
    def problems(self) -> tuple[list[Problem], list[Problem]]:
        """Of the model without it and of that with it, for the fitted and the held-out trials."""
        split = self.bench.split
        parts = [part for part in (split.fitted, split.held_out) if part]
        refined, scheme = self.candidate.refined, self.candidate.scheme
        return (
            [
                self.bench.problem(self.candidate.model, part, refined=refined, scheme=scheme)
                for part in parts
            ],
            [self.bench.problem(self.model, part, refined=refined) for part in parts],
        )

    def values(self, strength: float) -> dict[str, float]:
        """All parameters with the effect at a strength: its size, or the inverse of a stiffness."""
        known = dict(self.candidate.values)
        shape = starting_values(self.model, known)[0] | known
        for name, p in self.model.parameters.items():
            if name.startswith(f"{self.key}.") and p.plain is None and p.null is None:
                shape[name] = p.nominal
        null = self.model.parameters[self.sizes[0]].null
        assert null is not None
        size = null + strength if np.isfinite(null) else 1 / strength
        others = {name: self.model.parameters[name].null for name in self.sizes[1:]}
        return shape | {n: v for n, v in others.items() if v is not None} | {self.sizes[0]: size}

    def smallest(self) -> Detectable | None:
        """Smallest size at which it is seen; ``None`` where it is seen at none."""
        p = self.model.parameters[self.sizes[0]]
        assert p.null is not None
        finite = np.isfinite(p.null)
        nominal = p.nominal - p.null if finite else 1 / p.nominal
        most = p.upper - p.null if finite else 1 / max(p.lower, 1e-9)
        low, high, strength = 0.0, np.inf, _FIRST * nominal
        start = self.model_free_start
        while not np.isfinite(high) or high > _CLOSE * low:
            trace = self.trace(strength, start)
            if trace is None:  # the response has no bounds: no joint has an effect of that size
                return None
            if trace.seen:
                high = strength
            else:
                low, start = strength, trace.start
            if low >= most or high < 1e-6 * nominal:
                return None
            if np.isfinite(high) and low > 0:
                strength = float(np.sqrt(low * high))
                continue
            # Evidence grows with the square of the strength, or faster.
            step = float(np.clip(trace.short_of, 1 / _STRIDE, _STRIDE))
            step = max(step, 1.2) if low > 0 else min(step, 1 / 1.2)
            strength = min(strength * step, most)
        values = self.values(high)
        size = values[self.sizes[0]]
        words = f"{p.description} {'of' if finite else 'up to'} {size:.2g} {p.unit}"
        return Detectable(self.key, self.sizes[0], size, p.unit, words, values)

    @cached_property
    def model_free_start(self) -> np.ndarray:
        """The smaller model's optimum."""
        return self.problems[0][0].free_vector(self.candidate.values)

    def trace(self, strength: float, start: np.ndarray) -> _Trace | None:
        """What the smaller model, fitted anew, cannot absorb of the effect."""
        without, having = self.problems
        values = self.values(strength)
        full = having[0].free_vector(values)
        scheme = having[0].suited(self.model.vector(values))
        while True:
            exactly = [problem.with_scheme(scheme) for problem in having]
            predicted = [problem.residuals(full) for problem in exactly]
            if not all(np.all(np.isfinite(p)) for p in predicted):
                return None
            starts = [start, self.model_free_start, self._softened(values)]
            x = _refit(without[0], predicted[0], starts)
            left = [w.residuals(x) - p for w, p in zip(without, predicted, strict=True)]
            if scheme.exact:
                break
            # What the integration is wrong by must not pass for a trace.
            moved = [
                p - h.halved().residuals(full) for p, h in zip(predicted, exactly, strict=True)
            ]
            error = sum(float(m @ m) for m in moved) / sum(float(t @ t) for t in left)
            error /= scheme.shown
            if error <= _SOLVER_SHARE:
                break
            if scheme.finest:
                return None
            scheme = scheme.improved(error / _SOLVER_SHARE)
        parts = (self.bench.split.fitted, self.bench.split.held_out)
        traces = [
            self.bench.unstacked(problem, white, part)
            for problem, white, part in zip(without, left, parts, strict=False)
        ]
        made = without[0].residuals(self.model_free_start) - predicted[0]
        share = np.sqrt(self.bench.unstacked(without[0], made, parts[0]).error)
        held_out = traces[1] if len(traces) > 1 else NOTHING
        return _Trace(self, values, x, traces[0], held_out, max(float(share), 1e-12))

    def _softened(self, values: Mapping[str, float]) -> np.ndarray:
        """Where springs in series with the muscle take K and B of the model without them."""
        x = self.model_free_start.copy()
        p = self.model.parameters[self.sizes[0]]
        if p.null is not None and not np.isfinite(p.null):
            soft = 1 / (1 + values["K"] / values[self.sizes[0]])
            for name, factor in (("K", soft), ("B", soft**2)):
                names = self.problems[0][0].names
                if name in names:
                    x[names.index(name)] *= factor
        return x


@dataclass(frozen=True, eq=False)
class _Trace:
    """What the smaller model cannot absorb of an effect, and whether that would be seen.

    Attributes
    ----------
    of : _Hidden
    values : mapping of str to float
    start : array
        Where the smaller model's fit ended.
    fitted, held_out : Residual
        What it leaves.
    share : float
        Of the response, root mean square, that the effect makes before anything is absorbed.
    """

    of: _Hidden
    values: Mapping[str, float]
    start: np.ndarray
    fitted: Residual
    held_out: Residual
    share: float

    @cached_property
    def expected(self) -> float:
        """Evidence that it is expected to have, twice its log likelihood, of all trials."""
        candidate = self.of.candidate
        pairs = ((candidate.fitted, self.fitted), (candidate.held_out, self.held_out))
        return sum(
            _evidence(trace, noise)
            for residual, part in pairs
            for trace, noise in zip(part.by_trial, residual.by_trial, strict=False)
        )

    @cached_property
    def needed(self) -> float:
        """Evidence from which the effect is probable enough to be claimed."""
        of, rules = self.of, self.of.bench.rules
        odds = rules.claimed / (1 - rules.claimed) * (of.n_effects + 1)
        others = len(of.problems[1][0].free) - self.start.size - 1
        size = np.log(np.sqrt(max(self.expected, 1.0)) / self.share)
        return float(2 * (np.log(odds) + max(size, 0.0) + others))

    @property
    def short_of(self) -> float:
        """About how many times stronger the effect would have to be to be seen."""
        root = self.of.bench.rules.bad_luck + np.sqrt(self.needed)
        return float(root / np.sqrt(max(self.expected, 1e-12)))

    @property
    def seen(self) -> bool:
        """Whether it would be claimed, with bad luck."""
        return self.short_of <= 1


def _evidence(trace: np.ndarray, noise: np.ndarray) -> float:
    """Twice the log likelihood that a noise of unknown colour leaves to a trace."""
    around = np.ones(_SMOOTHED) / _SMOOTHED
    powers = [
        np.convolve(np.abs(np.fft.fft(values - values.mean())) ** 2, around, mode="same")
        for values in (trace, noise)
    ]
    return float(np.sum(np.log1p(powers[0] / np.maximum(powers[1], 1e-300))))


def _refit(problem: Problem, target: np.ndarray, starts: list[np.ndarray]) -> np.ndarray:
    """Parameters whose whitened residual is nearest to the target, from the best of some starts."""
    starts = list({tuple(s): s for s in inside(problem, np.array(starts))}.values())

    def cost(x: np.ndarray) -> float:
        miss = problem.residuals(x) - target
        return float(miss @ miss)

    costs = [cost(x) for x in starts]
    start = starts[int(np.argmin(costs))]
    found = scipy.optimize.least_squares(
        lambda x: problem.residuals(x) - target,
        start,
        jac=problem.jacobian,
        bounds=(problem.lower, problem.upper),
        x_scale="jac",
        ftol=1e-8,
        xtol=1e-8,
        gtol=1e-12,
        max_nfev=_EVALUATIONS,
    )
    return np.asarray(found.x)
