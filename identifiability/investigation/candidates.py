"""Fits of candidate models to the same evidence, from starts that do not get stuck."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import Fit, at_bounds, explore
from identifiability.inference.problem import Observation, Prior, Problem
from identifiability.inference.recordings import integrated_autocorrelation
from identifiability.investigation.evidence import Evidence, Ready
from identifiability.joint.model import Model

_FACTORS = (0.4, 1.0, 2.5)
_MOST_STARTS = 6
GLANCE, THOROUGH = 10, 60
"""Evaluations from each start: to see whether a candidate is worth more, and to finish it."""
_KEPT, _NEAR = 2, 2.0  # starts that are carried on: so many, at most so many times the best cost
_DIVERGED = 1e100  # stands for a response without bound; its squares can still be summed


@dataclass(frozen=True, eq=False)
class Residual:
    """What a model leaves of one part of the evidence.

    Attributes
    ----------
    by_trial : tuple of array
        Measured minus predicted response at the compared samples, freed of an unknown offset.
    errors : array, shape (n_trials,)
        E (Eq. 3) of each trial.
    weighted : float
        Sum of the squared residuals, each in units of its trial's weight.
    """

    by_trial: tuple[np.ndarray, ...]
    errors: np.ndarray
    weighted: float

    @property
    def error(self) -> float:
        """E pooled over trials: the mean, so that each weighs by its own energy."""
        return float(np.mean(self.errors))

    @property
    def n_samples(self) -> int:
        """Number of compared samples."""
        return sum(r.size for r in self.by_trial)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model fitted to the evidence.

    Attributes
    ----------
    model : Model
    values : mapping of str to float
        Parameters.
    free : tuple of str
        Those that were fitted; the others refine an effect and keep their plain value.
    fitted, held_out : Residual
    at_bound : tuple of str
    n_agreeing, n_starts : int
        Number of starts that reached the best cost, and of all.
    reached : tuple of mapping
        Where the best starts ended, best first.
    refined : tuple of str
        Keys of the effects whose refining parameters were fitted too.
    thorough : bool
        Whether the fit was carried to its end; one that fell behind after a glance is not.
    seconds : float
    failure : str
        Why there is no fit; then the residuals are empty and the errors infinite.
    """

    model: Model
    values: Mapping[str, float]
    free: tuple[str, ...]
    fitted: Residual
    held_out: Residual
    at_bound: tuple[str, ...] = ()
    n_agreeing: int = 0
    n_starts: int = 0
    reached: tuple[Mapping[str, float], ...] = ()
    refined: tuple[str, ...] = ()
    thorough: bool = True
    seconds: float = 0.0
    failure: str = ""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the model's effects."""
        return self.model.effect_keys


NOTHING = Residual((), np.array([np.inf]), float("inf"))


