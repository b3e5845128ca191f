"""Trials as they would be with an effect of some size, and whether it would show in them.

They are what was recorded, or another draw of its noise, and what the effect would have changed.
Both models are weighed on them as on the recording.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identifiability.inference.fitting import inside
from identifiability.inference.problem import Problem
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.noises import Weights, raw_residuals
from identifiability.investigation.posterior.weighing import Weighing
from identifiability.investigation.rules import Rules
from identifiability.joint.model import Model
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import Drive, imposed_motion

_LEAST = 1e-300  # probability, whose logarithm is taken
_SOLVER_SHARE = 0.01  # of a trace's square that the error of its integration may have


@dataclass(frozen=True, eq=False)
class Known:
    """A model in which nothing was found missing, beside which effects may hide.

    Attributes
    ----------
    evaluator : Evaluator
    model : Evaluated
    library : collection of str
        Keys of the effects that could be tried.
    rules : Rules
        Conventions.
    noise : Weights
        From which noise is drawn.
    seed : int
        Of draws of the noise.
    """

    evaluator: Evaluator
    model: Evaluated
    library: Collection[str]
    rules: Rules
    noise: Weights
    seed: int

    @classmethod
    def of(
        cls,
        evaluator: Evaluator,
        model: Evaluated,
        library: Collection[str],
        rules: Rules,
        seed: int,
    ) -> Known:
        """A model that was weighed."""
        return cls(evaluator, model, library, rules, likely_noise(evaluator, model), seed)


def likely_noise(evaluator: Evaluator, found: Evaluated) -> Weights:
    """Noise of a model by the order that is most probable, to draw from.

    By BIC (Schwarz 1978, Ann Stat 6:461-464). AICc, by which models are weighed, asks for the noise
    that predicts best; where that has more orders than there are, its spectrum has gaps by chance,
    in which a trace would be seen that others would not see.
    """
    tried = {c.order: c for c in (*evaluator.orders, *found.weights.contenders)}
    best, noise = -np.inf, found.weights
    for contender in tried.values():
        weights = evaluator.reference.weights(found.raw, [contender])
        here = evaluator.evaluated(found.problem, found.x, weights, found.refined)
        more = weights.n_parameters * (0.5 * np.log(evaluator.band.n_samples) - 1)
        if here.log_likelihood - more > best:
            best, noise = here.log_likelihood - more, weights
    return noise


@dataclass(frozen=True, eq=False)
class Hidden:
    """An effect that the trials may hide.

    Attributes
    ----------
    known : Known
        What it may hide beside.
    model : Model
        The model with it.
    key : str
    """

    known: Known
    model: Model
    key: str

    @property
    def _evaluator(self) -> Evaluator:
        return self.known.evaluator

    @property
    def _without(self) -> Evaluated:
        return self.known.model

    @cached_property
    def sizes(self) -> list[str]:
        """Its parameters that make it vanish; the first measures its size."""
        return [
            n
            for n, p in self.model.parameters.items()
            if n.startswith(f"{self.key}.") and p.null is not None and p.plain is None
        ]

    @property
    def size(self) -> Parameter:
        """What measures its size."""
        return self.model.parameters[self.sizes[0]]

    @property
    def has_one_size(self) -> bool:
        """Whether the others vanish by themselves where its size is found."""
        nulls = [self.model.parameters[name].null for name in self.sizes]
        return len(nulls) == 1 or all(n is not None and np.isfinite(n) for n in nulls)

    def values(self, strength: float) -> dict[str, float]:
        """All parameters with the effect at a strength: its size, or the inverse of a stiffness."""
        known = dict(self._without.values)
        shape = starting_values(self.model, known)[0] | known
        for name, p in self.model.parameters.items():
            if name.startswith(f"{self.key}.") and p.plain is None and p.null is None:
                shape[name] = p.nominal
        null = self.size.null
        assert null is not None
        size = null + strength if np.isfinite(null) else 1 / strength
        others = {name: self.model.parameters[name].null for name in self.sizes[1:]}
        return shape | {n: v for n, v in others.items() if v is not None} | {self.sizes[0]: size}

    def length(self, strength: float) -> float | None:
        """Standard deviations of known noise that its trace is long; None if it has no bounds.

        Without what K, B and I and other effects do as well.
        """
        trace = self._trace(self.values(strength))
        if trace is None:
            return None
        known, band = self._without, self._evaluator.band
        white = known.weights.whitened(band.stretches(trace[1][:, :, None]))[:, 0]
        shared = known.directions.T @ white
        left = white @ white - shared @ np.linalg.solve(known.precision, shared)
        return float(np.sqrt(max(left, 0.0)))

    def gained(
        self, strength: float, draws: Sequence[int] = (0,)
    ) -> list[tuple[float, float]] | None:
        """Nats that the effect's odds are beyond what a claim needs, and that priors took of them.

        At a strength, in draws of the noise, of which number 0 is the one that was recorded.
        """
        values = self.values(strength)
        trace = self._trace(values)
        if trace is None:
            return None
        found = []
        for draw in draws:
            one = self._gained(values, self._recorded(*trace, draw))
            if one is None:
                return None
            found.append(one)
        return found

    def _gained(
        self, values: Mapping[str, float], recorded: tuple[Problem, Problem]
    ) -> tuple[float, float] | None:
        without, changed = recorded
        known = self._without
        points = inside(without, np.array(self._starts(values, without)))
        tried = (*self._evaluator.orders, *known.weights.contenders)
        try:
            x = changed.free_vector(values)
            raw, _ = raw_residuals(changed, self._evaluator.band, x)
            own = self._evaluator.reference.weights(raw, tried)
            smaller = self._evaluator.settled(
                without, points, own, known.refined, also=known.weights.contenders
            )
            # A draw of the noise moves its best fit too; and what the compared band does not have
            # of its corners colours what it leaves.
            if self._has_corners:
                larger = self._evaluator.settled(
                    changed, x[None], own, known.refined, also=known.weights.contenders
                )
            else:
                x = self._evaluator.fitted(changed, x[None], own)
                larger = self._evaluator.evaluated(changed, x, own, known.refined, tried)
        except (ValueError, np.linalg.LinAlgError):
            return None
        gain = self._odds(smaller, larger)
        return gain, max(0.0, larger.log_likelihood - smaller.log_likelihood - gain)

    def _odds(self, smaller: Evaluated, larger: Evaluated) -> float:
        """Logarithm of the odds that weighing gives the effect, over those that a claim needs."""
        known = self.known
        base = known.model.model.effect_keys
        weighing = Weighing(known.evaluator, known.library, base, known.rules)
        weighing.found = {(): smaller, (self.key,): larger}
        posterior = weighing.together.posterior()
        there = posterior.of([self.key])
        else_ = sum(row.probability for row in posterior.rows if row.effects != (self.key,))
        asked = known.rules.claimed / (1 - known.rules.claimed)
        return float(np.log(max(there, _LEAST)) - np.log(max(else_, _LEAST)) - np.log(asked))

    @property
    def _has_corners(self) -> bool:
        """Whether a torque may have corners that reach beyond the band that is compared."""
        return self._evaluator.band.angle_imposed and not self.model.linear

    @cached_property
    def _problems(self) -> tuple[Problem, Problem]:
        """Of both models, of what was recorded."""
        band, known = self._evaluator.band, self._without
        return (
            band.problem(known.model, refined=known.refined, scheme=known.scheme),
            band.problem(self.model, refined=known.refined),
        )

    @cached_property
    def _left(self) -> list[np.ndarray]:
        """What the model without it leaves: model minus measurement, by stretch."""
        return self._compared(self._problems[0], self._without.x)

    def _compared(self, problem: Problem, x: np.ndarray) -> list[np.ndarray]:
        return [one[:, 0] for one in self._evaluator.band.residuals(problem, x)]

    def _trace(self, values: Mapping[str, float]) -> tuple[Problem, np.ndarray] | None:
        """Problem of the model with it, in steps that are short enough, and what it changes.

        By observation and sample; None if it has no bounds.
        """
        plain, having = self._problems
        having = having.with_scheme(having.suited(self.model.vector(values)))
        x, before = having.free_vector(values), np.concatenate(self._left)
        while True:
            after = np.concatenate(self._compared(having, x))
            if not np.all(np.isfinite(after)):
                return None
            if having.integration.exact:
                break
            # What the integration is wrong by must not pass for a trace.
            moved = np.concatenate(self._compared(having.halved(), x)) - after
            trace = after - before
            error = float(moved @ moved) / max(float(trace @ trace), 1e-300)
            error /= having.integration.shown * _SOLVER_SHARE
            if error <= 1:
                break
            if having.integration.finest:
                return None
            having = having.with_scheme(having.integration.improved(error))
        if self._has_corners:
            changes = self._filtered(values)
            rows = np.zeros((len(changes), max(change.size for change in changes)))
            for row, change in zip(rows, changes, strict=True):
                row[: change.size] = change
        else:
            rows = having.by_observation(having.residuals(x) - plain.residuals(self._without.x))
        return (having, rows) if np.all(np.isfinite(rows)) else None

    def _recorded(self, having: Problem, trace: np.ndarray, draw: int) -> tuple[Problem, Problem]:
        """Problems of both models, of what would have been recorded in a draw of the noise."""
        plain, rows = self._problems[0], trace.copy()
        if draw:
            self._exchange(rows, draw)
        found = []
        for problem in (plain, having):
            # Of the whole motion there are some samples more, where nothing is compared.
            observations = [replace(o, measured=o.measured.copy()) for o in problem.observations]
            earlier = self._evaluator.band.earlier(problem.model)
            for o, begin, row in zip(observations, earlier, rows, strict=True):
                n = min(row.size, o.measured.size - begin)
                o.measured[begin : begin + n] += row[:n]
            found.append(replace(problem, observations=observations))
        return found[0], found[1]

    def _filtered(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """A trace as the recording would have it, by observation.

        A torque with corners reaches beyond the band that is compared: what a model says of the
        angle in that band is not what the recorded torque is there.
        """
        band, theta = self._evaluator.band, self.model.vector(values)
        changes = [simulate(self.model, theta, drive) - before for drive, before in self._unchanged]
        pairs = zip(band.responding(changes), band.observations, strict=True)
        return [new.measured - old.measured for new, old in pairs]

    @cached_property
    def _unchanged(self) -> list[tuple[Drive, np.ndarray]]:
        """By trial, its motion at the recorded times, and the torque of the model without it."""
        band, known = self._evaluator.band, self._without
        theta = known.model.vector(known.values)
        drives = [
            imposed_motion(trial.time, angle)
            for trial, angle in zip(band.recorded, band.motions(), strict=True)
        ]
        return [(drive, simulate(known.model, theta, drive)) for drive in drives]

    def _exchange(self, rows: np.ndarray, draw: int) -> None:
        """Add to the trials what puts a draw of the noise in the place of the recorded one."""
        drawn = self.known.noise.draw(np.random.default_rng([self.known.seed, draw]))
        for i, (chosen, noise) in enumerate(zip(self._evaluator.band.samples, drawn, strict=True)):
            rows[i, chosen] += self._left[i] + noise

    def _starts(self, values: Mapping[str, float], problem: Problem) -> list[np.ndarray]:
        """Points to fit the model without the effect from.

        Springs in series with the muscle take K and B of the model without them.
        """
        starts = [self._without.x]
        if self.size.endless:
            x, soft = self._without.x.copy(), 1 / (1 + values["K"] / values[self.sizes[0]])
            for name, factor in (("K", soft), ("B", soft**2)):
                if name in problem.names:
                    x[problem.names.index(name)] *= factor
            starts.append(x)
        return starts
