"""Fits of candidate models to the same evidence, from starts that do not get stuck."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import Fit, at_bounds, explore
from identifiability.inference.problem import Observation, Prior, Problem
from identifiability.investigation.fits.candidate import NOTHING, Candidate, Residual
from identifiability.investigation.rules import Rules
from identifiability.investigation.split import Split, owners
from identifiability.joint.model import Model
from identifiability.measurement.prepared import Prepared

GLANCE, THOROUGH = 10, 60
"""Evaluations from each start: to see whether a candidate is worth more, and to finish it."""
_KEPT, _NEAR = 2, 2.0  # starts that are carried on: so many, at most so many times the best cost
_DIVERGED = 1e100  # stands for a response without bound; its squares can still be summed


@dataclass(frozen=True, eq=False)
class Workbench:
    """Fits models to one body of evidence, all with the same samples, weights and programs.

    Attributes
    ----------
    split : Split
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    """

    split: Split
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    _observations: dict[int, list[Observation]] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def rules(self) -> Rules:
        """Conventions that everything goes by."""
        return self.split.rules

    def prior(self, model: Model) -> Prior:
        """The physical bounds of a model's parameters, or others where some were given."""
        names = model.parameter_names
        return Prior.physical(model, **{n: b for n, b in self.bounds.items() if n in names})

    def problem(
        self, model: Model, part: Sequence[Prepared], *, refined: Sequence[str] = ()
    ) -> Problem:
        """Problem of fitting a model to a part of the evidence.

        Parameters
        ----------
        model : Model
        part : sequence of Prepared
        refined : sequence of str
            Keys of the effects whose refining parameters are free too.
        """
        if id(part) not in self._observations:
            self._observations[id(part)] = self.split.observations(part)
        plain = {
            name: p.plain
            for name, p in model.parameters.items()
            if p.plain is not None and name.split(".")[0] not in refined
        }
        return Problem(
            model,
            self._observations[id(part)],
            self.prior(model),
            fixed=plain,
            substeps=None if model.linear else 1,
            order=2,
            room=self.split.room,
        )

    def residual(
        self,
        model: Model,
        values: Mapping[str, float],
        part: Sequence[Prepared],
        refined: Sequence[str] = (),
    ) -> Residual:
        """What a model with given values leaves of a part of the evidence."""
        problem = self.problem(model, part, refined=refined)
        theta = model.vector(values)[list(problem.free)]
        white = problem.residuals(theta).reshape(self.split.room)
        white = np.clip(np.nan_to_num(white, nan=_DIVERGED), -_DIVERGED, _DIVERGED)
        compared = [
            row[: o.scale.size][o.scale > 0]
            for row, o in zip(white, problem.observations, strict=False)
        ]
        owner = owners(problem.observations)
        by_trial, errors, weighted = [], [], 0.0
        for i, (ready, sd) in enumerate(zip(part, self.split.weights_sd(part), strict=True)):
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
            problem = self.problem(model, self.split.fitted, refined=refined)
            points = np.array([model.vector(s)[list(problem.free)] for s in starts])
            best = explore(problem, points, evaluations=THOROUGH if thorough else GLANCE)
            reached = _distinct(model, problem, best)
            values = reached[0]
            fitted = self.residual(model, values, self.split.fitted, refined)
            held_out = NOTHING
            if self.split.held_out:
                held_out = self.residual(model, values, self.split.held_out, refined)
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
        if candidate.failure or self.split.driven == "angle":
            return ""
        return candidate.model.objection(candidate.values)

    def doubt(self, candidate: Candidate, key: str) -> str:
        """Why one of a candidate's effects more likely stands for another; empty if it does not."""
        if candidate.failure or self.split.driven == "angle":
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