@dataclass(frozen=True, eq=False)
class Workbench:
    """Fits models to one body of evidence, all with the same samples, weights and programs.

    Attributes
    ----------
    evidence : Evidence
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    """

    evidence: Evidence
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    _observations: dict[int, list[Observation]] = field(
        default_factory=dict, init=False, repr=False
    )

    def problem(
        self, model: Model, part: Sequence[Ready], *, refined: Sequence[str] = ()
    ) -> Problem:
        """Problem of fitting a model to a part of the evidence.

        Parameters
        ----------
        model : Model
        part : sequence of Ready
        refined : sequence of str
            Keys of the effects whose refining parameters are free too.
        """
        if id(part) not in self._observations:
            self._observations[id(part)] = self.evidence.observations(part)
        names = model.parameter_names
        plain = {
            name: p.plain
            for name, p in model.parameters.items()
            if p.plain is not None and name.split(".")[0] not in refined
        }
        prior = Prior.physical(model, **{n: b for n, b in self.bounds.items() if n in names})
        return Problem(
            model,
            self._observations[id(part)],
            prior,
            fixed=plain,
            substeps=None if model.linear else 1,
            order=2,
            room=self.evidence.room,
        )

    def residual(
        self,
        model: Model,
        values: Mapping[str, float],
        part: Sequence[Ready],
        refined: Sequence[str] = (),
    ) -> Residual:
        """What a model with given values leaves of a part of the evidence."""
        problem = self.problem(model, part, refined=refined)
        theta = model.vector(values)[list(problem.free)]
        white = problem.residuals(theta).reshape(self.evidence.room)
        white = np.clip(np.nan_to_num(white, nan=_DIVERGED), -_DIVERGED, _DIVERGED)
        compared = [
            row[: o.scale.size][o.scale > 0]
            for row, o in zip(white, problem.observations, strict=False)
        ]
        owner = owners(problem.observations)
        by_trial, errors, weighted = [], [], 0.0
        for i, (ready, sd) in enumerate(zip(part, self.evidence.weights_sd(part), strict=True)):
            left = np.concatenate([c for c, j in zip(compared, owner, strict=True) if i == j])
            by_trial.append(-sd * left)
            errors.append(float(sd**2 * left @ left) / ready.energy)
            weighted += float(left @ left)
        return Residual(tuple(by_trial), np.array(errors), weighted)

    def fit(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        thorough: bool = True,
    ) -> Candidate:
        """Fit a model; a failure is recorded in the result, not raised.

        Parameters
        ----------
        model : Model
        starts : sequence of mapping
            Values of all parameters by name.
        refined : sequence of str
            Keys of the effects whose refining parameters are free too.
        thorough : bool
            Whether to carry the fit to its end or to take a glance from every start.
        """
        began = time.perf_counter()
        try:
            problem = self.problem(model, self.evidence.fitted, refined=refined)
            points = np.array([model.vector(s)[list(problem.free)] for s in starts])
            best = explore(problem, points, evaluations=THOROUGH if thorough else GLANCE)
            reached = _distinct(model, problem, best)
            values = reached[0]
            fitted = self.residual(model, values, self.evidence.fitted, refined)
            held_out = NOTHING
            if self.evidence.held_out:
                held_out = self.residual(model, values, self.evidence.held_out, refined)
            if fitted.weighted >= _DIVERGED:
                raise InputError("the best response found is not finite")
        except (InputError, ValueError, FloatingPointError, np.linalg.LinAlgError) as error:
            return Candidate(model, {}, (), NOTHING, NOTHING, failure=str(error))
        return Candidate(
            model,
            values,
            problem.names,
            fitted,
            held_out,
            at_bounds(problem, best.values),
            best.n_agreeing,
            len(points),
            tuple(reached),
            tuple(refined),
            thorough,
            time.perf_counter() - began,
        )

    def objection(self, candidate: Candidate) -> str:
        """Why a candidate's parameters cannot be those of a joint; empty if they can.

        Only where the joint moves freely, so that inertia and delays show in the motion itself. Of
        an imposed motion they may be anywhere on a ridge, and nothing is held against them.
        """
        if candidate.failure or self.evidence.driven == "angle":
            return ""
        return candidate.model.objection(candidate.values)

    def doubt(self, candidate: Candidate, key: str) -> str:
        """Why one of a candidate's effects more likely stands for another; empty if it does not."""
        if candidate.failure or self.evidence.driven == "angle":
            return ""
        return candidate.model.effect(key).doubt(candidate.values)

    def finish(self, glanced: Candidate) -> Candidate:
        """Carry a fit that was only glanced at to its end, from the best places it reached."""
        if glanced.failure or glanced.thorough:
            return glanced
        return self.fit(glanced.model, glanced.reached, refined=glanced.refined)


def _distinct(model: Model, problem: Problem, best: Fit) -> list[dict[str, float]]:
    """The best places that were reached, those of one cost once."""
    kept: list[int] = []
    for i in np.argsort(best.costs, kind="stable"):
        if np.isfinite(best.costs[i]) and all(
            best.costs[i] - best.costs[j] > 1e-3 * best.costs[j] for j in kept
        ):
            kept.append(int(i))
    names = model.parameter_names
    near = [i for i in kept[:_KEPT] if best.costs[i] <= _NEAR * best.costs[kept[0]]]
    return [
        dict(zip(names, map(float, problem.complete(best.reached[i])), strict=True)) for i in near
    ]


