"""What a torque that no effect stands behind may be made of: columns of one Gaussian process.

What a joint can resist by: its present angle and velocity (static), how far it moved since it
turned back (hysteresis), its past motion (memory), time (stiffness and damping that vary alike in
every trial; drift of the recorder, alike or not), where the torque was imposed a filter or shift of
the recorder, and the model's own parameters, if they are not the same in all trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identifiability.inference.likelihood.carried import by_admittance
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.unexplained.terms import Term, Terms, interpolation
from identifiability.investigation.unexplained.traces import Response
from identifiability.measurement.perturbations import imposed_motion

_MOST_COLUMNS, _NEGLIGIBLE = 25, 1e-3  # of one term; share of its largest direction
_MOST_OWN = 4  # of one trial
_MOST_INCONSTANT, _PARTS = 60, 12  # directions; parts of all trials together, about
_VARYING_NODES, _VARYING_STEP = 20, 0.1  # number at most; s at least
_LEAST_NET = 0.02  # share of a kind that must be beyond a model's parameters, to be sized by it


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


def motions(evaluator: Evaluator, best: Evaluated) -> tuple[list[Motion], list[Motion]]:
    """Motion that took place in each trial, as a model that fits well says.

    And the same with more noise of the angle, where it was imposed; else none.
    """
    band = evaluator.band
    problem = band.problem(best.model, refined=best.refined, scheme=best.scheme)
    predicted = [p.response.copy() for p in band.prepared]
    for response, span, trial in zip(
        band.responses(problem, best.x), band.spans, band.trial, strict=True
    ):
        predicted[trial][span] = response
    moved = []
    for p, response in zip(band.prepared, predicted, strict=True):
        rate = np.gradient(response, p.interval)
        moved.append(Motion(p.interval, response, rate, response, rate))
    if not band.angle_imposed:
        return moved, []
    motion, probed = (
        [
            replace(m, angle=a, velocity=imposed_motion(p.trial.time, a).signals[:, 1])
            for m, p, a in zip(moved, band.prepared, angles, strict=True)
        ]
        if angles
        else []
        for angles in ([p.trial.angle for p in band.prepared], evaluator.reference.probed)
    )
    return motion, probed


def columns_of(
    evaluator: Evaluator, motion: Sequence[Motion], probed: Sequence[Motion]
) -> dict[str, Columns]:
    """By kind, what each unit adds to the response, by stretch; of size 1 all together.

    Parameters
    ----------
    evaluator : Evaluator
    motion, probed : sequence of Motion
        See `motions`.
    """
    joint = evaluator.reference.joint
    values = {"K": max(float(joint[0]), 1e-3), "B": max(float(joint[1]), 1e-4)}
    every, n = [*motion, *probed], len(motion)
    respond = _response(evaluator, every)
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
    if not evaluator.band.angle_imposed:
        found["sensor"] = [_reduced(terms.sensor(), n)]
    return {
        kind: _compared(
            evaluator.band, len(motion), [np.hstack(c) for c in zip(*parts, strict=True)]
        )
        for kind, parts in found.items()
    }


def _compared(band: Band, n: int, by_trial: list[np.ndarray]) -> Columns:
    """Columns of a kind at the samples that are compared; the trials come before their probes."""
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
    counts = np.isin(np.arange(len(there)), band.probed_ones)
    changed = zip(there, probed, counts, strict=False)
    return Columns(there, [counted * (b - a) for a, b, counted in changed])


def inconstant(band: Band, found: Evaluated) -> tuple[Columns, float]:
    """What a model's parameters do if they are not the same from trial to trial.

    Or from one part of a long record to the next. A description of what it does not know has
    to bend to every condition; a mechanism does not. With the size [rad or Nm] of what they do
    if all of them change by themselves.
    """
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


def net(columns: Mapping[str, Columns], found: Evaluated) -> dict[str, Columns]:
    """The same, each kind of size 1 in what a model's own parameters could not do as well."""
    out = {}
    for kind, parts in columns.items():
        white = found.weights.whitened(parts.there)
        taken = np.linalg.solve(found.precision, found.directions.T @ white)
        size = max(_size(without(parts.there, found, taken)), _LEAST_NET)
        out[kind] = Columns([c / size for c in parts.there], [c / size for c in parts.probed])
    return out


def without(parts: list[np.ndarray], found: Evaluated, taken: np.ndarray) -> list[np.ndarray]:
    """Columns by stretch without what the parameters' coordinates take over of them."""
    return [
        part - raw[:, 1:] @ (found.turns @ taken)
        for part, raw in zip(parts, found.raw, strict=True)
    ]


def _size(parts: Sequence[np.ndarray]) -> float:
    """Root mean square of what columns add, each with a weight of its own of variance 1."""
    return max(float(np.sqrt(np.mean(np.sum(np.concatenate(parts) ** 2, axis=1)))), 1e-300)


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
