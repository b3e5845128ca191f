"""Which sets of effects are weighed: one effect at a time, for as long as something is missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.posterior.combining import LOST, Combining, Keys
from identifiability.investigation.posterior.descriptions import renamed
from identifiability.investigation.posterior.evidence import NOISE_SHARE, Evaluator
from identifiability.investigation.posterior.jobs import STARTS_BESIDE, enlarged, exchanged, richer
from identifiability.investigation.posterior.kept import Evaluations
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.posterior.signatures import strongest
from identifiability.investigation.posterior.stepwise import Step, stepwise
from identifiability.investigation.posterior.weighing import Job, Weighing
from identifiability.investigation.rules import Rules
from identifiability.joint.effects import Effect
from identifiability.progress import Progress, silent

_SEEN = 6  # effects that are added to a set that has effects already
_TAKEN_UP = 3  # sets of one size that are evaluated further, at most
# Effects up to which the best set is evaluated to the end before anything is added to it: of more
# that takes minutes where contacts are hard, and the most probable ones are in the end anyway.
_TO_THE_END = 2
_REFINED = 3  # sets of one size that are refined, at most
_WORTH_REFINING = 3.0  # nats before K, B and I alone
# Nats, or the share of what the best of its size gained, from which a set behind it is not refined:
# where noise is low, a plain form may leave much of what its richer one explains.
_BEHIND_SHARE = 0.5
_NEAR = 12.0  # nats behind the best of its size, within which another set is enlarged too
_EXCHANGED = 2  # effects up to which each is tried without the one that was found before it
_BACK = 2  # times that the most probable set is weighed without each of its effects
_POOR = 0.1  # share of what a set gained, that one effect more gains, if it was a poor picture
# Nats behind the most probable set within which others have their effects exchanged for look-alikes
# too, and how many of all these, at most.
_CLOSE, _MOST_CLOSE = 5.0, 3


def weigh(
    evaluator: Evaluator,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    most: int,
    progress: Progress = silent,
    kept: Evaluations | None = None,
    rules: Rules | None = None,
) -> Probabilities:
    """Weigh the sets of effects that may be missing.

    All single effects are, the most probable ones refined too. The most probable set is enlarged by
    every effect whose signature is in what it leaves, for as long as that makes it more probable
    and does more than mend equations; so is one that comes near without the effect which does most
    in it: two effects may be taken for a third one and its correction.
    What was added last may be what was missing all along, and what was found before it a poor
    picture of it: of a pair that leaves much less, both are enlarged. The most probable set is
    weighed without each of its effects as well: none is named that was never left out; and with a
    look-alike in the place of each: none is named that what it is confused with did not stand in
    for. If that set
    leaves more than an instrument would, or something unknown cannot be excluded, those that leave
    least are weighed as well.

    Parameters
    ----------
    evaluator : Evaluator
    baseline : Candidate
        The model to start from, fitted.
    library : mapping of str to type of Effect
        Effects to be tried.
    most : int
        Most effects to add.
    progress : callable
        Told ``(what, done, total)``.
    kept : Evaluations, optional
        Where models that were weighed before are taken from.
    rules : Rules, optional
        Conventions; the package's own by default.

    Raises
    ------
    InputError
        Where the model to start from cannot be evaluated.
    """
    weighing = Weighing(evaluator, library, baseline.keys, rules or Rules(), progress, kept)
    search = _Search(weighing, library, progress)
    search.add("K, B and I", [Job(baseline.model, [baseline.values], baseline.refined)])
    weighing.require_base()
    search.enlarge(())
    for size in range(2, most + 1):
        before = search.best(size - 1)
        if before is None or not search.improves(before) or search.only_mends(before):
            break
        for keys in search.contenders(size - 1):
            search.enlarge(keys)
        for _ in range(size if size <= _EXCHANGED else 0):
            found = search.best(size)
            left = search.not_enlarged(found) if found is not None else None
            if found is None or left is None or not search.was_poor(found):
                break
            search.enlarge(left)
    search.leave_out()
    search.exchange(most)
    posterior = weighing.concluded()
    credible = posterior.credible(weighing.rules.claimed)
    if search.leaves_much() or any(row.effects is None for row in credible):
        search.follow(stepwise(evaluator, weighing.found[()], library, most, progress), most)
        search.leave_out()
        search.exchange(most)
        posterior = weighing.concluded()
    return posterior


@dataclass(eq=False)
class _Search:
    weighing: Weighing
    library: Mapping[str, type[Effect]]
    progress: Progress
    enlarged: list[Keys] = field(default_factory=list)
    refined: set[Keys] = field(default_factory=set)
    reduced: set[Keys] = field(default_factory=set)
    plainer: set[Keys] = field(default_factory=set)
    exchanged: set[Keys] = field(default_factory=set)
    plain: dict[Keys, float] = field(default_factory=dict)

    @property
    def together(self) -> Combining:
        """What puts the sets together."""
        return self.weighing.together

    def add(self, what: str, jobs: Sequence[Job]) -> None:
        """Weigh some models, and say how far this has come."""
        for i, _ in enumerate(self.weighing.weigh(jobs)):
            self.progress(f"weighing {what}", i + 1, len(jobs))
        # Before any is refined: a set is compared with others in one form.
        for keys, found in self.weighing.found.items():
            self.plain.setdefault(keys, found.log_evidence)

    def enlarge(self, keys: Keys) -> None:
        """Add every effect to a set whose signature is in what it leaves; refine the best."""
        self.enlarged.append(keys)
        known = self.weighing.found
        current = known[keys]
        more = {
            key: effect
            for key, effect in self.library.items()
            if current.model.takes(effect) and tuple(sorted((*keys, key))) not in known
        }
        alone = {key: known[key,].values for key in more if (key,) in known}
        most = _SEEN if keys else len(more)
        seen = strongest(self.weighing.evaluator, current, more, alone, most)
        jobs = [enlarged(current, more[key](), alone.get(key, {})) for key in seen]
        # Of single effects all: what each does alone is told, and where the others start from.
        ready = self.weighing.in_reach(jobs) if keys else jobs
        self.add(f"what may be added to {' + '.join(['K, B, I', *keys])}", ready)
        self._decide(len(keys) + 1)

    def _decide(self, size: int) -> None:
        """Weigh the best sets of a size further, in one noise, and refine them."""
        known = self.weighing.found
        # Not the best alone: what another gains when it is integrated finer may be what decides.
        ranked = self._ranked(size)[:_TAKEN_UP]
        near = [keys for keys in ranked if not self.together.is_far(keys, ranked[0])]
        self.weighing.look_at(near)
        if size <= _TO_THE_END:
            self.weighing.take_up_best(near)
        for better in self.weighing.share_noise():
            if better not in self.refined:
                self.plain[better] = known[better].log_evidence
        self._refine(size)

    def leave_out(self) -> None:
        """Weigh the most probable set without each of its effects, then the best of these sets so.

        And with a plainer effect in the place of one that is a richer form of it, in which a fit
        may have found values that it missed in the plainer one.

        Of a set that was reached by another way, or by values that were poorer, more may be made:
        what is the best of its size now is enlarged.
        """
        found = self.weighing.found
        for _ in range(_BACK):
            keys, before = self.together.ranked[0], set(self.enlarged)
            if keys not in self.plainer:
                self.plainer.add(keys)
                self.add("plainer forms", self._plainer(keys))
            while len(keys) > 1 and keys not in self.reduced:
                self.reduced.add(keys)
                rests = _without_one(keys)
                self.add(f"{' + '.join(keys)} without one", [self._rest(keys, r) for r in rests])
                keys = max((r for r in rests if r in found), key=self.together.score, default=())
                if keys and keys == self.best(len(keys)) and keys not in self.enlarged:
                    self.enlarge(keys)
            if before == set(self.enlarged):
                break

    def exchange(self, most: int) -> None:
        """Weigh the most probable sets with a look-alike in the place of each of their effects.

        One effect at a time leads past a set whose effects are both second best alone. What is the
        best of its size now is enlarged.
        """
        for _ in range(_BACK):
            close = [k for k in self._close() if len(k) > 1 and k not in self.exchanged]
            if not close:
                break
            self.exchanged.update(close)
            jobs: dict[Keys, Job] = {}
            for keys in close:
                jobs |= self._exchanges(keys)
            sizes = sorted({len(keys) for keys in jobs})
            for size in sizes:
                of_size = [job for keys, job in jobs.items() if len(keys) == size]
                self.add("look-alikes", self.weighing.in_reach(of_size))
            for size in sizes:
                before = self.best(size)
                self._decide(size)
                self._go_on(size, before, most)

    def _close(self) -> list[Keys]:
        """The most probable set, and those that come near."""
        score, ranked = self.together.score, self.together.ranked
        return [k for k in ranked if score(k) > score(ranked[0]) - _CLOSE][:_MOST_CLOSE]

    def _exchanges(self, keys: Keys) -> dict[Keys, Job]:
        """A set with each look-alike in the place of each of its effects, if not weighed yet."""
        found, jobs = self.weighing.found, {}
        known = found[keys]
        for key in keys:
            rest = known.model.without(key)
            for other in self.library[key].confused_with:
                others = tuple(sorted({*keys, other} - {key}))
                if other not in self.library or other in keys:
                    continue
                if others in found or others in self.weighing.screened:
                    continue
                if rest.takes(self.library[other]):
                    alone = found[other,].values if (other,) in found else {}
                    jobs[others] = exchanged(known, key, self.library[other](), alone)
        return jobs

    def _go_on(self, size: int, before: Keys | None, most: int) -> None:
        """Enlarge the best set of a size where it is another one than before."""
        best = self.best(size)
        new = best is not None and best != before and best not in self.enlarged
        if best is not None and new and size < most and self.improves(best):
            self.enlarge(best)

    def _plainer(self, keys: Keys) -> list[Job]:
        """A set with a plainer effect in the place of each that is a richer form of one."""
        larger, jobs = self.weighing.found[keys], []
        for key in keys:
            for other in larger.model.effect(key).refines:
                rest = larger.model.without(key)
                if other not in self.library or not rest.takes(self.library[other]):
                    continue
                model = rest + self.library[other]()
                values = renamed(larger, key, other, model)
                if values is not None:
                    forms = (other if k == key else k for k in larger.refined)
                    jobs.append(Job(model, [values], model.refinable(forms), larger.weights))
        return jobs

    def _rest(self, keys: Keys, rest: Keys) -> Job:
        """A set without one of its effects, from what is left of its values."""
        larger = self.weighing.found[keys]
        model = self.weighing.found[()].model.plus(larger.model.effect(key) for key in rest)
        starts = [{name: larger.values[name] for name in model.parameter_names}]
        if rest not in self.weighing.found:
            joint = {name: larger.values[name] for name in ("K", "B", "I")}
            starts += starting_values(model, joint, most=STARTS_BESIDE, wide=True)
        refined = model.refinable(larger.refined)
        # In longer steps it might not be as likely even where the effect that is gone does nothing.
        return Job(model, starts, refined, larger.weights, looked_at=True)

    def leaves_much(self) -> bool:
        """Whether the most probable set leaves more than the noise of a good recording."""
        weighing = self.weighing
        likely = weighing.found[self.together.ranked[0]]
        share = (likely.weights.estimate.rms / weighing.evaluator.band.scale) ** 2
        return share > NOISE_SHARE

    def follow(self, steps: Iterable[Step], most: int) -> None:
        """Weigh the sets on a way, and what may be added to those that are more probable.

        Of sets that were weighed already, other values may be more probable.
        """
        known = {size: self.best(size) for size in range(1, most + 1)}
        for step in steps:
            self.add("what leaves least", [Job(step.model, [step.values])])
        for size, before in known.items():
            self._refine(size)
            self._go_on(size, before, most)

    def _refine(self, size: int) -> None:
        """Free the refining parameters of the best sets of a size."""
        found = self.weighing.found
        # What has no richer form takes nobody's place.
        of_size = [k for k, one in found.items() if len(k) == size and one.model.refinable(k)]
        ranked = sorted(of_size, key=lambda keys: -self.plain[keys])[:_REFINED]
        jobs: list[Job] = []
        for keys in ranked:
            behind = self.plain[ranked[0]] - self.plain[keys]
            most = max(LOST, _BEHIND_SHARE * (self.plain[ranked[0]] - self.plain[()]))
            gain = found[keys].log_evidence - found[()].log_evidence
            if keys in self.refined or behind > most or gain < _WORTH_REFINING:
                continue
            self.refined.add(keys)
            jobs += richer(found[keys], keys)
        self.add("richer forms", jobs)

    def _ranked(self, size: int) -> list[Keys]:
        """Sets of a size, the best first."""
        sets = [keys for keys in self.weighing.found if len(keys) == size]
        return sorted(sets, key=lambda keys: -self.weighing.found[keys].log_evidence)

    def _smaller(self, keys: Keys) -> Keys:
        """Best set with one effect less, or with fewer where none of those could be integrated."""
        return next(self._ranked(n)[0] for n in range(len(keys) - 1, -1, -1) if self._ranked(n))

    def best(self, size: int) -> Keys | None:
        """Best set of a size."""
        return next(iter(self._ranked(size)), None)

    def contenders(self, size: int) -> list[Keys]:
        """Sets of a size to be enlarged: the best, and one that comes near by another way.

        That is the next of single effects, and of larger sets the next without the effect that
        does most in the best one.
        """
        ranked, found = self._ranked(size), self.weighing.found
        best = ranked[0]
        alone = {key: found[key,].log_evidence for key in best if (key,) in found}
        most = max(alone, key=lambda key: alone[key], default=best[0])
        least = found[best].log_evidence - _NEAR
        near = (k for k in ranked[1:] if found[k].log_evidence > least and most not in k)
        return [best, *([other] if (other := next(near, None)) is not None else [])]

    def improves(self, keys: Keys) -> bool:
        """Whether a set is more probable than the best with one effect less."""
        return self.together.score(keys) > self.together.score(self._smaller(keys))

    def only_mends(self, keys: Keys) -> bool:
        """Whether a set does no more than mend the equations of the best with one effect less."""
        return len(keys) > 1 and self.together.mends(self._smaller(keys), keys)

    def was_poor(self, keys: Keys) -> bool:
        """Whether a set leaves so much less than the best with one effect less.

        If not, what was added last may mend that one's equations, but does not do its work.
        """
        found = self.weighing.found
        smaller, nothing = found[self._smaller(keys)], found[()]
        more = found[keys].log_evidence - smaller.log_evidence
        return more > _POOR * (smaller.log_evidence - nothing.log_evidence)

    def not_enlarged(self, keys: Keys) -> Keys | None:
        """Rest of a set without one of its effects that has not been enlarged itself."""
        return next(
            (r for r in _without_one(keys) if r in self.weighing.found and r not in self.enlarged),
            None,
        )


def _without_one(keys: Keys) -> list[Keys]:
    """A set without each of its effects."""
    return [tuple(k for k in keys if k != key) for key in keys]