def starting_values(
    model: Model, known: Mapping[str, float], *, most: int = _MOST_STARTS
) -> list[dict[str, float]]:
    """Starts for a model some of whose parameters are known from a smaller one.

    A new effect starts near its null, where the best size is found at once, at several values of
    its shape parameters; an effect that vanishes with infinite stiffness starts at several
    stiffnesses, with K and B raised to make up for it.

    Parameters
    ----------
    model : Model
    known : mapping of str to float
        K, B, I and the parameters of the effects that were there before.
    most : int
        Number of starts.
    """
    grids: list[list[float]] = []
    names = model.parameter_names
    for name, p in model.parameters.items():
        if name in known:
            grids.append([known[name]])
        elif p.plain is not None:
            grids.append([p.plain])
        elif p.null is not None and np.isfinite(p.null):
            grids.append([p.null + 0.01 * (p.nominal - p.null)])
        elif p.null is not None:
            grids.append([3 * known["K"] + 1.0, 10 * known["K"] + 1.0])
        elif p.lower > 0 and p.upper / p.lower > 10:
            grids.append([float(np.clip(f * p.nominal, p.lower, p.upper)) for f in _FACTORS])
        else:
            grids.append([p.lower + s * (p.upper - p.lower) for s in (0.5, 0.25, 0.75)])
    every = list(itertools.product(*grids))
    # Spread over the grid; the middle one, of nominal shape, comes first.
    chosen = np.unique(np.linspace(0, len(every) - 1, most).astype(int))
    starts = [dict(zip(names, every[i], strict=True)) for i in chosen]
    for start in starts:
        for name, p in model.parameters.items():
            if name not in known and p.null is not None and not np.isfinite(p.null):
                softened = 1 + start["K"] / start[name]
                start["K"] *= softened
                start["B"] *= softened**2
    return starts


def owners(observations: Sequence[Observation]) -> np.ndarray:
    """Number of the trial that each observation is a piece of, shape (n_observations,)."""
    return np.cumsum([not o.continues for o in observations]) - 1


def effective_samples(rest: Residual, change: Residual | None = None) -> float:
    """Number of samples that count as independent in the comparison of two fits.

    A change of the prediction is judged against noise with the residual's own spectrum: its
    variance along the change, over what it would be if the residual were white, says how many
    samples count as one (as heteroscedasticity- and autocorrelation-consistent tests have it, Newey
    & West 1987, Econometrica 55: 703-708). A slow wander of the residual does not blur a fast
    effect; a residual of the effect's own pace does.

    Parameters
    ----------
    rest : Residual
        Taken for the noise: that of the best model.
    change : Residual, optional
        Differences of two models' residuals. Without it the slowest change is assumed, for which
        samples count by the residual's integrated autocorrelation time.
    """
    if change is None:
        return float(sum(r.size / integrated_autocorrelation(r) for r in rest.by_trial))
    seen, white = 0.0, 0.0
    for left, moved in zip(rest.by_trial, change.by_trial, strict=True):
        n = left.size
        weight = 1.0 / max(float(np.mean(left**2)), 1e-300) ** 2
        power = np.abs(np.fft.fft(left, 2 * n)) ** 2 / n
        moves = np.abs(np.fft.fft(moved, 2 * n)) ** 2
        seen += weight * float(np.mean(power * moves))
        white += weight * float(np.mean(left**2) * np.mean(moves))
    correlation = seen / white if white > 0 else 1.0
    return rest.n_samples / max(1.0, correlation)


def difference(first: Residual, second: Residual) -> Residual:
    """Change of the prediction from the first to the second model, trial by trial."""
    moved = tuple(a - b for a, b in zip(first.by_trial, second.by_trial, strict=True))
    return Residual(moved, np.zeros(len(moved)), 0.0)
