"""Colour and level of the noise that a fit left: orders by AICc, values by restricted likelihood.

The restricted likelihood (REML: Patterson & Thompson 1971, Biometrika 58:545-554) counts what the
fit and the unknown levels took out of the residual. Without it slow noise seems smaller and faster
than it is, and intervals are too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from identifiability.files import plain
from identifiability.inference.likelihood.beside import Left, deviance, most_likely
from identifiability.inference.likelihood.processes import Process, ProcessSum
from identifiability.inference.likelihood.profiled import (
    Residuals,
    least_squares,
    polynomial,
    scaled_residuals,
)

_ARMA = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1), (2, 2), (3, 3))

_MOST_SAMPLES, _CHUNK = 4000, 1000  # from which the colour is estimated
_LONG_AR = 16  # order of the autoregression whose residuals stand for the shocks
_MOST_CORRELATED = 5.0  # bound of atanh of a partial autocorrelation
# Of carried to own variance, to start from: where next to nothing is carried, more has no slope.
_SHARES = np.geomspace(1e-2, 1e6, 5)
_MOST_CARRIED = 10.0  # logarithm of carried over own, of deviations; least of it with a minus
_MOST_LEVEL = 20.0  # logarithm of the own noise's level over the residual's, or its inverse
_HELD_ROUNDS, _AS_KNOWN = 8, 1.02  # of own beside held noise; times what there is of that
_LEAST_SLOPE = 0.1  # of what is held by its share of the own noise
_SAME_DIRECTION = 1e-8  # length of a direction, over the longest, from which it is one
_SHORTLIST = 3
_NO_PROCESS = (np.ones(1), np.zeros(1))


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of samples that follow each other, whose level is unknown.

    Attributes
    ----------
    residual : array, shape (n,)
        Measured minus predicted response.
    jacobian : array, shape (n, k)
        Derivatives of the prediction.
    trial : int
        Number of the trial it belongs to: trials may differ in level.
    beside : array, shape (n,), or None
        Variances of noise that is there as well, independent from sample to sample; all stretches
        have it, or none.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    trial: int
    beside: np.ndarray | None = None

    def over(self, factor: float, level: float = 1.0) -> Stretch:
        """The residual in another unit, or what it is at level 1."""
        beside = None if self.beside is None else self.beside / (factor * level) ** 2
        return Stretch(self.residual / (factor * level), self.jacobian / level, self.trial, beside)

    def part(self, first: int, last: int) -> Stretch:
        """Samples from the first to before the last."""
        chosen = slice(first, last)
        beside = None if self.beside is None else self.beside[chosen]
        return Stretch(self.residual[chosen], self.jacobian[chosen], self.trial, beside)


@dataclass(frozen=True)
class Order:
    """What a noise is made of: an ARMA(p, q), and maybe noise carried by the joint."""

    p: int
    q: int
    carried: bool

    @property
    def size(self) -> int:
        """Number of parameters, the level not counted."""
        return self.p + self.q + self.carried


class Contender(NamedTuple):
    """An order that is tried, and the optimiser's values to start from; none known without.

    Partial autocorrelations; beside noise of known size the logarithm of the own noise's level;
    that of the carried one's, elsewhere over the own.
    """

    order: Order
    values: np.ndarray = np.empty(0)


def contenders(*, carried: tuple[bool, ...]) -> tuple[Contender, ...]:
    """Orders that are tried, without carried noise, with it, or both."""
    return tuple(Contender(Order(p, q, with_it)) for with_it in carried for p, q in _ARMA)


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of the compared channel of trials that are sampled alike.

    Attributes
    ----------
    own : Process
        The instrument's, whatever its colour [rad or Nm].
    carried : Process or None
        White noise of the other channel after the joint; ``sd`` is that of the other channel's
        samples [Nm or rad], after thinning where they were thinned.
    levels : array, shape (n_trials,)
        Factors of the standard deviations by trial; 1 where trials do not differ.
    rms : float
        Root mean square of the residual about its level [rad or Nm]. The processes' own standard
        deviation says nothing where they drift.
    tried : int
        Number of orders that were tried.
    converged : bool
        Whether the optimiser ended by itself.
    carried_error : float
        Standard error of the carried noise's variance, over that variance: 1 where there may be
        none, 0 where it is held at what is known of it, or was not asked for.
    """

    own: Process
    carried: Process | None
    levels: np.ndarray
    rms: float
    tried: int
    converged: bool
    carried_error: float = 0.0

    @cached_property
    def noise(self) -> ProcessSum:
        """The sum of both, at level 1."""
        return ProcessSum((self.own,) if self.carried is None else (self.own, self.carried))

    @property
    def carried_sd(self) -> float:
        """Standard deviation of the other channel's noise [Nm or rad] at level 1; 0 without."""
        return 0.0 if self.carried is None else self.carried.sd

    def to_dict(self) -> dict[str, Any]:
        """Plain record, for JSON."""
        found: dict[str, Any] = plain(
            {
                "rms": self.rms,
                "own": {"ar": self.own.ar, "ma": self.own.ma, "sd": self.own.sd},
                "carried_sd": self.carried_sd,
                "levels": self.levels,
                "orders_tried": self.tried,
                "converged": self.converged,
            }
        )
        return found


