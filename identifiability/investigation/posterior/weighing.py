"""Candidates are weighed as they come, and put together as probabilities.

How many effects there are is as probable for every number from none to the most that are tried;
then every set of so many is, the unknown being one of the effects (Scott & Berger 2010, Ann Stat
38:2587-2619): trying more effects makes a false name no more likely. A set with a discrepancy of no
more than a tenth of what its effects explain, beyond what K, B and I do, is still that set, whose
equations are not exact; with more it is "none of these".
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from math import comb, log
from typing import TypeVar

import numpy as np

from identifiability.errors import InputError
from identifiability.investigation.fits.candidate import unfitted
from identifiability.investigation.posterior.descriptions import Description, descriptions_of
from identifiability.investigation.posterior.discrepancy import (
    Discrepancy,
    Discrepant,
    discrepancy_of,
)
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
    SetProbability,
    WeighedSet,
)
from identifiability.investigation.rules import Rules
from identifiability.joint.effects import DESCRIPTIONS
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS
from identifiability.joint.scheme import MOST_SUBSTEPS
from identifiability.progress import Progress, silent

Keys = tuple[str, ...]
_Task = TypeVar("_Task")
_Found = TypeVar("_Found")

LOST = 60.0
"""Log evidence [nats] behind the best from which a set is not fitted any further."""

_CONTENDS = 12.0  # nats that a set may be behind, for a discrepancy to be put beside it
_MOST_BESIDE, _BEST_OF_SIZE = 6, 2
_MOST_ROUNDS = 4  # in which sets are given what the likeliest has
_FAR = 0.05  # share of what the best of its size gained, that a set may lack
_SURE = 3.0  # nats by which values that no joint has must be better, to count
_DRIFT = "sensor_drift"  # the effect that a discrepancy of the kind "drift" is
_OUT_OF_REACH = 20.0
"""Nats that a description is behind the best set by a part of a long record's samples, from which
all of them do not make up for it: four times as many make it four times as much worse, give or take
twice the root of that."""
_UNSETTLED = 40.0
"""The same of a fit to that part that is only begun."""
_RICHER = 0.5  # share of what the best of its size gained, that a richer form of it may gain
_MENDERS = 4
"""Effects that may mend the equations of any other: with so many a set and the same with one effect
more, which does no more than that, are as probable as each other. In blind cases the larger set was
true about half the time."""
_SAME = 0.5  # nats by which two evidences of one thing may differ


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


@dataclass(frozen=True, eq=False)
class _Forms:
    """Sets whose equations are not exact, or beside which there is something unknown.

    Attributes
    ----------
    inexact : dict of tuple of str to float
        Log evidence [nats] of a set whose equations are wrong by no more than they may be.
    unknown : dict of tuple of str to float
        Log evidence and log prior of a set and something unknown.
    described : dict of tuple of str to str
        Of these, those in which a description of no mechanism is what is unknown, and its key.
    beside : dict of tuple of str to Discrepant
        Each set that was tried, with any discrepancy.
    """

    inexact: dict[Keys, float] = field(default_factory=dict)
    unknown: dict[Keys, float] = field(default_factory=dict)
    described: dict[Keys, str] = field(default_factory=dict)
    beside: dict[Keys, Discrepant] = field(default_factory=dict)


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
    _discrepancies: tuple[Evaluated, Discrepancy] | None = None
    _inexact: dict[
        tuple[Evaluated, Evaluated, Discrepant | None], tuple[Discrepant, Discrepant]
    ] = field(default_factory=dict)
    _part: dict[Evaluated, float] = field(default_factory=dict)

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
                job.model, job.starts, refined=job.refined, noise=job.begins_in
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
        """Evaluate sets further, in no more steps than samples show; the best of them to the end.

        Of the others `settle` takes up those that come near so.
        """
        done = (self.taken_up, self.looked_at)
        new = [k for k in sets if all(known.get(k) is not self.found[k] for known in done)]
        self._weigh_further(new, lambda keys: self._from_its_end(keys, SHOWN), self.looked_at)
        # Another may lead once the first was taken up.
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
            while left := [k for k in self._within(_CONTENDS) if not self._is_taken_up(k)]:
                self.take_up(left)
            if not (self._share() or self.share_noise()):
                break

    def _within(self, nats: float) -> list[Keys]:
        """The most probable sets, no more than so many nats behind the first."""
        ranked = sorted(self.found, key=lambda keys: -self.score(keys))
        least = self.score(ranked[0]) - nats
        return [keys for keys in ranked[:_MOST_BESIDE] if self.score(keys) > least]

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
            if not self.evaluator.likelihood_by(known, lead.weights) > known.log_likelihood + _SAME:
                return None
            return self.evaluator.reweighed(known, lead.weights)

        return self._adopt(others, _side_by_side(likelier, others))

    def _adopt(self, sets: Sequence[Keys], forms: Iterable[Evaluated | str | None]) -> list[Keys]:
        """Take other forms of sets for what they are; which of these are better so."""
        better = []
        for keys, found in zip(sets, forms, strict=True):
            if found is None or isinstance(found, str):
                continue  # it stays as it was
            if found.log_evidence > self.found[keys].log_evidence + _SAME:
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
        near = self._within(LOST)
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
        ranked = sorted(self.found, key=lambda keys: -self.score(keys))
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

    def _near(self) -> list[Keys]:
        """Sets that come near the best, and the best of every size."""
        ranked = sorted(self.found, key=lambda keys: -self.score(keys))
        near = self._within(_CONTENDS)
        # Inexact equations may make up for an effect more.
        for n in sorted({len(keys) for keys in ranked}):
            of_size = [keys for keys in ranked if len(keys) == n][:_BEST_OF_SIZE]
            near += [keys for keys in of_size if not self.is_far(keys, of_size[0])]
        return list(dict.fromkeys(near))

    def is_far(self, keys: Keys, best: Keys) -> bool:
        """Whether a set leaves so much more than the best of its size that it cannot pass it."""
        top = self.found[best].log_evidence
        gained = top - self.found[()].log_evidence
        return top - self.found[keys].log_evidence > max(LOST, _FAR * gained)

    def log_prior(self, n_effects: int) -> float:
        """Of one set of so many effects, the unknown counted as one of the library."""
        return log_prior(n_effects, len(self.library) + 1)

    def score(self, keys: Keys) -> float:
        """Log evidence and log prior [nats] of a set whose equations are exact."""
        return self.found[keys].log_evidence + self.log_prior(len(keys))

    def concluded(self) -> Probabilities:
        """Probabilities, once all that comes near was taken up and described."""
        self.settle()
        self.describe()
        return self.posterior()

    def posterior(self) -> Probabilities:
        """Probabilities of all that was weighed."""
        ranked = sorted(self.found, key=lambda keys: -self.score(keys))
        forms = self._forms(ranked)
        rows = self._rows(self._named(forms.inexact), forms)
        named = next(row.effects for row in rows if row.effects is not None)
        unknown = max(forms.unknown, key=lambda keys: forms.unknown[keys], default=())
        shown = unknown if rows[0].effects is None else named
        return Probabilities(
            rows,
            shown,
            self.found[shown].values,
            self.found[shown].weights.estimate.rms,
            self.evaluator.band.scale,
            forms.beside.get(shown),
            unknown,
            self._beside_unknown(rows, forms),
            forms.described.get(unknown),
            {keys: self._weighed(found) for keys, found in self.found.items()},
            (self.evaluator.band.n_samples, self.evaluator.band.n_recorded),
            dict(self.failures),
            {keys: behind for keys, behind in self.screened.items() if keys not in self.found},
        )

    def _weighed(self, found: Evaluated) -> WeighedSet:
        """A model as it was weighed, for those who look at it later."""
        candidate = unfitted(found.model, found.values, found.refined, found.scheme)
        error = (found.weights.estimate.rms / self.evaluator.band.scale) ** 2
        return WeighedSet(candidate, found.log_evidence, error, found.sds)

    def _forms(self, ranked: Sequence[Keys]) -> _Forms:
        """The sets that come near, with their equations inexact, and with something unknown."""
        likeliest = self.found[ranked[0]]
        if self._discrepancies is None or self._discrepancies[0] is not likeliest:
            self._discrepancies = likeliest, discrepancy_of(self.evaluator, likeliest)
            self._inexact.clear()
        least, forms = self.score(ranked[0]) - _CONTENDS, _Forms()
        near = sorted(self._near(), key=len)
        for i, keys in enumerate(near):
            self.progress("weighing something unknown", i, len(near))
            found, besides = self.found[keys], self._besides(keys)
            if found.beyond > _SURE and self.score(keys) > least:
                # The same effects with values that no joint has are none of these. By how much more
                # probable is not known far from what was fitted.
                forms.unknown[keys] = found.log_evidence + found.beyond + besides
            smaller = [d for k, d in forms.beside.items() if set(k) < set(keys)]
            nested = max(smaller, key=lambda d: d.log_evidence, default=None)
            one = self._beside(self._discrepancies[1], keys, nested)
            if one is None:
                continue
            free, form = one
            forms.beside[keys] = free
            if free.kind == "none":
                continue  # a discrepancy of no size is none
            # One that the equations' error explains is not something unknown besides.
            if self._drifts(keys, free):
                drifting = tuple(sorted((*keys, _DRIFT)))
                known = forms.inexact.get(drifting, -np.inf)
                forms.inexact[drifting] = max(free.log_evidence, known)
            elif form.log_evidence < free.log_evidence - _SAME:
                known = forms.unknown.get(keys, -np.inf)
                forms.unknown[keys] = max(free.log_evidence + besides, known)
            known = forms.inexact.get(keys, -np.inf)
            forms.inexact[keys] = max(form.log_evidence, known)
        for keys, by_key in self.described.items():
            for key, found in by_key.items():
                value = found.log_evidence + self._besides(keys)
                if value > forms.unknown.get(keys, -np.inf):
                    forms.unknown[keys], forms.described[keys] = value, key
        return forms

    def _besides(self, keys: Keys) -> float:
        """Log prior [nats] of a set and one form of something unknown, of all that there are."""
        return self.log_prior(len(keys) + 1) - log(1 + len(DESCRIPTIONS))

    def _drifts(self, keys: Keys, free: Discrepant) -> bool:
        """Whether a discrepancy is a drift of the recorder, which is known, in another form."""
        if _DRIFT in keys or tuple(sorted((*keys, _DRIFT))) not in self.found:
            return False
        others = np.sqrt(sum(size**2 for kind, size in free.sizes.items() if kind != "drift"))
        return free.kind == "drift" and others <= self._tolerated(keys)

    def _tolerated(self, keys: Keys) -> float:
        """Discrepancy, over the response, that inexact equations of a set may leave."""
        explained = self._explained(self.found[keys]) / self.evaluator.band.scale
        return max(self.rules.equations * explained, self.rules.trifle)

    def _rows(self, named: Mapping[Keys, float], forms: _Forms) -> tuple[SetProbability, ...]:
        """Probabilities from their logarithms, which lack a constant."""
        top = max([*named.values(), *forms.unknown.values()])
        weights = {keys: np.exp(value - top) for keys, value in named.items()}
        of_unknown = sum(np.exp(value - top) for value in forms.unknown.values())
        total = sum(weights.values()) + of_unknown
        rows = [
            SetProbability(keys, float(w / total), named[keys] - self.log_prior(len(keys)))
            for keys, w in weights.items()
        ]
        most = max((d.log_evidence for d in forms.beside.values()), default=-np.inf)
        rows.append(SetProbability(None, float(of_unknown / total), most))
        return tuple(sorted(rows, key=lambda row: -row.probability))

    @staticmethod
    def _beside_unknown(rows: Sequence[SetProbability], forms: _Forms) -> dict[Keys, float]:
        """Probability of "none of these" by the known effects beside which it is."""
        whole = next(row.probability for row in rows if row.effects is None)
        top = max(forms.unknown.values(), default=0.0)
        weights = {keys: np.exp(value - top) for keys, value in forms.unknown.items()}
        total = sum(weights.values())
        return {keys: float(whole * w / total) for keys, w in weights.items()}

    def _named(self, inexact: Mapping[Keys, float]) -> dict[Keys, float]:
        """Log of what is proportional to the probability of each set, its equations exact or not.

        Equations that are wrong by as little as the rules allow may be mended by an effect that is
        not there: then a set and the same with that effect are both what the data would look like.
        """
        every = len(self.library) + 1
        found: dict[Keys, float] = {}
        for keys in sorted(self.found, key=len, reverse=True):
            exact = self.found[keys].log_evidence
            mended = [inexact[keys]] if keys in inexact else []
            for more, value in found.items():
                if len(more) == len(keys) + 1 and set(keys) < set(more) and self.mends(keys, more):
                    mended.append(value + log(min(1.0, _MENDERS / every)))
            # As probable as that the equations are exact.
            found[keys] = float(np.logaddexp.reduce([exact, *mended])) - log(2) * bool(mended)
        return {keys: value + self.log_prior(len(keys)) for keys, value in found.items()}

    def mends(self, keys: Keys, more: Keys) -> bool:
        """Whether one effect more does no more than the error of a set's equations may be."""
        fewer, richer = self.found[keys], self.found[more]
        return _moved(fewer, richer) <= self.rules.equations * self._explained(fewer)

    def _explained(self, found: Evaluated) -> float:
        """What effects explain: root mean square by which the prediction moves because of them.

        From that of K, B and I alone, so that what K, B and I do as well, and effects that cancel
        each other, do not count.
        """
        return _moved(self.found[()], found)

    def _beside(
        self, discrepancies: Discrepancy, keys: Keys, nested: Discrepant | None
    ) -> tuple[Discrepant, Discrepant] | None:
        """A set with any discrepancy, and with one that its equations' error explains.

        Computed once, for as long as nothing that it follows from is another.
        """
        # The explained share hangs on what K, B and I leave, too.
        asked = self.found[keys], self.found[()], nested
        if asked not in self._inexact:
            try:
                found = discrepancies.inexact(self.found[keys], self._tolerated(keys), nested)
            except (ValueError, np.linalg.LinAlgError) as error:
                self.failures[f"{'+'.join(keys)} and a discrepancy"] = str(error)
                return None
            self._inexact[asked] = found
        return self._inexact[asked]


def log_prior(n_effects: int, every: int) -> float:
    """Log prior [nats] of one set of so many effects of `every`, but for a constant."""
    return -log(comb(every, min(n_effects, every)))


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


def _moved(one: Evaluated, other: Evaluated) -> float:
    """Root mean square [rad or Nm] of the difference of two models' predictions."""
    moved = [a[:, 0] - b[:, 0] for a, b in zip(one.raw, other.raw, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(moved) ** 2)))
