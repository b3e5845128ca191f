"""The smallest effect that would have been seen, for every effect of the library.

At a candidate size the trials are what was recorded and what the effect would have changed, and
both models are weighed on them as they were on the recording. What the size must be for the effect
to be claimed, with bad luck, is found by halving a bracket, then from draws of the noise that was
estimated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import inside
from identifiability.inference.problem import Problem
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.discrepancy import Discrepancy, discrepancy_of
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.noises import raw_residuals
from identifiability.investigation.rules import Rules
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import Drive, imposed_motion
from identifiability.progress import Progress, silent

_FIRST = 0.01  # share of the nominal size that the bracket is looked for from
_STRIDE = 8.0  # largest step of that
_ABOUT, _CLOSE = 1.6, 1.1  # ratio of the bracket's ends, and of the sizes of the last two turns
_DRAWS, _TURNS = 4, 3  # of the noise, about the size that was found in what was recorded
_MOST = 12  # sizes that are tried
_SMALLEST = 1e-6  # share of the nominal size that is none
_SOLVER_SHARE = 0.01  # of a trace's square that the error of its integration may have


@dataclass(frozen=True)
class Detectable:
    """Smallest size of an effect that would have been claimed.

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
    evaluator: Evaluator,
    without: Evaluated,
    library: Mapping[str, type[Effect]],
    rules: Rules,
    *,
    seed: int,
    progress: Progress = silent,
) -> tuple[Detectable, ...]:
    r"""Smallest effects that would have been seen beside a model that was weighed.

    With :math:`\lambda` the evidence that the trace of an effect is expected to have, twice its log
    likelihood, that of one draw of the noise is :math:`(\sqrt\lambda + z)^2` with z standard
    normal: the noise lengthens or shortens the trace. An effect counts as seen where with a z of
    minus ``rules.bad_luck`` its probability rises from one among all effects of the library and the
    unknown to ``rules.claimed``. At a third of its size its evidence is a ninth, and chance seldom
    makes up for that.

    Effects that stay invisible at any size are left out.

    Parameters
    ----------
    evaluator : Evaluator
    without : Evaluated
        The model in which nothing was found missing.
    library : mapping of str to type of Effect
    rules : Rules
    seed : int
        Of draws of the noise.
    progress : callable
        Told ``(what, done, total)``.
    """
    any_form = discrepancy_of(evaluator, without)
    odds = float(np.log(rules.claimed / (1 - rules.claimed) * (len(library) + 1)))
    hidden = []
    for key, kind in library.items():
        if key in without.model.effect_keys:
            continue
        try:
            model = without.model + kind()
        except InputError:  # it does not go with an effect that is there
            continue
        hidden.append(_Hidden(evaluator, without, any_form, model, key, odds, rules, seed))
    found: list[Detectable] = []
    with ThreadPoolExecutor(THREADS) as pool:
        for i, one in enumerate(pool.map(_Hidden.smallest, hidden)):
            progress("the smallest effects that would have been seen", i + 1, len(hidden))
            if one is not None:
                found.append(one)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Hidden:
    """An effect that the trials may hide.

    Attributes
    ----------
    evaluator : Evaluator
    without : Evaluated
        The model without it.
    any_form : Discrepancy
        Torques of any form beside it: small enough to be none, they may make up for the trace.
    model : Model
        The model with it.
    key : str
    odds : float
        Log evidence [nats] that its prior asks for.
    rules : Rules
    seed : int
        Of draws of the noise.
    """

    evaluator: Evaluator
    without: Evaluated
    any_form: Discrepancy
    model: Model
    key: str
    odds: float
    rules: Rules
    seed: int

    @cached_property
    def sizes(self) -> list[str]:
        """Its parameters that make it vanish; the first measures its size."""
        return [
            n
            for n, p in self.model.parameters.items()
            if n.startswith(f"{self.key}.") and p.null is not None and p.plain is None
        ]

    def values(self, strength: float) -> dict[str, float]:
        """All parameters with the effect at a strength: its size, or the inverse of a stiffness."""
        known = dict(self.without.values)
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
        found = self._bracketed(_FIRST * nominal, _SMALLEST * nominal, most)
        if found is None:
            return None
        for _ in range(_TURNS):
            # What chance does to a trace in one draw of the noise is as large as what is sought.
            short_of = self.short_of(found, range(1, 1 + _DRAWS))
            if short_of is None or (short_of > 1 and found >= most):
                return None
            found = min(found * float(np.clip(short_of, 1 / _STRIDE, _STRIDE)), most)
            if 1 / _CLOSE < short_of < _CLOSE:
                break
        values = self.values(found)
        size = values[self.sizes[0]]
        words = f"{p.description} {'of' if finite else 'up to'} {size:.2g} {p.unit}"
        return Detectable(self.key, self.sizes[0], size, p.unit, words, values)

    def _bracketed(self, strength: float, least: float, most: float) -> float | None:
        """About the smallest strength at which it is seen in the noise that was recorded."""
        low, high = 0.0, np.inf
        for _ in range(_MOST):
            short_of = self.short_of(strength, (0,))
            if short_of is None:  # the response has no bounds: no joint has an effect of that size
                return None
            if short_of <= 1:
                high = strength
            else:
                low = strength
            if low >= most or high < least:
                return None
            if high <= _ABOUT * low:
                break
            # Evidence grows with the square of the strength, or less where noise can be its colour.
            strength *= float(np.clip(short_of, 1 / _STRIDE, _STRIDE))
            if low > 0 and np.isfinite(high) and not low * _ABOUT < strength < high / _ABOUT:
                strength = float(np.sqrt(low * high))
            strength = min(max(strength, _ABOUT * low), most)
        return high if np.isfinite(high) else None

    def short_of(self, strength: float, draws: Sequence[int]) -> float | None:
        """About how many times stronger the effect would have to be to be seen.

        The median of draws of the noise.
        """
        found = self.gained(strength, draws)
        if found is None:
            return None
        gain, penalty = np.array(found).T
        needed = np.sqrt(2 * (self.odds + penalty)) + self.rules.bad_luck
        return float(np.median(needed / np.sqrt(np.maximum(2 * (gain + penalty), 1e-2))))

    def gained(
        self, strength: float, draws: Sequence[int] = (0,)
    ) -> list[tuple[float, float]] | None:
        """Log evidence of the effect at a strength, and how much of its likelihood priors took.

        In draws of the noise, of which number 0 is the one that was recorded.
        """
        values = self.values(strength)
        trace = self._trace(values)
        if trace is None:
            return None
        found = []
        for draw in draws:
            one = self._gained(values, self._recorded(*trace, draw), draw)
            if one is None:
                return None
            found.append(one)
        return found

    def _gained(
        self, values: Mapping[str, float], recorded: tuple[Problem, Problem], draw: int
    ) -> tuple[float, float] | None:
        without, changed = recorded
        known, own = self.without, self.without.weights
        points = inside(without, np.array(self._starts(values, without)))
        tried = own.contenders
        try:
            x = changed.free_vector(values)
            if self._has_corners:
                tried = (*self.evaluator.orders, *tried)
            if draw or self._has_corners:
                raw, _ = raw_residuals(changed, self.evaluator.band, x)
                own = self.evaluator.reference.weights(raw, tried)
            smaller = self.evaluator.settled(without, points, own, known.refined, also=tried)
            larger = self.evaluator.evaluated(changed, x, own, known.refined, tried)
        except (ValueError, np.linalg.LinAlgError):
            return None
        gain = larger.log_evidence - smaller.log_evidence
        penalty = max(0.0, larger.log_likelihood - smaller.log_likelihood - gain)
        inexact = self.any_form.beside(smaller, self.rules.trifle * self.evaluator.band.scale)
        made_up = max(0.0, inexact.log_evidence - np.log(2) - smaller.log_evidence)
        return gain - float(made_up), penalty

    @property
    def _has_corners(self) -> bool:
        """Whether a torque may have corners that reach beyond the band that is compared."""
        return self.evaluator.band.angle_imposed and not self.model.effect(self.key).linear

    @cached_property
    def _problems(self) -> tuple[Problem, Problem]:
        """Of both models, of what was recorded."""
        band, probes = self.evaluator.band, self.evaluator.reference.probes
        known = self.without
        return (
            band.problem(known.model, refined=known.refined, scheme=known.scheme, probes=probes),
            band.problem(self.model, refined=known.refined, probes=probes),
        )

    @cached_property
    def _left(self) -> np.ndarray:
        """What the model without it leaves: model minus measurement."""
        return self._problems[0].residuals(self.without.x)

    def _trace(self, values: Mapping[str, float]) -> tuple[Problem, np.ndarray] | None:
        """Problem of the model with it, in steps that are short enough, and what it changes.

        By observation and sample; None if it has no bounds.
        """
        plain, having = self._problems
        having = having.with_scheme(having.suited(self.model.vector(values)))
        x, before = having.free_vector(values), self._left
        while True:
            after = having.residuals(x)
            if not np.all(np.isfinite(after)):
                return None
            if having.integration.exact:
                break
            # What the integration is wrong by must not pass for a trace.
            moved, trace = having.halved().residuals(x) - after, after - before
            error = float(moved @ moved) / max(float(trace @ trace), 1e-300)
            error /= having.integration.shown * _SOLVER_SHARE
            if error <= 1:
                break
            if having.integration.finest:
                return None
            having = having.with_scheme(having.integration.improved(error))
        rows = plain.by_observation(after - before)
        if self._has_corners:
            for row, change in zip(rows, self._filtered(values), strict=False):
                row[: change.size] = change
            if not np.all(np.isfinite(rows)):
                return None
        return having, rows

    def _recorded(self, having: Problem, trace: np.ndarray, draw: int) -> tuple[Problem, Problem]:
        """Problems of both models, of what would have been recorded in a draw of the noise."""
        plain, rows = self._problems[0], trace.copy()
        if draw:
            self._exchange(rows, draw)
        n = len(self.evaluator.band.observations)
        for i in range(n):
            rows[i::n] = rows[i]  # probes, which come after the trials, have the same torque
        observations = [
            replace(o, measured=o.measured + row[: o.measured.size])
            for o, row in zip(plain.observations, rows, strict=False)
        ]
        return replace(plain, observations=observations), replace(having, observations=observations)

    def _filtered(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """A trace as the recording would have it, by observation.

        A torque with corners reaches beyond the band that is compared: what a model says of the
        angle in that band is not what the recorded torque is there.
        """
        band, theta = self.evaluator.band, self.model.vector(values)
        changes = [simulate(self.model, theta, drive) - before for drive, before in self._unchanged]
        pairs = zip(band.responding(changes), band.observations, strict=True)
        return [new.measured - old.measured for new, old in pairs]

    @cached_property
    def _unchanged(self) -> list[tuple[Drive, np.ndarray]]:
        """By trial, its motion at the recorded times, and the torque of the model without it."""
        band, known = self.evaluator.band, self.without
        theta = known.model.vector(known.values)
        drives = [
            imposed_motion(trial.time, angle)
            for trial, angle in zip(band.recorded, band.motions(), strict=True)
        ]
        return [(drive, simulate(known.model, theta, drive)) for drive in drives]

    def _exchange(self, rows: np.ndarray, draw: int) -> None:
        """Add to the trials what puts a draw of the noise in the place of the recorded one."""
        left = self._problems[0].by_observation(self._left)
        drawn = self.without.weights.draw(np.random.default_rng([self.seed, draw]))
        for i, (chosen, noise) in enumerate(zip(self.evaluator.band.samples, drawn, strict=True)):
            rows[i, chosen] += left[i, chosen] + noise

    def _starts(self, values: Mapping[str, float], problem: Problem) -> list[np.ndarray]:
        """Points to fit the model without the effect from.

        Springs in series with the muscle take K and B of the model without them.
        """
        starts = [self.without.x]
        p = self.model.parameters[self.sizes[0]]
        if p.null is not None and not np.isfinite(p.null):
            x, soft = self.without.x.copy(), 1 / (1 + values["K"] / values[self.sizes[0]])
            for name, factor in (("K", soft), ("B", soft**2)):
                if name in problem.names:
                    x[problem.names.index(name)] *= factor
            starts.append(x)
        return starts