def estimate_noise(
    stretches: Sequence[Stretch],
    carried: Process | None,
    tried: Sequence[Contender],
    known: float = 0.0,
    *,
    with_error: bool = False,
) -> tuple[NoiseEstimate, tuple[Contender, ...]]:
    """Estimate the noise of residuals, given the parameters of the model.

    Parameters
    ----------
    stretches : sequence of Stretch
        Sampled alike.
    carried : Process or None
        What noise of the other channel with a standard deviation of 1 would add.
    tried : sequence of Contender
        Of which the best by AICc (Hurvich & Tsai 1989, Biometrika 76:297-307) is taken.
    known : float
        Standard deviation that noise of the other channel has at least. A residual tells the two
        noises apart by their colour alone: where less of this one is found, it is held, and the
        instrument's own is estimated anew beside it.
    with_error : bool
        Whether to say how well the size of the carried noise is known, which takes further fits.

    Returns
    -------
    NoiseEstimate
    tuple of Contender
        The best of them, the best first.

    Raises
    ------
    ValueError
        Where no order has a finite likelihood.
    """
    trials = 1 + max(s.trial for s in stretches)
    scale = np.sqrt(np.mean(np.concatenate([_level(s.residual) ** 2 for s in stretches])))
    if scale == 0:
        # A perfect fit: any level will do that is far below what a computer resolves.
        quiet = Process(np.ones(1), np.ones(1), 1e-12)
        return NoiseEstimate(quiet, None, np.ones(trials), 0.0, 0, True), tuple(tried)
    scaled = [s.over(float(scale)) for s in stretches]
    unit = 1.0
    if carried is not None:
        unit = 1.0 / carried.sd
        carried = Process(carried.ar, carried.ma, 1.0 / np.sqrt(carried.autocovariance(0)[0]))
    chosen = _Sample(_budget(scaled), carried)
    ranked = chosen.ranked(tried)
    if not ranked:
        raise ValueError("found no noise that gives the residual a finite likelihood")
    order, values = ranked[0].order, ranked[0].values
    values, _, converged = chosen.fitted(order, values, restricted=True)
    levels = np.ones(trials)
    if trials > 1:
        differing = _levels(scaled, chosen.noise(order, values), trials)
        if differing is not None:
            levels = differing
            scaled = [s.over(1.0, float(levels[s.trial])) for s in scaled]
            chosen = _Sample(_budget(scaled), carried)
            values, _, converged = chosen.fitted(order, values, restricted=True)
    found = _Found(chosen, scaled, order, values, converged)
    error = 0.0
    if carried is not None and order.carried:
        least = known / (scale * unit)
        if found.carried_sd * _AS_KNOWN <= least:
            found = found.with_carried(least)
        elif with_error:
            error = found.carried_error(least)
    noise, sd = found.noise, scale * found.sd
    parts = [Process(part.ar, part.ma, part.sd * sd) for part in noise.parts]
    return (
        NoiseEstimate(
            parts[0],
            parts[1] if order.carried else None,
            levels,
            float(scale),
            len(tried),
            bool(found.converged),
            error,
        ),
        (Contender(order, found.values), *ranked[1:_SHORTLIST]),
    )


