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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.ndimage import uniform_filter1d

from identifiability.inference.likelihood.carried import by_admittance
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.unexplained.terms import Term, Terms, interpolation
from identifiability.investigation.unexplained.traces import Response
from identifiability.measurement.perturbations import imposed_motion

_MOST_COLUMNS, _NEGLIGIBLE = 25, 1e-3  # of one term; share of its largest direction
_MOST_OWN = 4  # of one trial
_MOST_INCONSTANT, _PARTS = 60, 12  # directions; parts of all trials together, about
_CHANGES = 0.5  # of its value, by which a parameter may differ
_VARYING_NODES, _VARYING_STEP = 20, 0.1  # number at most; s at least
_LARGEST, _SMALLEST, _FIRST = 3.0, 1e-6, 0.1  # sizes, over the response's
_COUNTS = 1e-4  # size, over the response's, from which a kind is there
_LOG_RANGE = np.log(_LARGEST / _COUNTS)  # of a kind's size, whose prior is uniform in ratios
_STEPS, _MOVED = 80, 0.03
_ROUNDS, _GAIN = 4, 0.5  # of noise and discrepancy in turn; nats that one must bring
_MOST_ACTIVE = 0.25  # share of the samples that may go into directions of the discrepancy
_AROUND = 0.05  # s, over which a motion is lively
_SHARES_TRIED, _LEAST_VARIANCE = 41, 1e-6
_LEAST_NET = 0.02  # share of a kind that must be beyond a model's parameters, to be sized by it
_RIDGE = 1e-10  # of columns that repeat each other
_WORTH = 1.0  # nats below which no discrepancy is looked for any further


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion that took place in a trial, as a model says.

    Attributes
    ----------
    interval : float
        Time [s] between samples.
    angle, velocity : array, shape (n,)
        Of the joint [rad, rad/s].
    residual, response_rate : array, shape (n,)
        The predicted response, which here stands for what there is to be explained, and its rate.
    """

    interval: float
    angle: np.ndarray
    velocity: np.ndarray
    residual: np.ndarray
    response_rate: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """Time [s] since the first sample, shape (n,)."""
        return np.arange(self.angle.size) * self.interval


@dataclass(frozen=True, eq=False)
class Columns:
    """What the units of one kind of discrepancy add to the response, by stretch.

    Attributes
    ----------
    there : list of array, shape (n, m)
    probed : list of array, shape (n, m)
        What probes of noise in an imposed angle add to these; none without.
    """

    there: list[np.ndarray]
    probed: list[np.ndarray]


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
    motion : sequence of Motion
        That took place in each trial, as a model that fits well says.
    probed : sequence of Motion
        The same with more noise of the angle, where it was imposed; else none.
    """

    evaluator: Evaluator
    motion: Sequence[Motion]
    probed: Sequence[Motion] = ()

    @cached_property
    def columns(self) -> Mapping[str, Columns]:
        """By kind, what each unit adds to the response, by stretch; of size 1 all together."""
        joint = self.evaluator.reference.joint
        values = {"K": max(float(joint[0]), 1e-3), "B": max(float(joint[1]), 1e-4)}
        every, n = [*self.motion, *self.probed], len(self.motion)
        respond = _response(self.evaluator, every)
        terms = Terms(every, respond, values)
        found = {
            "static": [_reduced(terms.static(), n)],
            "hysteresis": [_reduced(terms.hysteresis(), n)],
            "memory": [
                _reduced(terms.memory("memory", lambda v: v), n),
                _reduced(terms.memory("memory_positive", lambda v: np.maximum(v, 0)), n),
            ],
            "drift": [_reduced(terms.common_drift(), n), _own(terms.drift(), n)],
            "varying": [_varying(every, values, respond)],
        }
        # The rate of a torque that is predicted from a noisy angle is noise more than motion.
        if not self.evaluator.band.angle_imposed:
            found["sensor"] = [_reduced(terms.sensor(), n)]
        return {
            kind: self._compared([np.hstack(c) for c in zip(*parts, strict=True)])
            for kind, parts in found.items()
        }

    def _compared(self, by_trial: list[np.ndarray]) -> Columns:
        """Columns of a kind at the samples that are compared."""
        band, n = self.evaluator.band, len(self.motion)
        size = _size(by_trial[:n])
        there, probed = (
            [
                each[trial][span][:: band.every] / size
                for span, trial in zip(band.spans, band.trial, strict=True)
            ]
            if each
            else []
            for each in (by_trial[:n], by_trial[n:])
        )
        return Columns(there, [b - a for a, b in zip(there, probed, strict=False)])

    def beside(self, found: Evaluated, most: float | None = None) -> Discrepant:
        """A model with a discrepancy, noise and discrepancy estimated in turn.

        Parameters
        ----------
        found : Evaluated
        most : float, optional
            Largest root mean square [rad or Nm] of each kind; a few times the response's by
            default.
        """
        own, size = self._inconstant(found)
        cap = _LARGEST * self.evaluator.band.scale if most is None else most
        caps = np.append(np.full(len(self.columns), cap), min(cap, _CHANGES * size))
        columns = _net({**self.columns, "inconstant": own}, found)
        return _Beside(self.evaluator, columns, caps, self._lively).of(found)

    @cached_property
    def _lively(self) -> np.ndarray:
        return np.concatenate(liveliness(self.evaluator.band))

    def _inconstant(self, found: Evaluated) -> tuple[Columns, float]:
        """What a model's parameters do if they are not the same from trial to trial.

        Or from one part of a long record to the next. A description of what it does not know has
        to bend to every condition; a mechanism does not. With the size [rad or Nm] of what they do
        if all of them change by themselves.
        """
        band = self.evaluator.band
        longest = max(p.trial.duration for p in band.prepared)
        parts = max(1, round(_PARTS / len(band.prepared)))
        nodes = np.linspace(0.0, longest, parts + 1) if parts > 1 else np.zeros(1)

        def placed(derivatives: Sequence[np.ndarray]) -> list[np.ndarray]:
            out = []
            for columns, span, trial in zip(derivatives, band.spans, band.trial, strict=True):
                time = np.arange(span.start, span.stop)[:: band.every]
                time = time * band.prepared[trial].interval
                weight = interpolation(time, nodes) if parts > 1 else np.ones((time.size, 1))
                own = ((columns * found.x)[:, :, None] * weight[:, None, :]).reshape(time.size, -1)
                whole = np.zeros((time.size, len(band.prepared), own.shape[1]))
                whole[:, trial] = own
                out.append(whole.reshape(time.size, -1))
            return out

        columns = placed([raw[:, 1:] for raw in found.raw])
        largest = _largest(columns, min(_MOST_INCONSTANT, band.n_samples // 4))
        kept = [c @ largest for c in columns]
        size = _size(kept)
        probed = placed([probe[:, 1:] for probe in found.probes]) if found.probes else []
        return Columns([c / size for c in kept], [c @ largest / size for c in probed]), size


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

    def of(self, found: Evaluated) -> Discrepant:
        """The model with the discrepancy of highest evidence: see `Discrepancy.beside`."""
        evaluator, band = self.evaluator, self.evaluator.band
        sizes = np.minimum(_FIRST * band.scale, self.caps)
        problem = band.problem(
            found.model,
            refined=found.refined,
            scheme=found.scheme,
            probes=evaluator.reference.probes,
        )
        here, best = found, None
        tried = evaluator.orders
        for _ in range(_ROUNDS):
            white = here.weights.whitened(self._all)
            shared = here.directions.T @ white
            taken = np.linalg.solve(here.precision, shared)
            inner = white.T @ white - shared.T @ taken
            # What the parameters could take over is theirs.
            slope = here.directions.T @ here.white
            along = white.T @ here.white - taken.T @ slope
            if here.probes:
                noise = here.weights.gain * here.weights.whitened(self._noise)
                own = here.weights.gain * here.weights.whitened(here.probes)
                noise -= own[:, 1:] @ here.turns @ taken
                inner, along = _known(inner, along, noise, own[:, 0])
            gain, sizes, mean = self._sized(inner, along, sizes)
            there = int(np.sum(sizes > _COUNTS * band.scale))
            log_evidence = here.log_evidence + gain - there * np.log(_LOG_RANGE)
            moved = np.linalg.solve(here.precision, slope) - taken @ mean
            left = here.white - white @ mean - here.directions @ moved
            rms = here.weights.estimate.rms
            more, share = growing_noise(left, self.lively, min(1.0, (self.caps[0] / rms) ** 2))
            grows = more > np.log(_LOG_RANGE)
            log_evidence += (more - np.log(_LOG_RANGE)) * grows
            if best is not None and log_evidence < best.log_evidence + _GAIN:
                break
            net = np.concatenate(_without(self._all, here, taken))
            by_kind = {
                kind: self._rms(net[:, self._owner == i] @ mean[self._owner == i])
                for i, kind in enumerate(self.kinds)
            }
            by_kind["unrepeatable"] = float(np.sqrt(share) * rms / band.scale) if grows else 0.0
            whole = self._rms(net @ mean) ** 2 + by_kind["unrepeatable"] ** 2
            best = Discrepant(log_evidence, by_kind, float(np.sqrt(whole)))
            if gain < _WORTH:
                break
            raw = self._freed(here, inner, sizes, [columns @ mean for columns in self._all])
            weights = evaluator.reference.weights(raw, tried)
            tried = weights.contenders[:1]
            here = evaluator.evaluated(problem, found.x, weights, found.refined)
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
            factor = scipy.linalg.cho_factor(system, lower=True)
            solved = scipy.linalg.cho_solve(factor, scale * along)
            covariance = np.diag(scipy.linalg.cho_solve(factor, np.eye(len(system))))
            mean = scale * solved
            gain = 0.5 * float((scale * along) @ solved)
            gain -= float(np.sum(np.log(np.diag(factor[0]))))
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


def _net(columns: Mapping[str, Columns], found: Evaluated) -> dict[str, Columns]:
    """The same, each kind of size 1 in what a model's own parameters could not do as well."""
    out = {}
    for kind, parts in columns.items():
        white = found.weights.whitened(parts.there)
        taken = np.linalg.solve(found.precision, found.directions.T @ white)
        size = max(_size(_without(parts.there, found, taken)), _LEAST_NET)
        out[kind] = Columns([c / size for c in parts.there], [c / size for c in parts.probed])
    return out


def _size(parts: Sequence[np.ndarray]) -> float:
    """Root mean square of what columns add, each with a weight of its own of variance 1."""
    return max(float(np.sqrt(np.mean(np.sum(np.concatenate(parts) ** 2, axis=1)))), 1e-300)


def _without(parts: list[np.ndarray], found: Evaluated, taken: np.ndarray) -> list[np.ndarray]:
    """Columns by stretch without what the parameters' coordinates take over of them."""
    return [
        part - raw[:, 1:] @ (found.turns @ taken)
        for part, raw in zip(parts, found.raw, strict=True)
    ]


def liveliness(band: Band) -> list[np.ndarray]:
    """How lively the motion is about every compared sample, by stretch; its mean is 1.

    NaN where a rounded angle stands still, which then has no noise.
    """
    by_trial = []
    for p, stands in zip(band.prepared, band.stands, strict=True):
        size = max(3, round(_AROUND / p.interval))
        signals = [p.response, p.trial.angle] if band.angle_imposed else [p.response]
        rest = slice(p.first, p.first + size)
        energy = np.zeros(p.response.size)
        for signal in signals:
            moved = uniform_filter1d(signal - signal[rest].mean(), size)
            for part in (moved, np.gradient(moved)):
                square = uniform_filter1d(part**2, size)
                energy += square / max(float(square.mean()), 1e-300)
        by_trial.append(np.where(stands, np.nan, energy))
    found = [
        by_trial[trial][span][:: band.every]
        for span, trial in zip(band.spans, band.trial, strict=True)
    ]
    mean = float(np.nanmean(np.concatenate(found)))
    return [one / max(mean, 1e-300) for one in found]


def growing_noise(white: np.ndarray, lively: np.ndarray, most: float) -> tuple[float, float]:
    """What noise that grows with the motion adds to the log likelihood [nats], and its share.

    Noise of an instrument is there at rest as well. What a model leaves only where the joint moves
    is not noise, whatever its colour.

    Parameters
    ----------
    white : array, shape (n,)
        Whitened residual, of variance 1 were it noise.
    lively : array, shape (n,)
        Of mean 1; NaN for what does not count.
    most : float
        Largest share of the variance that may grow.
    """
    known = np.isfinite(lively)
    squares, lively = white[known] ** 2, lively[known]
    if not squares.size or not squares.any():
        return 0.0, 0.0
    shares = most * np.linspace(0.0, 1.0, _SHARES_TRIED)
    variances = 1 - shares[:, None] + shares[:, None] * lively
    variances = np.maximum(variances, _LEAST_VARIANCE)
    level = np.mean(squares / variances, axis=1)
    cost = 0.5 * np.sum(np.log(variances), axis=1) + 0.5 * squares.size * np.log(level)
    best = int(np.argmin(cost))
    return float(cost[0] - cost[best]), float(shares[best])


def discrepancy_of(evaluator: Evaluator, best: Evaluated) -> Discrepancy:
    """Prepare the discrepancies, for the motion that a model which fits well predicts."""
    band = evaluator.band
    problem = band.problem(best.model, refined=best.refined, scheme=best.scheme)
    predicted = [p.response.copy() for p in band.prepared]
    for response, window, span, trial in zip(
        problem.responses(best.x), band.windows, band.spans, band.trial, strict=True
    ):
        predicted[trial][span] = response[window]
    moved = []
    for p, response in zip(band.prepared, predicted, strict=True):
        rate = np.gradient(response, p.interval)
        moved.append(Motion(p.interval, response, rate, response, rate))
    if not band.angle_imposed:
        return Discrepancy(evaluator, moved)
    motion, probed = (
        [
            replace(m, angle=a, velocity=imposed_motion(p.trial.time, a).signals[:, 1])
            for m, p, a in zip(moved, band.prepared, angles, strict=True)
        ]
        if angles
        else []
        for angles in ([p.trial.angle for p in band.prepared], evaluator.reference.probed)
    )
    return Discrepancy(evaluator, motion, probed)


def _reduced(term: Term, n: int) -> list[np.ndarray]:
    """A term's columns by trial, in the largest directions of the first n."""
    root = term.roots(term.start)[0]
    columns = [c @ root for c in term.columns]
    largest = _largest(columns[:n], _MOST_COLUMNS)
    return [c @ largest for c in columns]


def _own(term: Term, n: int) -> list[np.ndarray]:
    """Columns by trial of a term that is another in each trial, in the largest directions."""
    columns = [c @ root for c, root in zip(term.columns, term.roots(term.start), strict=True)]
    reduced = [c @ _largest([c], _MOST_OWN) for c in columns[:n]]
    places = np.cumsum([0, *(c.shape[1] for c in reduced)])
    out = []
    for i, c in enumerate(columns):
        whole = np.zeros((len(c), places[-1]))
        # A probe of an imposed angle leaves the recorder's drift as it is.
        whole[:, places[i % n] : places[i % n + 1]] = reduced[i % n]
        out.append(whole)
    return out


def _varying(
    motion: Sequence[Motion], values: Mapping[str, float], respond: Response
) -> list[np.ndarray]:
    """Stiffness and damping that vary in time, alike in all trials."""
    longest = max(m.time[-1] for m in motion)
    nodes = np.arange(0.0, longest + _VARYING_STEP, max(_VARYING_STEP, longest / _VARYING_NODES))
    out = []
    for m in motion:
        at = interpolation(m.time, nodes)
        spring = values["K"] * m.angle[:, None] * at
        dashpot = values["B"] * m.velocity[:, None] * at
        out.append(respond.to(np.hstack([spring, dashpot]), m.interval))
    return out


def _largest(columns: Sequence[np.ndarray], most: int) -> np.ndarray:
    """Largest directions of the columns of all trials or stretches, so many at most."""
    gram = sum(c.T @ c for c in columns)
    eigenvalues, vectors = np.linalg.eigh(gram)
    kept = eigenvalues > _NEGLIGIBLE**2 * max(eigenvalues[-1], 1e-300)
    kept[: max(0, kept.size - most)] = False
    return np.asarray(vectors[:, kept])


def _response(evaluator: Evaluator, motion: Sequence[Motion]) -> Response:
    """How a torque shows in the response: by the admittance of K, B and I."""
    if evaluator.band.angle_imposed:
        return Response(None)
    longest: dict[float, int] = {}
    for m in motion:
        longest[m.interval] = max(longest.get(m.interval, 0), m.angle.size)
    joint = evaluator.reference.joint
    return Response({dt: by_admittance(joint, dt).impulse_response(n) for dt, n in longest.items()})
