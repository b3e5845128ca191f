"""Candidates are weighed as they come: each once, those that come near to the end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from identifiability.errors import InputError
from identifiability.investigation.posterior.combining import (
    CONTENDS,
    LOST,
    SAME,
    Combining,
    Keys,
)
from identifiability.investigation.posterior.descriptions import Description, descriptions_of
from identifiability.investigation.posterior.evidence import (
    SHOWN,
    Evaluated,
    Evaluator,
    best_of,
)
from identifiability.investigation.posterior.kept import Evaluations
from identifiability.investigation.posterior.noises import Weights
from identifiability.investigation.posterior.probabilities import (
    Probabilities,
)
from identifiability.investigation.rules import Rules
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS
from identifiability.joint.scheme import MOST_SUBSTEPS
from identifiability.progress import Progress, silent

_Task = TypeVar("_Task")
_Found = TypeVar("_Found")

_MOST_ROUNDS = 4  # in which sets are given what the likeliest has
_OUT_OF_REACH = 20.0
"""Nats that a description is behind the best set by a part of a long record's samples, from which
all of them do not make up for it: four times as many make it four times as much worse, give or take
twice the root of that."""
_UNSETTLED = 40.0
"""The same of a fit to that part that is only begun."""
_RICHER = 0.5  # share of what the best of its size gained, that a richer form of it may gain


@dataclass(frozen=True, eq=False)
class Job:
    """A model to be weighed.

    Attributes
    ----------
    model : Model
    starts : sequence of mapping
        Values of all its parameters by name.
    refined : sequence of str
        Keys of the effects whose refining parameters are free.
    noise : Weights or None
        Noise to start from.
    nested : Evaluated or None
        The model that this one is more than; its noise is started from instead.
    begun : Evaluated or None
        The fit to a part of a long record, where it was begun.
    looked_at : bool
        Whether it is fitted on in as many steps as it asks for where its fit ends, and samples
        show.
    """

    model: Model
    starts: Sequence[Mapping[str, float]]
    refined: Sequence[str] = ()
    noise: Weights | None = None
    nested: Evaluated | None = None
    begun: Evaluated | None = None
    looked_at: bool = False

    @property
    def begins_in(self) -> Weights | None:
        """Noise that its fit starts from."""
        return self.noise if self.nested is None else self.nested.weights


@dataclass(eq=False)
class Weighing:
    """Evaluates candidates as they come, and puts them together.

    Attributes
    ----------
    evaluator : Evaluator
    library : collection of str
        Keys of the effects that could be tried.
    base : tuple of str
        Effects of the model that the search starts from: they are no findings.
    rules : Rules
        Conventions.
    progress : callable
        Told ``(what, done, total)``.
    kept : Evaluations
        What evaluates models, each once; the evaluator itself by default.
    found : dict of tuple of str to Evaluated
        The best form of each set.
    taken_up : dict of tuple of str to Evaluated
        Those that were evaluated to the end.
    looked_at : dict of tuple of str to Evaluated
        Those that were so far as samples show.
    described : dict of tuple of str to dict
        By the known effects beside it, each description that was evaluated, by its key.
    screened : dict of tuple of str to float
        Sets that a part of a long record's samples left far behind, and by how many nats.
    failures : dict of str to str
    """

    evaluator: Evaluator
    library: Collection[str]
    base: Keys = ()
    rules: Rules = field(default_factory=Rules)
    progress: Progress = silent
    kept: Evaluations | None = None
    found: dict[Keys, Evaluated] = field(default_factory=dict)
    taken_up: dict[Keys, Evaluated] = field(default_factory=dict)
    looked_at: dict[Keys, Evaluated] = field(default_factory=dict)
    described: dict[Keys, dict[str, Evaluated]] = field(default_factory=dict)
    screened: dict[Keys, float] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    _out_of_reach: set[tuple[Keys, str]] = field(default_factory=set)
    _part: dict[Evaluated, float] = field(default_factory=dict)

    @cached_property
    def together(self) -> Combining:
        """What puts them together as probabilities."""
        return Combining(
            self.evaluator,
            self.library,
            self.rules,
            self.progress,
            self.found,
            self.described,
            self.screened,
            self.failures,
        )

    @property
    def _evaluations(self) -> Evaluations:
        return self.kept or Evaluations(self.evaluator)

    def weigh(self, jobs: Sequence[Job]) -> Iterator[None]:
        """Evaluate models, two at a time; of the forms of one set the best is kept.

        Yields after each of them.
        """
        # What is not fitted any further depends on what was known before, not on who is first.
        best = max((f.log_evidence for f in self.found.values()), default=-np.inf)

        def evaluated(job: Job) -> Evaluated:
            found = self._evaluations.evaluate(
                job.model,
                job.starts,
                refined=job.refined,
                noise=job.begins_in,
                least=best - LOST,
                resolved=False,
                nested=job.nested,
                begun=job.begun,
                every_noise=self._is_first(job),
            )
            if not job.looked_at:
                return found
            return self._evaluations.resolved(found, best - LOST, SHOWN)

        for job, found in zip(jobs, _side_by_side(evaluated, jobs), strict=True):
            self._keep(job.model, found)
            yield

    def in_reach(self, jobs: Sequence[Job]) -> list[Job]:
        """Of models with as many effects those that a part of a long record does not exclude.

        What is far behind the best there, or behind what its richer form could make up for, all
        the samples put further behind.
        """
        if self.evaluator.coarse is None or not jobs:
            return list(jobs)

        def begun(job: Job) -> Job:
            found = self._evaluations.roughly(
                job.model,
                job.starts,
                refined=job.refined,
                noise=job.begins_in,
                every_noise=self._is_first(job),
            )
            return replace(job, begun=found)

        size = len(self._keys(jobs[0].model))
        best, fewer = self._best_by_part(size), self._best_by_part(size - 1)
        ready: list[tuple[Job, Evaluated]] = []
        for i, (job, one) in enumerate(zip(jobs, _side_by_side(begun, jobs), strict=True)):
            self.progress("beginning by a part of the samples", i + 1, len(jobs))
            if isinstance(one, str):
                self.failures["+".join(self._keys(job.model))] = one
            elif one.begun is not None:
                ready.append((one, one.begun))
        best = max([best, *(found.log_evidence for _, found in ready)])
        kept = []
        for job, found in ready:
            behind = best - found.log_evidence
            more = set(job.model.refinable(job.model.effect_keys)) - set(job.refined)
            if behind > _UNSETTLED + (_RICHER * (best - fewer) if more else 0.0):
                self.screened[self._keys(job.model)] = behind
            else:
                kept.append(job)
        return kept

    def _is_first(self, job: Job) -> bool:
        """Whether a model has no more than one effect, beside what the search starts from."""
        return len(self._keys(job.model)) <= 1

    def _keys(self, model: Model) -> Keys:
        return tuple(sorted(k for k in model.effect_keys if k not in self.base))

    def _keep(self, model: Model, found: Evaluated | str) -> None:
        keys = self._keys(model)
        if isinstance(found, str):
            self.failures["+".join(keys)] = found
            return
        if why := self._objection(found):
            self.failures["+".join(keys)] = why
            return
        known = self.found.get(keys)
        if known is None or found.log_evidence > known.log_evidence:
            self.found[keys] = found

    def _objection(self, found: Evaluated) -> str:
        """What speaks against values that were found; nothing where any will do."""
        if not self.evaluator.band.angle_imposed:
            return found.model.objection(found.values)
        # Parameters may lie anywhere on a ridge.
        estimate = found.weights.estimate
        noise = estimate.carried_sd * float(np.max(estimate.levels))
        return found.model.blurred(found.values, noise)

    def require_base(self) -> None:
        """Refuse to go on where the model to start from could not be weighed.

        Raises
        ------
        InputError
            Why it could not.
        """
        if () not in self.found:
            raise InputError(f"the model to start from has no evidence: {self.failures['']}")

    def look_at(self, sets: Sequence[Keys]) -> None:
        """Evaluate sets further, in no more steps than samples show.

        `settle` takes up those that come near so.
        """
        done = (self.taken_up, self.looked_at)
        new = [k for k in sets if all(known.get(k) is not self.found[k] for known in done)]
        self._weigh_further(new, lambda keys: self._from_its_end(keys, SHOWN), self.looked_at)

    def take_up_best(self, sets: Sequence[Keys]) -> None:
        """Evaluate the best of some sets to the end; another may be it then."""
        while left := [keys for keys in sets if keys in self.found]:
            best = max(left, key=lambda keys: self.found[keys].log_evidence)
            if self._is_taken_up(best):
                break
            self.take_up([best])

    def take_up(self, sets: Sequence[Keys]) -> None:
        """Evaluate sets further, in steps that are short enough.

        A set for which no steps are has no evidence, whatever longer steps made of it: it counts as
        it was before, or not at all.
        """

        def evaluated(keys: Keys) -> Evaluated:
            known = self.found[keys]
            if self.looked_at.get(keys) is known:
                return self._evaluations.resolved(known)
            return self._from_its_end(keys, MOST_SUBSTEPS)

        sets = [keys for keys in sets if not self._is_taken_up(keys)]
        self._weigh_further(sets, evaluated, self.taken_up)

    def _from_its_end(self, keys: Keys, steps: int) -> Evaluated:
        """Evaluate a set from where its fit ended, in so many steps a sample at most."""
        known = self.found[keys]
        # In another noise than that in which it was the better, a richer form may not be.
        plainly = known.refined and self._comes_near_plainly(known)
        forms = (known.refined, ()) if plainly else (known.refined,)
        return best_of(
            lambda refined: self._evaluations.evaluate(
                known.model,
                [known.values],
                refined=refined,
                scheme=known.scheme,
                noise=known.weights,
                steps=steps,
                begun=known,
            ),
            forms,
        )

    def _weigh_further(
        self,
        sets: Sequence[Keys],
        evaluated: Callable[[Keys], Evaluated],
        done: dict[Keys, Evaluated],
    ) -> None:
        """Take sets for what they are once they were evaluated further, and note it."""
        what = "weighing the most probable sets further"
        if sets:
            self.progress(what, 0, len(sets))
        for i, (keys, found) in enumerate(zip(sets, _side_by_side(evaluated, sets), strict=True)):
            known = self.found[keys]
            self.progress(what, i + 1, len(sets))
            if isinstance(found, str):
                self.failures["+".join(keys)] = found
                if keys in self.taken_up:
                    self.found[keys] = self.taken_up[keys]
                elif keys:
                    del self.found[keys]
                    continue
            elif why := self._objection(found):
                self.failures["+".join(keys)] = why
            # In steps that were too long a model may have seemed better than it is.
            elif found.scheme != known.scheme or found.log_evidence > known.log_evidence:
                self.found[keys] = found
            done[keys] = self.found[keys]

    def settle(self) -> None:
        """Take up the sets that come near, until none is left that was not.

        What comes near is looked for again once all have what the likeliest has.
        """
        for _ in range(_MOST_ROUNDS):
            while left := [k for k in self.together.within(CONTENDS) if not self._is_taken_up(k)]:
                self.take_up(left)
            if not (self._share() or self.share_noise()):
                break

    def _is_taken_up(self, keys: Keys) -> bool:
        return self.taken_up.get(keys) is self.found[keys]

    def share_noise(self) -> list[Keys]:
        """Give the likeliest set's noise to every set that it makes likelier; which these are.

        However far behind they are: the noise of one may have been sought in vain, and a set that
        contains it, with effects that do nothing, would be named for the noise that it happened on.
        """
        lead = self.found[max(self.found, key=lambda keys: self.found[keys].log_likelihood)]
        others = [keys for keys, found in self.found.items() if found is not lead]

        def likelier(keys: Keys) -> Evaluated | None:
            known = self.found[keys]
            if not self.evaluator.likelihood_by(known, lead.weights) > known.log_likelihood + SAME:
                return None
            return self.evaluator.reweighed(known, lead.weights)

        return self._adopt(others, _side_by_side(likelier, others))

    def _adopt(self, sets: Sequence[Keys], forms: Iterable[Evaluated | str | None]) -> list[Keys]:
        """Take other forms of sets for what they are; which of these are better so."""
        better = []
        for keys, found in zip(sets, forms, strict=True):
            if found is None or isinstance(found, str):
                continue  # it stays as it was
            if found.log_evidence > self.found[keys].log_evidence + SAME:
                better.append(keys)
            for done in (self.taken_up, self.looked_at):
                if done.get(keys) is self.found[keys]:
                    done[keys] = found
            self.found[keys] = found
        return better

    def _share(self) -> bool:
        """Give the sets that come near what the likeliest of them has; whether any is better so.

        Its noise to seek theirs from, and the richer forms of the effects that they have as well:
        sets are not to be told apart by what was tried with one and not with the other.
        """
        near = self.together.within(LOST)
        lead = self.found[max(near, key=lambda keys: self.found[keys].log_likelihood)]
        others = [keys for keys in near if self.found[keys] is not lead]

        def alike(keys: Keys) -> Evaluated:
            known = self.found[keys]
            forms = [k for k in known.model.refinable(lead.refined) if k not in known.refined]
            if forms:
                shapes = {n: v for n, v in lead.values.items() if n.split(".")[0] in forms}
                richer = self._evaluations.evaluate(
                    known.model,
                    [known.values, {**known.values, **shapes}],
                    refined=(*known.refined, *forms),
                    scheme=known.scheme,
                    noise=lead.weights,
                )
                better = richer.log_evidence > known.log_evidence
                known = richer if better and not self._objection(richer) else known
            return self.evaluator.reweighed(known, lead.weights)

        return bool(self._adopt(others, _side_by_side(alike, others)))

    def describe(self) -> None:
        """Evaluate descriptions in the place of effects of the best set of every size.

        Of a long record only those that come near by a part of the samples.
        """
        ranked = self.together.ranked
        jobs: dict[tuple[Keys, str], tuple[Description, Keys]] = {}
        for keys in {len(keys): keys for keys in reversed(ranked)}.values():
            for one in descriptions_of(self.found[keys], self.base, self.library):
                known = self.described.get(one.rest, {})
                if one.rest not in self.found or one.key in known:
                    continue
                if (one.rest, one.key) not in self._out_of_reach:
                    jobs.setdefault((one.rest, one.key), (one, keys))
        if not jobs:
            return

        least = self._by_part(self.found[ranked[0]]) - _OUT_OF_REACH

        def evaluated(job: tuple[Description, Keys]) -> Evaluated | None:
            (one, keys), fewer = job, self.evaluator.coarse
            starts = one.starts
            if fewer is not None:
                begun = fewer.evaluate(one.model, starts, refined=one.refined, resolved=False)
                if begun.log_evidence < least:
                    return None
                starts = [begun.values]
            return self._evaluations.evaluate(
                one.model, starts, refined=one.refined, noise=self.found[keys].weights
            )

        done = _side_by_side(evaluated, list(jobs.values()))
        for i, ((rest, key), found) in enumerate(zip(jobs, done, strict=True)):
            self.progress("weighing descriptions of something unknown", i + 1, len(jobs))
            known = self.described.setdefault(rest, {})
            if isinstance(found, str):
                self.failures["+".join((*rest, key))] = found
            elif found is None:
                self._out_of_reach.add((rest, key))
            else:
                known[key] = found

    def _best_by_part(self, size: int) -> float:
        """Log evidence [nats] of the best set of a size by a part of a long record's samples."""
        sets = [found for keys, found in self.found.items() if len(keys) == size]
        best = max(sets, key=lambda found: found.log_evidence, default=None)
        return -np.inf if best is None else self._by_part(best)

    def _by_part(self, found: Evaluated) -> float:
        """Log evidence [nats] of a set as it is by a part of a long record; of others none."""
        fewer = self.evaluator.coarse
        if fewer is None:
            return -np.inf
        if found not in self._part:
            try:
                self._part[found] = fewer.as_it_is(found).log_evidence
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                self._part[found] = -np.inf
        return self._part[found]

    def _comes_near_plainly(self, found: Evaluated) -> bool:
        """Whether a part of a long record does not exclude a set in plain form; True of others."""
        try:
            plain = self.evaluator.roughly(
                found.model, [found.values], scheme=found.scheme, noise=found.weights
            )
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            return True
        return plain is None or plain.log_evidence > self._by_part(found) - _UNSETTLED

    def concluded(self) -> Probabilities:
        """Probabilities, once all that comes near was taken up and described."""
        self.settle()
        self.describe()
        return self.together.posterior()


def _side_by_side(
    evaluated: Callable[[_Task], _Found], jobs: Sequence[_Task]
) -> Iterator[_Found | str]:
    """Evaluations of several models at a time, in order, or why there is none."""

    def attempt(job: _Task) -> _Found | str:
        try:
            return evaluated(job)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            return str(error)

    with ThreadPoolExecutor(THREADS) as pool:
        yield from pool.map(attempt, jobs)
