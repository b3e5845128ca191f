"""A torque that no effect of a model stands behind, in the same likelihood as the effects.

A Gaussian process over what a joint can resist by: its present angle and velocity (static), how far
it moved since it turned back (hysteresis), its past motion (memory), time (stiffness and damping
that vary alike in every trial; drift of the recorder, alike or not), where the torque was imposed a
filter or shift of the recorder, and the model's own parameters, if they are not the same in all
trials. Each kind has one size, of highest evidence. What else is not the same in every trial is
noise, of whatever colour.

Noise of an imposed angle is in what a discrepancy would be made of, too. A torque with memory could
filter that noise away, as Wiener's filter would, and is no physics. So what the noise adds to the
columns is taken off, as it is of the model's own parameters, by probes: see `_known`.

A model is as exact as its equations. So a model whose effects need a discrepancy of no more than a
tenth of what they explain is still that model; one that needs more is that model and something
unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg

from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.columns import (
    Columns,
    columns_of,
    inconstant,
    motions,
    net,
    without,
)
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator, best_of
from identifiability.investigation.posterior.growing import growing_noise, liveliness
from identifiability.investigation.posterior.noises import Weighed, Weights

_CHANGES = 0.5  # of its value, by which a parameter may differ
_LARGEST, _SMALLEST, _FIRST = 3.0, 1e-6, 0.1  # sizes, over the response's
_COUNTS = 1e-4  # size, over the response's, from which a kind is there
_LOG_RANGE = np.log(_LARGEST / _COUNTS)  # of a kind's size, whose prior is uniform in ratios
_STEPS, _MOVED = 80, 0.03
_KEPT = 0.5  # share of what a slope promises, that a step along it must keep
_ROUNDS, _GAIN = 12, 0.5  # of noise and discrepancy in turn; nats that one must bring
_MOST_ACTIVE = 0.25  # share of the samples that may go into directions of the discrepancy
_RIDGE = 1e-10  # of columns that repeat each other
_WORTH = 1.0  # nats below which no discrepancy is looked for any further


@dataclass(frozen=True, eq=False)
class Discrepant:
    """A model with a discrepancy beside it.

    Attributes
    ----------
    log_evidence : float
        In nats.
    sizes : dict of str to float
        By kind, root mean square of what it adds to the response, over the response's. What the
        model's own parameters could do as well does not count.
    size : float
        The same of all kinds together, which may cancel each other.
    """

    log_evidence: float
    sizes: dict[str, float]
    size: float
    # The prior's size of each kind [rad or Nm] and the noise, from which another model may begin.
    _reached: tuple[np.ndarray, Weights] | None = field(default=None, repr=False)

    @property
    def kind(self) -> str:
        """The largest kind; "none" where there is none."""
        if not self.sizes or max(self.sizes.values()) < _COUNTS:
            return "none"
        return max(self.sizes, key=lambda kind: self.sizes[kind])


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What a discrepancy may be made of, for all models.

    Attributes
    ----------
    evaluator : Evaluator
    columns : mapping of str to Columns
        By kind.
    noise : Weights
        That of a model that fits well: what a model leaves beside its discrepancy may be alike.
    """

    evaluator: Evaluator
    columns: Mapping[str, Columns]
    noise: Weights

    def beside(
        self, found: Evaluated, most: float | None = None, nested: Discrepant | None = None
    ) -> Discrepant:
        """A model with a discrepancy, noise and discrepancy estimated in turn.

        Parameters
        ----------
        found : Evaluated
        most : float, optional
            Largest root mean square [rad or Nm] of each kind; a few times the response's by
            default.
        nested : Discrepant, optional
            Of a model that this one contains, to begin from too.
        """
        own, size = inconstant(self.evaluator.band, found)
        cap = _LARGEST * self.evaluator.band.scale if most is None else most
        caps = np.append(np.full(len(self.columns), cap), min(cap, _CHANGES * size))
        columns = net({**self.columns, "inconstant": own}, found)
        beside = _Beside(self.evaluator, columns, caps, self._lively)
        # Noise and discrepancy stay near where they start from: what a model leaves without one
        # is more and slower than what it leaves beside it.
        first = np.minimum(_FIRST * self.evaluator.band.scale, caps)
        starts = [(first, found.weights)]
        if self.noise is not found.weights:
            starts.append((first, self.noise))
        if nested is not None and nested._reached is not None:
            starts.append((np.minimum(nested._reached[0], caps), nested._reached[1]))
        return best_of(lambda start: beside.of(found, *start), starts)

    def inexact(
        self, found: Evaluated, most: float, nested: Discrepant | None = None
    ) -> tuple[Discrepant, Discrepant]:
        """A model with any discrepancy, and with one that its equations' error explains.

        No more can be missing than is left. Beside a narrow resonance a discrepancy may add far
        more than that, which the model's own parameters, moved, and the noise's colour take back.

        Parameters
        ----------
        found : Evaluated
        most : float
            Size over the response's, as in `Discrepant`, that its equations may be wrong by.
        nested : Discrepant, optional
            Of a model that this one contains, with any discrepancy: see `beside`.
        """
        free = self.beside(found, nested=nested)
        left = found.weights.estimate.rms / self.evaluator.band.scale
        if min(free.size, left) <= most:
            return free, free
        return free, self.beside(found, most * self.evaluator.band.scale)

    @cached_property
    def _lively(self) -> np.ndarray:
        return np.concatenate(liveliness(self.evaluator.band))


