"""Evidence of a model: its likelihood, averaged over what its parameters may be before the data.

By Laplace's approximation about the best parameters, with the residual's noise estimated for this
model (restricted likelihood, one nat for each of its parameters as AICc counts them).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.bounds import touching
from identifiability.inference.fitting import explore, inside
from identifiability.inference.likelihood.estimate import Contender, Order
from identifiability.inference.problem import Problem
from identifiability.inference.starts import nested_values
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.beginnings import Beginnings
from identifiability.investigation.posterior.chance import scatter
from identifiability.investigation.posterior.laplace import less, log_volume, moved_by
from identifiability.investigation.posterior.noises import (
    Reference,
    Weighed,
    Weights,
    raw_residuals,
)
from identifiability.investigation.posterior.prior import priors_of
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS
from identifiability.joint.scheme import MOST_SUBSTEPS, Scheme


class _Weighed(Protocol):
    @property
    def log_evidence(self) -> float: ...


_Start = TypeVar("_Start")
_End = TypeVar("_End", bound=_Weighed)

NOISE_SHARE = 0.02
"""Share of the response's energy that is noise, the mean of an exponential prior: more than a few
percent would be a poor recording. Without it noise of long memory may be the response itself."""
SHOWN = 8
"""Steps a sample, of 0.75 rad each, that follow what swings at half the sampling rate, twice."""
EVALUATIONS, FURTHER = 12, 40
"""Evaluations from each start of a fit, and for the best two where that did not suffice."""
_ROUNDS, _MOST_ROUNDS = 2, 12
_GAIN = 0.5  # nats that one more round of fit and noise must bring
_PROMISE = 10.0  # times what the last round brought, that all rounds more may bring
_SOLVER = 1.0  # squared error of the integration, all samples together, over the noise's
_NEAR_END = 0.1  # nats, twice, that a fit's next step would bring where it ends
_MISSED = 0.5  # nats by which a model may be less likely than one that it contains
_CARRIED = 2  # starts that a fit is carried on from
# Nats by which one noise leads where fits to a part of a long record begin, from which another is
# given up.
_AHEAD = 100.0
# Standard deviations of the sum of squares that what is taken off for noise of an imposed angle,
# beyond what is at the reference, has to exceed: only what is beyond counts.
_CHANCE = 2.0
_DIVERGED = 1e3  # responses that a model may leave, and still be said to have one
_PLAIN = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1))  # to which that of a better model may fall


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A model with its noise, fitted together, and its evidence.

    Attributes
    ----------
    problem : Problem
        That it was fitted in.
    values : dict of str to float
        Of all parameters, by name.
    refined : tuple of str
    x : array, shape (n_free,)
    weights : Weights
    log_evidence : float
        In nats.
    log_likelihood : float
        In nats, but for what all models share; noise's parameters counted.
    turns : array, shape (n_free, k)
        From the parameters to the coordinates of those that lie inside their bounds.
    directions : array, shape (n, k)
        Whitened derivatives by these coordinates.
    precision : array, shape (k, k)
        Of these coordinates.
    white : array, shape (n,)
        Whitened residual.
    raw : list of array
        By stretch, the residual and its derivatives.
    probes : list of array
        By stretch, what probes of noise in an imposed angle add to `raw`; empty without.
    beyond : float
        How much more probable [nats] values beyond the bounds of its effects would make it.
    sought : sequence of Contender
        Orders among which its noise was sought.
    """

    problem: Problem
    values: dict[str, float]
    refined: tuple[str, ...]
    x: np.ndarray
    weights: Weights
    log_evidence: float
    log_likelihood: float
    turns: np.ndarray
    directions: np.ndarray
    precision: np.ndarray
    white: np.ndarray
    raw: list[np.ndarray]
    probes: Sequence[np.ndarray] = ()
    beyond: float = 0.0
    sought: Sequence[Contender] = ()

    @property
    def model(self) -> Model:
        """Its problem's."""
        return self.problem.model

    @property
    def scheme(self) -> Scheme:
        """How its response was computed."""
        return self.problem.integration

    @property
    def sds(self) -> dict[str, float]:
        """Standard deviations of the free parameters by curvature; 0 at a bound."""
        spread = self.turns @ np.linalg.pinv(self.precision, hermitian=True) @ self.turns.T
        sds = np.sqrt(np.maximum(np.diag(spread), 0.0))
        return dict(zip(self.problem.names, sds.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Begun:
    """A fit by least squares that is only begun.

    Attributes
    ----------
    problem : Problem
    points : array, shape (n, n_free)
        To go on from, the best first.
    left : float
        Sum of squares that is left there, over the variance of white noise.
    """

    problem: Problem
    points: np.ndarray
    left: float


@dataclass(frozen=True, eq=False)
class Evaluator:
    """Evaluates models by one likelihood.

    Attributes
    ----------
    reference : Reference
    shortlist : tuple of Contender
        Orders of the noise that came nearest at K, B and I.
    joint_widths : array, shape (3,)
        Of the priors of K, B and I.
    starts : tuple of Weights
        Noise by which other models are fitted first: that of K, B and I, and white noise. What K, B
        and I leave at low frequencies looks like noise of long memory, and a model that is weighed
        by it has nothing to explain there.
    coarse : Evaluator or None
        The same of fewer samples, by which fits of long records are begun.
    """

    reference: Reference
    shortlist: tuple[Contender, ...]
    joint_widths: np.ndarray
    starts: tuple[Weights, ...]
    coarse: Evaluator | None = None

    @property
    def band(self) -> Band:
        """What is compared."""
        return self.reference.band

    @property
    def white(self) -> Weights:
        """White noise, of the size of what K, B and I leave."""
        return self.starts[1]

    def evaluate(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
        noise: Weights | None = None,
        least: float = -np.inf,
        resolved: bool = True,
        steps: int = MOST_SUBSTEPS,
        nested: Evaluated | None = None,
        begun: Evaluated | None = None,
        every_noise: bool = False,
    ) -> Evaluated:
        """Fit a model and its noise in turn, and take its evidence.

        Parameters
        ----------
        model : Model
        starts : sequence of mapping
            Values of all parameters by name, to start from the best of.
        refined : sequence of str
        scheme : Scheme, optional
            To start with; what the model asks for by default.
        noise : Weights, optional
            Noise to start from besides white noise, such as that of a model with one effect less;
            that of K, B and I, by default and as well.
        least : float
            Log evidence below which a model is not fitted any further.
        resolved : bool
            Whether steps are made so short that the evidence does not depend on them.
        steps : int
            Most steps a sample that they are made.
        nested : Evaluated, optional
            A model that this one is more than. Where its likelihood is higher, an optimum was
            missed, and the fit goes on from there.
        begun : Evaluated, optional
            Where `roughly` ended, or another fit, to go on from in its noise instead of the starts.
        every_noise : bool
            See `roughly`.

        Raises
        ------
        InputError
            Where the model has no finite response, or is too fast for its samples.
        """
        problem = self.band.problem(
            model, refined=refined, scheme=scheme, probes=self.reference.probes_of(model)
        )
        also = noise.contenders[:1] if noise is not None else ()

        def settled(start: tuple[np.ndarray, Weights]) -> Evaluated:
            return self.settled(problem, *start, refined, least, also)

        # A single start that is to be resolved is where a fit of all samples ended.
        if begun is None and not (resolved and len(starts) == 1):
            begun = self.roughly(
                model,
                starts,
                refined=refined,
                scheme=problem.integration,
                noise=noise,
                every_noise=every_noise,
            )
        best = best_of(settled, list(self._begun(problem, starts, noise, begun)))
        if nested is not None and best.log_likelihood < nested.log_likelihood - _MISSED:
            point = problem.free_vector(nested_values(model, nested.values))
            start = inside(problem, point[None])
            # In longer steps than the other's it could not be as likely.
            if nested.scheme.is_finer_than(problem.integration):
                problem = problem.with_scheme(nested.scheme)
            found = self.settled(problem, start, nested.weights, refined, rounds=1, further=0)
            # Nor could it in steps that do not resolve what the other has exactly. What takes more
            # is too fast for its samples to show, such as a link that as good as does not give.
            while (
                found.log_likelihood < nested.log_likelihood - _MISSED
                and (finer := self._finer(problem, found)) is not None
                and finer.substeps <= SHOWN
            ):
                problem = problem.with_scheme(finer)
                found = self.settled(problem, start, nested.weights, refined, rounds=1, further=0)
            best = max(best, found, key=lambda one: one.log_evidence)
        return self.resolved(best, least, steps) if resolved else _finite(best)

    def resolved(
        self, found: Evaluated, least: float = -np.inf, steps: int = MOST_SUBSTEPS
    ) -> Evaluated:
        """A model fitted on in steps so short that its evidence does not depend on them.

        Arguments as for `evaluate`, which says when there is none.
        """
        best, problem = found, found.problem
        while (finer := self._finer(problem, best, steps)) is not None:
            # As fine as it takes there at once: a fit in steps that do not do would be lost.
            while finer is not None:
                problem = problem.with_scheme(finer)
                finer = None if finer.finest else self._finer(problem, best, steps)
            best = self.settled(problem, best.x[None], best.weights, best.refined, least, further=0)
        return _finite(best)

    def _begun(
        self,
        problem: Problem,
        starts: Sequence[Mapping[str, float]],
        noise: Weights | None,
        begun: Evaluated | None = None,
    ) -> Iterator[tuple[np.ndarray, Weights]]:
        """Points and noise to fit a model from: see `evaluate`."""
        if begun is not None:
            # Not the noise of what is left there: more, and of another colour, than at the optimum.
            weights = self.reference.adopted(begun.weights)
            yield inside(problem, problem.free_vector(begun.values)[None]), weights
            return
        own, white = self.starts
        beginnings = self._beginnings(problem, starts)
        noises = [noise or own, white]
        # Not to hang on the noise of the model that this one was made from.
        if noises[0].contenders[0].order != own.contenders[0].order:
            noises.append(own)
        for weights in noises:
            yield beginnings.best(weights, _carried(problem)), weights

    def _beginnings(self, problem: Problem, starts: Sequence[Mapping[str, float]]) -> Beginnings:
        points = np.array([problem.free_vector(values) for values in starts])
        return Beginnings.of(problem, self.band, inside(problem, points))

    def roughly(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
        noise: Weights | None = None,
        every_noise: bool = False,
    ) -> Evaluated | None:
        """About where a fit to a part of a long record ends; None where there is none.

        In two noises, of which the one that falls far behind where the best start leads is given
        up, unless `every_noise` is gone on with: what K, B and I leave may be so likely a noise
        that nothing is beside it, until another fit is at its end. Other arguments as for
        `evaluate`.
        """
        fewer = self.coarse
        if fewer is None:
            return None
        problem = fewer.band.problem(
            model, refined=refined, scheme=scheme, probes=fewer.reference.probes_of(model)
        )
        beginnings = fewer._beginnings(problem, starts)

        def begun(weights: Weights) -> tuple[np.ndarray, Weights]:
            return beginnings.best(weights, _carried(problem)), weights

        def settled(leg: tuple[np.ndarray, Weights], further: int = EVALUATIONS) -> Evaluated:
            return fewer.settled(problem, *leg, refined, rounds=1, most=1, further=further)

        ends: list[Evaluated] = []
        with ThreadPoolExecutor(THREADS) as pool:
            noises = fewer.reference.adopted(noise or self.starts[0]), fewer.white
            legs = list(pool.map(begun, noises))
            if not every_noise:
                ends += pool.map(lambda leg: settled((leg[0][:1], leg[1]), 0), legs)
                least = max(end.log_evidence for end in ends) - _AHEAD
                legs = [
                    (np.array([end.x, *points[1:]]), weights)
                    for end, (points, weights) in zip(ends, legs, strict=True)
                    if end.log_evidence > least
                ]
            ends += pool.map(settled, legs)
        return max(ends, key=lambda end: end.log_evidence)

    def as_it_is(self, found: Evaluated) -> Evaluated:
        """A model and its noise as another part of the same trials found them, by this one."""
        probes = self.reference.probes_of(found.model)
        problem = self.band.problem(
            found.model, refined=found.refined, scheme=found.scheme, probes=probes
        )
        weights = self.reference.adopted(found.weights)
        return self.evaluated(problem, found.x, weights, found.refined)

    @staticmethod
    def _finer(problem: Problem, found: Evaluated, most: int = MOST_SUBSTEPS) -> Scheme | None:
        """Finer steps, `most` a sample, where a model's own are too long to tell it from others.

        Its own are held against those that its pace there asks for, or against steps half as long.

        Raises
        ------
        InputError
            Where no steps are fine enough.
        """
        own, band = problem.integration, found.weights.band
        if own.exact or (own.substeps >= most and not own.finest):
            return None
        suited = problem.suited(problem.complete(found.x)).within(most)
        reference = suited if suited.is_finer_than(own) else own.halved
        expected = problem.with_scheme(reference).values(found.x)

        def error(scheme: Scheme) -> float:
            """Squared error over the noise's."""
            moved = expected - problem.with_scheme(scheme).values(found.x)
            rows = problem.by_observation(moved[:, None])
            changed = band.compared(rows[: len(band.observations)], problem, differ=True)
            white = found.weights.whitened(changed)
            return float(np.sum(white**2)) / own.shown

        if (excess := error(own)) <= _SOLVER:
            return None
        if own.finest:
            raise InputError(
                f"found parameters of {problem.model} too fast for samples {problem.interval:g} s "
                f"apart, which {own} do not resolve; sample more often"
            )
        if reference is suited:
            # What steps of higher order leave, those of lower order do not say.
            return next((fewer for fewer in own.up_to(suited) if error(fewer) <= _SOLVER), suited)
        return own.improved(excess / _SOLVER).within(most)

    def settled(
        self,
        problem: Problem,
        points: np.ndarray,
        weights: Weights,
        refined: Sequence[str] = (),
        least: float = -np.inf,
        also: Sequence[Contender] = (),
        rounds: int = _ROUNDS,
        most: int = _MOST_ROUNDS,
        further: int = FURTHER,
    ) -> Evaluated:
        """Model and noise fitted in turn, from given points and noise: see `evaluate`.

        A likelihood of noise has several optima, and what a poor fit leaves is of another colour.
        So noise is sought from where it was before and from where others `also` ended; at first
        among plain orders, then among all. Noise that takes a misfit for its own lets the next fit
        be nearly as poor: both go on for as long as that brings something, `most` rounds at most. A
        fit that is near its end is given no `further` evaluations.
        """
        best, gain = None, np.inf
        for i in range(most):
            x = self.fitted(problem, points, weights, further)
            points = x[None]
            orders = self.plain if i + 1 < rounds else self.orders if i + 1 == rounds else ()
            elsewhere = also if i < rounds else ()
            tried = (*orders, *weights.contenders[:1], *elsewhere)
            weights = self.reference.weights(raw_residuals(problem, self.band, x)[0], tried)
            found = self.evaluated(problem, x, weights, refined, tried)
            if best is not None:
                gain = found.log_evidence - best.log_evidence
            if best is None or gain > 0:
                best = found
            if found.log_evidence + _PROMISE * max(gain, 0.0) < least or (
                i + 1 >= rounds and gain < _GAIN
            ):
                break
        assert best is not None
        return best

    def begun(self, model: Model, starts: Sequence[Mapping[str, float]]) -> Begun:
        """The best starts of a fit by least squares, the sizes of effects fitted."""
        if self.coarse is not None:
            return self.coarse.begun(model, starts)
        problem = self.band.problem(model, probes=self.reference.probes_of(model))
        beginnings = self._beginnings(problem, starts)
        best = beginnings.best(self.white, _CARRIED)
        return Begun(problem, best, Weighed(problem, self.band, self.white).squares(best[0]))

    def by_least_squares(self, begun: Begun) -> Evaluated:
        """A model as it leaves least, whatever the colour of that."""
        problem, points = begun.problem, begun.points
        if self.coarse is not None:
            points = self.coarse.fitted(problem, points, self.coarse.white)[None]
            problem = self.band.problem(
                problem.model, probes=self.reference.probes_of(problem.model)
            )
        x = self.fitted(problem, points, self.white)
        return self.evaluated(problem, x, self.white)

    def fitted(
        self, problem: Problem, points: np.ndarray, weights: Weights, further: int = FURTHER
    ) -> np.ndarray:
        """Best values of the free parameters in known noise, from given points."""
        weighed = Weighed(problem, self.band, weights)
        # To some hundredths of a nat: half of what is left is one for every two samples.
        ftol = _NEAR_END / max(1, self.band.n_samples)
        return explore(weighed, points, evaluations=EVALUATIONS, further=further, ftol=ftol).values

    def reweighed(self, found: Evaluated, noise: Weights) -> Evaluated:
        """A model with its noise sought from another's, or that as it is, where that is better.

        Two that leave the same must not be told apart by where the noise of each was sought from,
        nor by which of the likeliest noises it ended in.
        """
        contender = noise.contenders[0]
        here = max(
            (
                self.evaluated(found.problem, found.x, weights, found.refined, [contender])
                for weights in (self.reference.weights(found.raw, [contender]), noise)
            ),
            key=lambda one: one.log_evidence,
        )
        if not here.log_evidence > found.log_evidence:
            return found
        moved = self.settled(found.problem, found.x[None], here.weights, found.refined)
        return max(here, moved, key=lambda one: one.log_evidence)

    @property
    def orders(self) -> tuple[Contender, ...]:
        """Orders of the noise that are tried: the shortlist, and plain ones."""
        known = {contender.order for contender in self.shortlist}
        return (*self.shortlist, *(c for c in self.plain if c.order not in known))

    @property
    def plain(self) -> tuple[Contender, ...]:
        """Plain orders of the noise, each sought from anew."""
        return tuple(Contender(Order(p, q, self.band.angle_imposed)) for p, q in _PLAIN)

    def evaluated(
        self,
        problem: Problem,
        x: np.ndarray,
        weights: Weights,
        refined: Sequence[str] = (),
        sought: Sequence[Contender] = (),
    ) -> Evaluated:
        """Evidence of a model at its best parameters, with given noise."""
        weighed = Weighed(problem, self.band, weights)
        raw, probes = raw_residuals(problem, self.band, x)
        white, probe = weighed.whitened(x)
        residual, jacobian = white[:, 0], white[:, 1:]
        priors = priors_of(problem, x, raw, self.band.scale, self.joint_widths)
        turn = np.array([p.turn(value) for p, value in zip(priors, x, strict=True)])
        precision = (jacobian * turn).T @ (jacobian * turn)
        precision += np.diag([p.sd**-2 for p in priors])
        gradient = jacobian.T @ residual
        if probe is not None and weighed.takes_all(probe):
            precision = less(precision, probe[:, 1:] * turn)
            gradient = gradient - probe[:, 1:].T @ probe[:, 0]
        # The likelihood's own mode is given; the prior moves it, to second order.
        pull = np.array([p.pull(value) for p, value in zip(priors, x, strict=True)])
        gradient = gradient * turn - pull
        at_lower, at_upper = touching(x, problem.lower, problem.upper)
        at_bound = at_lower | at_upper
        volume, inside, gains = log_volume(precision, gradient, at_bound)
        share = (weights.estimate.rms / self.band.scale) ** 2
        log_likelihood = self._log_likelihood(weighed, white, probe)
        log_evidence = (
            -share / NOISE_SHARE
            + sum(p.log_density(value) for p, value in zip(priors, x, strict=True))
            + volume
            + moved_by(pull[inside], precision[np.ix_(inside, inside)])
            + log_likelihood
        )
        turns = np.diag(turn)[:, inside]
        directions = jacobian @ turns
        own = directions.T @ directions + np.diag([priors[i].sd ** -2 for i in inside])
        return Evaluated(
            problem,
            dict(zip(problem.model.parameter_names, map(float, problem.complete(x)), strict=True)),
            tuple(refined),
            x,
            weights,
            float(log_evidence),
            float(log_likelihood),
            turns,
            directions,
            own,
            residual,
            raw,
            probes or (),
            max([0.0, *(gain for i, gain in gains.items() if self._limits(problem, i))]),
            tuple(sought),
        )

    def likelihood_by(self, found: Evaluated, weights: Weights) -> float:
        """Log likelihood of a model as it is, in another noise than its own."""
        weighed = Weighed(found.problem, self.band, weights)
        probes = [rows[:, :1] for rows in found.probes] or None
        return self._log_likelihood(weighed, *weighed.of([r[:, :1] for r in found.raw], probes))

    def _log_likelihood(
        self, weighed: Weighed, white: np.ndarray, probe: np.ndarray | None
    ) -> float:
        order, n = weighed.weights.n_parameters, self.band.n_samples
        squares = weighed.squares_of(white, probe) + weighed.weights.log_determinant
        if probe is not None and (more := weighed.taken_more(probe)):
            weights = weighed.weights
            usual = weights.gain * weights.whitened(self.reference.raw_probes)[:, 0]
            sizes = [samples.size for samples in self.band.samples]
            squares += min(more, _CHANCE * scatter(probe[:, 0], usual, sizes))
        return float(-0.5 * squares - order * n / max(1, n - order - 2))

    def _limits(self, problem: Problem, i: int) -> bool:
        """Whether the bound that a parameter lies at is one of physiology.

        Not that of K, B or I, not where the effect vanishes, not a form's own end, and not that of
        what the compared samples can show of a resonance.
        """
        name = problem.names[i]
        parameter = problem.model.parameters[name]
        if name in ("K", "B", "I") or parameter.plain is not None:
            return False
        if problem.upper[i] < parameter.upper and name not in self.band.bounds:
            return False
        return parameter.null is None and not parameter.ends_form


def _finite(found: Evaluated) -> Evaluated:
    """The same, where it has a response."""
    if not found.weights.estimate.rms < _DIVERGED * found.weights.band.scale:
        raise InputError("the best response found is not finite")
    return found


def _carried(problem: Problem) -> int:
    """Starts that a fit is carried on from: one more where a link may be so stiff that it is none.

    That start is as good as the model without it, and takes the place of no other.
    """
    return _CARRIED + any(p.endless for p in problem.model.parameters.values())


def best_of(evaluated: Callable[[_Start], _End], starts: Sequence[_Start]) -> _End:
    """The most probable of several ends of one fit, sought side by side."""
    with ThreadPoolExecutor(THREADS) as pool:
        return max(pool.map(evaluated, starts), key=lambda one: one.log_evidence)
