"""Fits of candidate models to the same evidence, from starts that do not get stuck."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import Fit, at_bounds, explore
from identifiability.inference.problem import Observation, Prior, Problem
from identifiability.inference.starts import plain_values
from identifiability.investigation.fits.candidate import NOTHING, Candidate, Residual
from identifiability.investigation.fits.delays import delays_profiled
from identifiability.investigation.fits.kept import InMemory, Kept, question
from identifiability.investigation.pieces import places
from identifiability.investigation.rules import Rules
from identifiability.investigation.split import Split
from identifiability.joint.model import Model
from identifiability.joint.scheme import EXACT, Scheme
from identifiability.measurement.prepared import Prepared
from identifiability.provenance import fingerprint

THOROUGH, FURTHER = 60, 100
"""Evaluations from each start, and for the best two where that did not suffice."""
_KEPT, _NEAR = 2, 2.0  # starts that are carried on: so many, at most so many times the best cost
_FINEST_START = Scheme(4)  # extreme starts are passed through; where a fit ends is checked
_ROUNDS = 6  # fits at most, each with the scheme that the one before asked for
_DIVERGED = 1e100  # stands for a response without bound; its squares can still be summed


@dataclass(frozen=True, eq=False)
class Workbench:
    """Fits models to one body of evidence, all with the same samples, weights and programs.

    Attributes
    ----------
    split : Split
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    kept : Kept
        Where fits are kept, so that none is done twice; one that failed is not.
    """

    split: Split
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    kept: Kept = field(default_factory=InMemory)

    @cached_property
    def identity(self) -> str:
        """Hash of the trials, the conventions and the bounds."""
        return fingerprint(self.split.fitted, self.split.held_out, self.split.rules, self.bounds)

    @property
    def rules(self) -> Rules:
        """Conventions that everything goes by."""
        return self.split.rules

    @cached_property
    def _fitted(self) -> list[Observation]:
        return self.split.observations(self.split.fitted)

    @cached_property
    def _held_out(self) -> list[Observation]:
        return self.split.observations(self.split.held_out)

    def _observed(self, part: Sequence[Prepared]) -> list[Observation]:
        if part is self.split.fitted:
            return self._fitted
        return self._held_out if part is self.split.held_out else self.split.observations(part)

    def prior(self, model: Model) -> Prior:
        """The physical bounds of a model's parameters, or others where some were given."""
        names = model.parameter_names
        return Prior.recorded(model, **{n: b for n, b in self.bounds.items() if n in names})

    def problem(
        self,
        model: Model,
        part: Sequence[Prepared],
        *,
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
    ) -> Problem:
        """Problem of fitting a model to a part of the evidence.

        Parameters
        ----------
        model : Model
        part : sequence of Prepared
        refined : sequence of str
            Keys of the effects whose refining parameters are free too.
        scheme : Scheme, optional
            That of a candidate; by default that for nominal parameters.
        """
        return Problem(
            model,
            self._observed(part),
            self.prior(model),
            fixed=plain_values(model, refined),
            scheme=scheme,
        )

    def residual(
        self,
        model: Model,
        values: Mapping[str, float],
        part: Sequence[Prepared],
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
    ) -> Residual:
        """What a model with given values leaves of a part of the evidence.

        Without a scheme it is integrated as those values ask for.
        """
        scheme = scheme or self._apriori(model, [values])
        return self._left(self.problem(model, part, refined=refined, scheme=scheme), values, part)

    def _left(
        self, problem: Problem, values: Mapping[str, float], part: Sequence[Prepared]
    ) -> Residual:
        white = problem.residuals(problem.free_vector(values))
        white = np.clip(np.nan_to_num(white, nan=_DIVERGED), -_DIVERGED, _DIVERGED)
        found = places(problem.observations)
        by_trial, errors, weighted = [], [], 0.0
        for ready, sd, at in zip(part, self.split.weights_sd(part), found, strict=True):
            left = white[at]
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
        profiled: bool = True,
    ) -> Candidate:
        """Fit a model; a failure is recorded in the result, not raised.

        Parameters
        ----------
        model : Model
        starts : sequence of mapping
            Values of all parameters by name.
        refined : sequence of str
            Keys of the effects whose refining parameters are free too.
        profiled : bool
            Whether delays are sought over their whole ranges.
        """
        asked = question(self.identity, model, starts, refined, profiled)
        found = self.kept.find(asked, model)
        if found is None:
            found = self._fit(model, starts, refined, profiled)
            if not found.failure:
                self.kept.keep(asked, found)
        return found

    def _fit(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        refined: Sequence[str],
        profiled: bool,
    ) -> Candidate:
        began = time.perf_counter()
        try:
            reached: Sequence[Mapping[str, float]] = starts
            wanted = self._apriori(model, starts)
            if wanted.is_finer_than(_FINEST_START):
                wanted = _FINEST_START
            for _ in range(_ROUNDS):
                problem = self.problem(model, self.split.fitted, refined=refined, scheme=wanted)
                points = np.array([problem.free_vector(s) for s in reached])
                best = explore(problem, points, evaluations=THOROUGH, further=FURTHER)
                # In every round: by longer steps a long record may seem to prefer another wave.
                if profiled:
                    best = delays_profiled(problem, best, evaluations=THOROUGH)
                reached = _distinct(model, problem, best)
                parts, moved, excess = self._checked(problem, reached[0])
                wanted = self._wanted(problem, excess)
                if not wanted.is_finer_than(problem.integration):
                    break
            else:
                raise InputError(_too_fast(problem))
            asked = replace(self._apriori(model, reached[:1]), order=problem.integration.order)
            if problem.integration.is_finer_than(asked):
                # A fit on its way may have asked for more than its end needs.
                coarser = problem.with_scheme(asked)
                less = self._checked(coarser, reached[0])
                if less[2] <= 1:
                    problem, (parts, moved, _) = coarser, less
            fitted, held_out = parts
            if fitted.weighted >= _DIVERGED:
                raise InputError("the best response found is not finite")
        except (InputError, ValueError, FloatingPointError, np.linalg.LinAlgError) as error:
            return Candidate(model, {}, (), NOTHING, NOTHING, failure=str(error))
        return Candidate(
            model,
            reached[0],
            problem.names,
            fitted,
            held_out,
            at_bounds(problem, best.values),
            best.n_agreeing,
            len(starts),
            tuple(refined),
            time.perf_counter() - began,
            scheme=problem.integration,
            solver_error=moved,
        )

    def _apriori(self, model: Model, places: Sequence[Mapping[str, float]]) -> Scheme:
        """The finest of the schemes that a model's values ask for."""
        drives = [r.drive for r in (*self.split.fitted, *self.split.held_out)]
        interval, imposed = max(d.interval for d in drives), drives[0].imposed
        curved, best = any(d.curved for d in drives), EXACT
        for values in places:
            vector = model.vector(values)
            asked = Scheme.for_model(model, vector, interval, imposed, curved=curved)
            best = asked if asked.is_finer_than(best) else best
        return best

    def _checked(
        self, problem: Problem, values: Mapping[str, float]
    ) -> tuple[tuple[Residual, Residual], float, float]:
        """What values leave of the fitted and held-out trials, and the error E of the solver.

        The error follows from what half the step changes, in the part where that is more. At last
        how many times too large it is, or the square of the nats by which half the step makes the
        fitted trials more or less likely.
        """
        split, refined = self.split, _refined(problem)
        left, errors, nats = [], [0.0], 0.0
        for part in (split.fitted, split.held_out):
            if not part:
                left.append(NOTHING)
                continue
            here = problem
            if part is split.held_out:
                scheme = problem.integration
                here = self.problem(problem.model, part, refined=refined, scheme=scheme)
            left.append(self._left(here, values, part))
            if not here.integration.exact:
                halved = self._left(here.halved(), values, part)
                change = [
                    float(np.sum((a - b) ** 2)) / ready.energy
                    for a, b, ready in zip(left[-1].by_trial, halved.by_trial, part, strict=True)
                ]
                errors.append(float(np.mean(change)) / here.integration.shown)
                if part is split.fitted:
                    ratio = halved.weighted / max(left[0].weighted, 1e-300)
                    nats = abs(0.5 * left[0].n_samples * float(np.log(max(ratio, 1e-300))))
        excess = max(max(errors) / self._tolerance, (nats / self.rules.solver_nats) ** 2)
        return (left[0], left[1]), max(errors), excess

    def _wanted(self, problem: Problem, excess: float) -> Scheme:
        """Scheme that a fit asks for, by how many times too large the error of its own is.

        Raises
        ------
        InputError
            Where there is none fine enough.
        """
        scheme = problem.integration
        # What overflows is a failure of another kind.
        if not np.isfinite(excess) or excess <= 1:
            return scheme
        if scheme.finest:
            raise InputError(_too_fast(problem))
        return scheme.improved(excess)

    @property
    def _tolerance(self) -> float:
        """Error E that the integration of a fit may have."""
        rules, floor = self.rules, self.split.noise_floor()
        noise = np.inf if floor is None else floor
        allowed = np.clip(rules.solver_share * noise, rules.solver_least, rules.solver_most)
        return float(allowed)

    def finish(self, candidate: Candidate) -> Candidate:
        """Fit a candidate that is not fitted yet, from the values that it has.

        Its delays were sought when it was weighed, or the model that it is a part of. Where that
        leads to what cannot be integrated or fitted, its own values stand.
        """
        if candidate.failure or candidate.free:
            return candidate
        model, starts = candidate.model, [candidate.values]
        found = self.fit(model, starts, refined=candidate.refined, profiled=False)
        return self._unmoved(candidate, found) if found.failure else found

    def _unmoved(self, candidate: Candidate, failed: Candidate) -> Candidate:
        """A candidate at its own values, in steps short enough; or the one that failed."""
        model, values = candidate.model, candidate.values
        scheme = candidate.scheme or self._apriori(model, [values])
        problem = self.problem(model, self.split.fitted, refined=candidate.refined, scheme=scheme)
        try:
            while True:
                (fitted, held_out), moved, excess = self._checked(problem, values)
                wanted = self._wanted(problem, excess)
                if not wanted.is_finer_than(problem.integration):
                    break
                problem = problem.with_scheme(wanted)
        except (InputError, ValueError, FloatingPointError, np.linalg.LinAlgError):
            return failed
        if not fitted.weighted < _DIVERGED:
            return failed
        return replace(
            candidate,
            free=problem.names,
            fitted=fitted,
            held_out=held_out,
            scheme=problem.integration,
            solver_error=moved,
        )


def _refined(problem: Problem) -> tuple[str, ...]:
    """Keys of the effects of which a problem fits the refining parameters."""
    parameters = problem.model.parameters
    return tuple({n.split(".")[0] for n in problem.names if parameters[n].plain is not None})


def _too_fast(problem: Problem) -> str:
    return (
        f"its parameters are too fast for samples {1e3 * problem.interval:g} ms apart: "
        f"{problem.integration} do not resolve it"
    )


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