@dataclass(frozen=True, eq=False)
class _Beside:
    """Discrepancies of one model, by kind, what each unit adds to the response, by stretch."""

    evaluator: Evaluator
    columns: Mapping[str, Columns]
    caps: np.ndarray
    lively: np.ndarray

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of torque that there may be."""
        return tuple(self.columns)

    @cached_property
    def _all(self) -> list[np.ndarray]:
        parts = zip(*(columns.there for columns in self.columns.values()), strict=True)
        return [np.hstack(part) for part in parts]

    @cached_property
    def _noise(self) -> list[np.ndarray]:
        """What probes add to them; empty without."""
        parts = zip(*(columns.probed for columns in self.columns.values()), strict=True)
        return [np.hstack(part) for part in parts]

    @cached_property
    def _owner(self) -> np.ndarray:
        """Number of the kind that each column belongs to."""
        widths = [columns.there[0].shape[1] for columns in self.columns.values()]
        return np.repeat(np.arange(len(widths)), widths)

    def of(self, found: Evaluated, sizes: np.ndarray, weights: Weights) -> Discrepant:
        """The model with the discrepancy of highest evidence, from some sizes and noise on."""
        evaluator, band = self.evaluator, self.evaluator.band
        here, best = found, None
        if weights is not found.weights:
            here = evaluator.evaluated(found.problem, found.x, weights, found.refined)
        tried = (*evaluator.orders, *weights.contenders[:1])
        for _ in range(_ROUNDS):
            white = here.weights.whitened(self._all)
            shared = here.directions.T @ white
            taken = np.linalg.solve(here.precision, shared)
            inner = white.T @ white - shared.T @ taken
            # In noise of another colour the best parameters are elsewhere.
            own = here.weights.gain * here.weights.whitened(here.probes) if here.probes else None
            best_alone, alone = _best_alone(here, band, own)
            # What the parameters could take over is theirs.
            along = white.T @ here.white - taken.T @ (here.directions.T @ here.white)
            if own is not None:
                noise = here.weights.gain * here.weights.whitened(self._noise)
                noise -= own[:, 1:] @ here.turns @ taken
                inner, along = _known(inner, along, noise, own[:, 0])
            gain, sizes, mean = self._sized(inner, along, sizes)
            there = int(np.sum(sizes > _COUNTS * band.scale))
            log_evidence = here.log_evidence + alone
            log_evidence += gain - there * np.log(_LOG_RANGE)
            moved = best_alone - taken @ mean
            left = here.white - white @ mean - here.directions @ moved
            rms = here.weights.estimate.rms
            more, share = growing_noise(left, self.lively, min(1.0, (self.caps[0] / rms) ** 2))
            grows = more > np.log(_LOG_RANGE)
            log_evidence += (more - np.log(_LOG_RANGE)) * grows
            if best is not None and log_evidence < best.log_evidence + _GAIN:
                break
            beyond = np.concatenate(without(self._all, here, taken))
            by_kind = {
                kind: self._rms(beyond[:, self._owner == i] @ mean[self._owner == i])
                for i, kind in enumerate(self.kinds)
            }
            by_kind["unrepeatable"] = float(np.sqrt(share) * rms / band.scale) if grows else 0.0
            whole = self._rms(beyond @ mean) ** 2 + by_kind["unrepeatable"] ** 2
            reached = sizes, here.weights
            best = Discrepant(log_evidence, by_kind, float(np.sqrt(whole)), reached)
            if gain < _WORTH:
                break
            raw = self._freed(here, inner, sizes, [columns @ mean for columns in self._all])
            weights = evaluator.reference.weights(raw, tried, like=found.weights)
            tried = weights.contenders[:1]
            here = evaluator.evaluated(found.problem, found.x, weights, found.refined)
        assert best is not None
        return best

    def _freed(
        self, here: Evaluated, inner: np.ndarray, sizes: np.ndarray, response: list[np.ndarray]
    ) -> list[np.ndarray]:
        """A model's residual without its discrepancy, with all that was taken out of it."""
        scale = sizes[self._owner]
        eigenvalues, vectors = np.linalg.eigh(inner * np.outer(scale, scale))
        most = int(_MOST_ACTIVE * self.evaluator.band.n_samples)
        # What the data say more about than the prior.
        active = vectors[:, eigenvalues > 1][:, -most:]
        added = [(columns * scale) @ active for columns in self._all]
        left = [raw[:, 0] - own for raw, own in zip(here.raw, response, strict=True)]
        taken = [np.column_stack([raw[:, 1:], a]) for raw, a in zip(here.raw, added, strict=True)]
        white = here.weights.whitened(
            [np.column_stack(pair) for pair in zip(left, taken, strict=True)]
        )
        rest = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-10)[0]
        return [
            np.column_stack([r - columns @ rest, columns])
            for r, columns in zip(left, taken, strict=True)
        ]

    def _sized(
        self, inner: np.ndarray, along: np.ndarray, sizes: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Sizes of highest evidence, what they add to it, and the weights' mean.

        By the fixed point of MacKay 1992 (Neural Computation 4:415-447).
        """
        least = _SMALLEST * self.evaluator.band.scale
        for _ in range(_STEPS):
            scale = sizes[self._owner]
            system = inner * np.outer(scale, scale)
            system.flat[:: len(system) + 1] += 1 + 1e-9
            factor = np.linalg.cholesky(system)
            inverse = scipy.linalg.lapack.dtrtri(factor, lower=1)[0]
            solved = inverse.T @ (inverse @ (scale * along))
            covariance = np.sum(inverse**2, axis=0)
            mean = scale * solved
            gain = 0.5 * float((scale * along) @ solved)
            gain -= float(np.sum(np.log(np.diag(factor))))
            wanted = np.empty_like(sizes)
            for i in range(sizes.size):
                own = self._owner == i
                determined = max(float(np.sum(1 - covariance[own])), 1e-9)
                wanted[i] = np.sqrt(np.sum(mean[own] ** 2) / determined)
            wanted = np.clip(wanted, least, self.caps)
            if np.max(np.abs(np.log(wanted / sizes))) < _MOVED:
                break
            sizes = np.sqrt(sizes * wanted)
        return gain, sizes, mean

    def _rms(self, response: np.ndarray) -> float:
        """Root mean square over the response's."""
        return float(np.sqrt(np.mean(response**2)) / self.evaluator.band.scale)


def _best_alone(here: Evaluated, band: Band, own: np.ndarray | None) -> tuple[np.ndarray, float]:
    """How far a model's coordinates are from their best, and what that is worth [nats].

    Nothing where a step there does not bring it: where noise of the angle is as much as may be
    taken off, the squares have a kink, and their slope on one side leads nowhere. That noise in
    its residual and derivatives is its `own`, whitened.
    """
    slope = here.directions.T @ here.white
    weighed = Weighed(here.problem, band, here.weights)
    if own is not None and weighed.takes_all(own):
        slope = slope - here.turns.T @ own[:, 1:].T @ own[:, 0]
    step = np.linalg.solve(here.precision, slope)
    promised = 0.5 * float(slope @ step)
    if promised < _WORTH:
        return step, promised
    moved = np.clip(here.x - here.turns @ step, here.problem.lower, here.problem.upper)
    kept = 0.5 * (weighed.squares(here.x) - weighed.squares(moved))
    if not kept > _KEPT * promised:
        return np.zeros_like(step), 0.0
    return step, promised


def _known(
    inner: np.ndarray, along: np.ndarray, noise: np.ndarray, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What is known of the weights of columns that noise is in.

    Corrected for it, least squares are without bias: `inner` less the noise's own, `along` less
    what the same noise has in common with the residual. Their weights vary by as much as without
    the correction, so where noise is most of the columns little is known of them (the information
    of Godambe 1960, Ann Math Stat 31:1208-1211).

    Parameters
    ----------
    inner : array, shape (m, m)
        Of the whitened columns.
    along : array, shape (m,)
        Of columns and residual.
    noise : array, shape (n, m)
        In the columns.
    residual : array, shape (n,)
        The same noise in the residual.

    Returns
    -------
    array, shape (m, m)
    array, shape (m,)
        What stands for both in a likelihood whose columns are known.
    """
    whole = inner + np.eye(len(inner)) * _RIDGE * np.max(np.diag(inner))
    share, vectors = scipy.linalg.eigh(noise.T @ noise, whole)
    turned, left = whole @ vectors, np.clip(1 - share, 0.0, 1.0)
    known = turned * left @ (vectors.T @ (along - noise.T @ residual))
    return np.asarray(turned * left**2 @ turned.T), np.asarray(known)


def discrepancy_of(evaluator: Evaluator, best: Evaluated) -> Discrepancy:
    """Prepare the discrepancies, for the motion that a model which fits well predicts."""
    return Discrepancy(evaluator, columns_of(evaluator, *motions(evaluator, best)), best.weights)