def _level(residual: np.ndarray) -> np.ndarray:
    return residual - residual.mean()


def _basis(jacobian: np.ndarray) -> np.ndarray:
    """What turns derivatives into independent directions of length 1, shape (k, rank).

    Where two parameters do the same, the determinant of both is but rounding.
    """
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    _, length, turned = np.linalg.svd(jacobian / size, full_matrices=False)
    there = length > _SAME_DIRECTION * length.max(initial=0.0)
    return np.asarray(turned[there].T / length[there] / size[:, None])


def _budget(stretches: Sequence[Stretch]) -> list[Stretch]:
    """As many of the samples as a colour needs, in pieces from all over the recordings."""
    if sum(s.residual.size for s in stretches) <= _MOST_SAMPLES:
        return list(stretches)
    pieces = []
    for s in stretches:
        n = -(-s.residual.size // _CHUNK)
        ends = np.linspace(0, s.residual.size, n + 1).astype(int)
        pieces += [s.part(a, b) for a, b in pairwise(ends)]
    kept = max(1, len(pieces) * _MOST_SAMPLES // sum(p.residual.size for p in pieces))
    return [pieces[i] for i in np.unique(np.linspace(0, len(pieces) - 1, kept).astype(int))]


def _levels(stretches: Sequence[Stretch], noise: ProcessSum, n: int) -> np.ndarray | None:
    """Levels by trial, where they differ by more than an AIC allows; their mean square is 1."""
    squares, counts = _whitened_squares(stretches, noise, n)
    variances = squares / np.maximum(counts, 1)
    if np.any(variances <= 0):
        return None
    common = squares.sum() / counts.sum()
    gain = counts.sum() * np.log(common) - counts @ np.log(variances)
    return np.sqrt(variances / common) if gain > 2 * (n - 1) else None


def _variance(stretches: Sequence[Stretch], noise: ProcessSum, k: int) -> float:
    """Variance of the whitened residual, of which a fit took out so many directions."""
    squares, counts = _whitened_squares(stretches, noise, 1 + max(s.trial for s in stretches))
    freedom = counts.sum() - k
    return float(squares.sum() / max(1, freedom))


def _whitened_squares(
    stretches: Sequence[Stretch], noise: ProcessSum, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squared whitened residuals by trial, and the samples they are worth."""
    squares, counts = np.zeros(n), np.zeros(n)
    longest = max(s.residual.size for s in stretches)
    alike = noise.whitening(longest) if stretches[0].beside is None else None
    for s in stretches:
        own = alike or noise.whitening(s.residual.size, s.beside)
        white, _ = own.without_level(s.residual[:, None])
        squares[s.trial] += np.sum(white**2)
        counts[s.trial] += len(white) - 1
    return squares, counts


class _Sample:
    """Stretches by length, and their likelihood as a function of the noise's parameters."""

    def __init__(self, stretches: Sequence[Stretch], carried: Process | None) -> None:
        self.carried = carried
        self.has_beside = stretches[0].beside is not None
        self._stretches = stretches
        self._centred = [_level(s.residual) for s in stretches]
        self._basis = _basis(np.concatenate([s.jacobian for s in stretches]))
        self.k = self._basis.shape[1]
        sizes = [s.residual.size for s in stretches]
        self.n_samples, self.shortest = sum(sizes), min(sizes)

    @cached_property
    def _by_length(self) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """Residuals alone and with what a fit took out of them, lengths, and how many have each."""
        lengths = sorted({s.residual.size for s in self._stretches})
        residuals, both, numbers = [], [], []
        for n in lengths:
            those = [s for s in self._stretches if s.residual.size == n]
            residuals.append(np.column_stack([s.residual for s in those]))
            derivatives = [s.jacobian @ self._basis for s in those]
            both.append(np.column_stack([residuals[-1], *derivatives]))
            numbers.append(len(those))
        columns = [np.concatenate([one.ravel() for one in those]) for those in (residuals, both)]
        return (columns[0], columns[1]), np.array(lengths), np.array(numbers)

    @cached_property
    def _shocks(self) -> list[np.ndarray]:
        """What a long autoregression leaves of the residuals."""
        found = polynomial(_reflections(self._centred, min(_LONG_AR, self.shortest // 6)))
        return [lfilter(found, [1.0], r) for r in self._centred]

    def ranked(self, tried: Sequence[Contender]) -> list[Contender]:
        """Contenders with the values of their best fit, the best by AICc first.

        Beside noise of known size those without values are ranked roughly first.
        """
        if self.has_beside and any(not one.values.size for one in tried):
            fresh = [one for one in tried if not one.values.size]
            rough = self._without_beside.ranked(fresh)[:_SHORTLIST]
            others = [one for one in tried if one.values.size]
            tried = [*others, *(Contender(o, self._started(o, v)) for o, v in rough)]
        found = []
        for i, (order, known) in enumerate(tried):
            spare = self.n_samples - order.size - 2
            if spare <= 0 or 4 * (order.p + order.q) > self.shortest:
                continue
            starts = [self._started(order, known)] if known.size else self.starts(order)
            if len(tried) == len(starts) == 1:
                return [Contender(order, starts[0])]
            fits = [self.fitted(order, start, restricted=False) for start in starts]
            values, cost, _ = min(fits, key=lambda fit: fit[1])
            criterion = 2 * cost + 2 * order.size * self.n_samples / spare
            if np.isfinite(criterion):
                found.append((criterion, i, Contender(order, values)))
        return [contender for _, _, contender in sorted(found, key=lambda f: f[:2])]

    def noise(self, order: Order, values: np.ndarray) -> ProcessSum:
        """The noise that the optimiser's values stand for, its own innovations of variance 1.

        Beside noise of known size, at its level.
        """
        partial = np.tanh(values[: order.p + order.q])
        level = float(np.exp(values[order.p + order.q])) if self.has_beside else 1.0
        own = Process(polynomial(partial[: order.p]), polynomial(partial[order.p :]), level)
        if not order.carried or self.carried is None:
            return ProcessSum((own,))
        sd = self.carried.sd * np.exp(values[-1])
        return ProcessSum((own, Process(self.carried.ar, self.carried.ma, sd)))

    @cached_property
    def _without_beside(self) -> _Sample:
        """The same without noise of known size, its expected share taken out of the residuals."""
        known = [np.asarray(s.beside, float) for s in self._stretches]
        pairs = list(zip(self._centred, known, strict=True))
        clear = np.concatenate([c[v == 0] for c, v in pairs])
        usual = max(float(np.mean(clear**2)), 1e-300) if clear.size else 1.0
        return _Sample(
            [
                Stretch(c * usual / (usual + v), s.jacobian, s.trial)
                for s, (c, v) in zip(self._stretches, pairs, strict=True)
            ],
            self.carried,
        )

    def starts(self, order: Order) -> list[np.ndarray]:
        """Values to start from.

        With carried noise that is of two kinds, each in the best of some shares: an own noise that
        is nearly white, and one of the colour of all that is left. From either alone many of the
        likeliest noises are missed, some by hundreds of nats.
        """
        if not order.carried:
            return [self._coloured(order)]
        nearly_white = np.zeros(order.size - 1)
        nearly_white[: min(1, order.p)] = -0.5
        owns = [nearly_white, self._coloured(order)] if order.size > 1 else [nearly_white]
        return [self._in_best_share(order, own) for own in owns]

    def _in_best_share(self, order: Order, own: np.ndarray) -> np.ndarray:
        """Values of an own noise, with as much of the carried one as is likeliest beside it."""
        tried = [np.append(own, 0.5 * np.log(share)) for share in _SHARES]
        costs = [self.cost(order, values, restricted=False) for values in tried]
        return tried[int(np.argmin(costs))]

    def _started(self, order: Order, values: np.ndarray) -> np.ndarray:
        """Values with a level of the own noise where it is sought, and without where it is not."""
        at = order.p + order.q
        if values.size == order.size + self.has_beside:
            return values
        if not self.has_beside:
            found = np.delete(values, at)
            found[-1:] -= order.carried * values[at]
            return found
        with_level = np.insert(values, at, 0.0)
        noise = self.noise(order, with_level)
        variance = sum(float(part.autocovariance(0)[0]) for part in noise.parts)
        # That of the residual is 1; what is carried is no longer a share of the own noise.
        with_level[at:] -= 0.5 * np.log(variance)
        return with_level

    def _coloured(self, order: Order) -> np.ndarray:
        """Own noise of the residuals' colour (Hannan & Rissanen 1982, Biometrika 69:81-94)."""
        if not order.p + order.q:
            return np.zeros(0)
        p, q, m = order.p, order.q, max(order.p, order.q)
        rows, targets = [], []
        for r, e in zip(self._centred, self._shocks, strict=True):
            lagged = [-r[m - i : r.size - i] for i in range(1, p + 1)]
            lagged += [e[m - j : r.size - j] for j in range(1, q + 1)]
            rows.append(np.column_stack(lagged))
            targets.append(r[m:])
        found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
        partial = np.concatenate([_partials(found[:p]), _partials(found[p:])])
        return np.asarray(np.arctanh(partial))

    def cost(self, order: Order, values: np.ndarray, *, restricted: bool) -> float:
        """Minus the log likelihood, the level of the noise and those of stretches profiled out.

        Beside noise of known size the noise's level is one of the values.
        """
        try:
            if self.has_beside:
                return 0.5 * float(deviance(values, self._left_beside(order, restricted)))
            scaled, freedom = scaled_residuals(values, self._left(order, restricted))
        except np.linalg.LinAlgError:
            return np.inf
        return 0.5 * freedom * float(np.log(scaled @ scaled / freedom))

    def _left(self, order: Order, restricted: bool) -> Residuals:
        """The residuals, with what a fit took out of them where that counts."""
        columns, lengths, numbers = self._by_length
        k = self.k if restricted else 0
        carried = self._carried(order)
        return Residuals(order.p, order.q, carried, columns[restricted], lengths, numbers, k)

    def _left_beside(self, order: Order, restricted: bool) -> Left:
        """The same beside noise of known size."""
        columns, lengths, variances = self._beside
        k = self.k if restricted else 0
        carried = self._carried(order)
        return Left(order.p, order.q, carried, columns[restricted], lengths, variances, k)

    def _carried(self, order: Order) -> tuple[np.ndarray, np.ndarray]:
        if not order.carried or self.carried is None:
            return _NO_PROCESS
        return self.carried.ar, self.carried.sd * self.carried.ma

    @cached_property
    def _beside(self) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """Residuals alone and with what a fit took out of them, lengths, and the noise beside."""
        alone = np.concatenate([s.residual for s in self._stretches])
        both = [np.column_stack([s.residual, s.jacobian @ self._basis]) for s in self._stretches]
        lengths = np.array([s.residual.size for s in self._stretches])
        known = np.concatenate([np.asarray(s.beside, float) for s in self._stretches])
        return (alone, np.concatenate([one.ravel() for one in both])), lengths, known

    def fitted(
        self, order: Order, start: np.ndarray, *, restricted: bool, held: bool = False
    ) -> tuple[np.ndarray, float, bool]:
        """Best values, their cost, and whether the optimiser ended by itself.

        With the share of the carried noise `held` where it is.
        """
        n = order.size + self.has_beside
        n_free = n - held
        if not n_free:
            return start, self.cost(order, start, restricted=restricted), True
        lower = np.full(n, -_MOST_CORRELATED)
        if self.has_beside:
            lower[order.p + order.q] = -_MOST_LEVEL
        if order.carried:
            lower[-1] = -_MOST_LEVEL if self.has_beside else -_MOST_CARRIED
        bounds = lower[:n_free], -lower[:n_free]
        try:
            if self.has_beside:
                best, ended = most_likely(start, self._left_beside(order, restricted), *bounds)
            else:
                best, ended = least_squares(start, self._left(order, restricted), *bounds)
        except np.linalg.LinAlgError:
            return start, np.inf, False
        return best, self.cost(order, best, restricted=restricted), bool(ended)


@dataclass(frozen=True, eq=False)
class _Found:
    """A noise that was found; its carried part may be held at another size, the own sought anew."""

    sample: _Sample
    stretches: Sequence[Stretch]
    order: Order
    values: np.ndarray
    converged: bool

    @cached_property
    def noise(self) -> ProcessSum:
        """At the level of `values`."""
        return self.sample.noise(self.order, self.values)

    @cached_property
    def sd(self) -> float:
        """What multiplies `noise`."""
        if self.sample.has_beside:
            return 1.0
        return float(np.sqrt(_variance(self.stretches, self.noise, self.sample.k)))

    @property
    def carried_sd(self) -> float:
        """Standard deviation of what is carried, before it is."""
        return self.sd * self.noise.parts[1].sd

    def with_carried(self, sd: float) -> _Found:
        """The most likely with so much carried noise."""
        found, slope = self, 1.0
        for _ in range(_HELD_ROUNDS):
            missing = np.log(sd / found.carried_sd)
            if abs(missing) < np.log(_AS_KNOWN):
                break
            # Its share of the own noise, which is less the more this one is.
            last = found.values[-1] + missing / slope
            most = _MOST_LEVEL if self.sample.has_beside else _MOST_CARRIED
            start = np.append(found.values[:-1], np.clip(last, -most, most))
            before = found.values[-1]
            values, _, converged = self.sample.fitted(self.order, start, restricted=True, held=True)
            found = replace(found, values=values, converged=converged)
            if (change := values[-1] - before) == 0:
                break
            gained = missing - np.log(sd / found.carried_sd)
            slope = float(np.clip(gained / change, _LEAST_SLOPE, 1.0))
        return found

    def carried_error(self, least: float) -> float:
        """Standard error of the carried variance, over it, where its sd is no less than `least`.

        By what the likelihood loses down to half of it, or to the least: where its colour is the
        own noise's there is no curvature at the optimum to go by.
        """
        most = max(1 - (least / self.carried_sd) ** 2, 0.0)  # that it can be too large by
        share = max(1 - most, 0.5)
        less = self.with_carried(self.carried_sd * np.sqrt(share))
        lost = less.cost - self.cost
        return min(most, -float(np.log(share)) / np.sqrt(2 * lost)) if lost > 0 else most

    @property
    def cost(self) -> float:
        """Minus the restricted log likelihood."""
        return self.sample.cost(self.order, self.values, restricted=True)


def _reflections(pieces: Sequence[np.ndarray], order: int) -> np.ndarray:
    """Partial autocorrelations by Burg's method, pooled over pieces."""
    forward, backward, found = list(pieces), list(pieces), []
    for _ in range(order):
        ahead = [f[1:] for f in forward]
        behind = [b[:-1] for b in backward]
        shared = sum(float(f @ b) for f, b in zip(ahead, behind, strict=True))
        power = sum(float(f @ f + b @ b) for f, b in zip(ahead, behind, strict=True))
        k = -2 * shared / power if power else 0.0
        forward = [f + k * b for f, b in zip(ahead, behind, strict=True)]
        backward = [b + k * f for f, b in zip(ahead, behind, strict=True)]
        found.append(k)
    return np.array(found)


def _partials(coefficients: np.ndarray) -> np.ndarray:
    """Inverse of `polynomial`, moved inside the bounds where that has none."""
    found, rest = [], np.concatenate([[1.0], coefficients])
    while rest.size > 1:
        k = float(np.clip(rest[-1], -0.98, 0.98))
        found.append(k)
        rest = (rest - k * rest[::-1])[:-1] / (1 - k**2)
    return np.array(found[::-1])
