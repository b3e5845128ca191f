"""The model that was found, effect by effect: fitted to trials on which it can then be judged.

The probabilities are of all trials, those that are held out too. Errors are quoted of fits by
least squares to the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import NOTHING, Candidate, unfitted
from identifiability.investigation.ladder.errors import removed_share
from identifiability.investigation.ladder.found import Found, Missing, Tried
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.joint.effects import Effect
from identifiability.joint.programs import THREADS
from identifiability.progress import Progress, silent

Keys = tuple[str, ...]


def found_of(
    bench: Workbench,
    baseline: Candidate,
    posterior: Probabilities,
    claim: Claim,
    library: Mapping[str, type[Effect]],
    *,
    also: Mapping[str, float] | None = None,
    progress: Progress = silent,
) -> Found:
    """Fit the model that a claim speaks of, rung by rung, and gather what else was tried.

    Parameters
    ----------
    bench : Workbench
    baseline : Candidate
        The model that the effects were added to.
    posterior : Probabilities
    claim : Claim
    library : mapping of str to type of Effect
        Effects that were tried.
    also : mapping of str to float, optional
        Values that the fit of the final model starts from as well.
    progress : callable
        Told ``(what, done, total)``.
    """
    climb = _Climb(bench, baseline, posterior, claim, library, also, progress)
    final, missing = climb.final_and_missing()
    alone, n = climb.alone(), len(posterior.sets)
    if final.failure:
        return Found(baseline, alone, baseline, (), None, n, final.failure)
    share = removed_share(bench.split, baseline, final)
    nearest = climb.nearest() if not missing else None
    return Found(baseline, alone, final, missing, share, n, nearest=nearest)


@dataclass(frozen=True, eq=False)
class _Climb:
    bench: Workbench
    baseline: Candidate
    posterior: Probabilities
    claim: Claim
    library: Mapping[str, type[Effect]]
    also: Mapping[str, float] | None
    progress: Progress

    def alone(self) -> tuple[Tried, ...]:
        """Every effect beside the baseline, best first."""
        known, failed = [], []
        for key, kind in self.library.items():
            if key in self.baseline.keys:
                continue
            if (key,) in self.posterior.sets:
                known.append(self._tried(key, (key,), ()))
            elif key in self.posterior.failures:
                model = self.baseline.model + kind()
                nothing = Candidate(model, {}, (), NOTHING, NOTHING)
                failed.append(Tried(key, nothing, 0.0, 1.0, 0.0, self.posterior.failures[key]))
        return (*sorted(known, key=lambda t: -t.evidence), *failed)

    def _tried(self, key: str, keys: Keys, against: Keys) -> Tried:
        one, other = self.posterior.sets[keys], self.posterior.sets[against]
        return Tried(
            key,
            one.candidate,
            one.log_evidence - other.log_evidence,
            one.error,
            self.posterior.of(keys),
        )

    def final_and_missing(self) -> tuple[Candidate, tuple[Missing, ...]]:
        """The final model, and its effects in the order of the ladder."""
        keys = tuple(sorted(self.claim.effects))
        final, missing = self._ladder(keys)
        while missing and self._explains_nothing(missing[-1]):
            keys = tuple(key for key in keys if key != missing[-1].key)
            final, missing = self._ladder(keys)
        return final, missing

    def nearest(self) -> Candidate | None:
        """Beside something unknown, the most probable model with known effects and no more."""
        if self.claim.kind != "unknown":
            return None
        named = (row.effects for row in self.posterior.rows if row.effects is not None)
        keys = next(named, ())
        if not keys or keys not in self.posterior.sets:
            return None
        fitted = self.bench.finish(self.posterior.sets[keys].candidate)
        return None if fitted.failure else fitted

    def _explains_nothing(self, last: Missing) -> bool:
        """Whether a clue at the end of the ladder has nothing to show for itself.

        Beside something unknown many effects make a model a little more probable. Which one does
        most of all is chance; one that no error falls by is not worth a look.
        """
        small = last.share is not None and last.share < self.bench.rules.trace_share
        beside = self.claim.kind == "effects" and not self.claim.names(last.key)
        return small and (self.claim.kind == "unknown" or beside)

    def _ladder(self, keys: Keys) -> tuple[Candidate, tuple[Missing, ...]]:
        """A model with some effects, and these in the order of the ladder."""
        if not keys:
            return self.baseline, ()
        order = self._order(keys)
        rungs = [tuple(sorted(order[: i + 1])) for i in range(len(order))]
        rests = [tuple(k for k in keys if k != key) for key in order]
        wanted = list(dict.fromkeys([*rungs[:-1], *(r for r in rests if r)]))

        def told(one: Keys, done: int) -> None:
            self.progress(f"fitting {' + '.join(['K, B, I', *one])}", done, len(wanted) + 1)

        told(keys, 0)
        final = self._final(self._weighed(keys))
        if final.failure:
            return final, ()
        fits: dict[Keys, Candidate] = {(): self.baseline}
        with ThreadPoolExecutor(THREADS) as pool:
            done = pool.map(lambda one: self._fit(one, final), wanted)
            for i, one in enumerate(wanted):
                told(one, i + 1)
                fits[one] = next(done)
        fits[keys] = self._at_least(final, fits[rungs[-2]]) if len(rungs) > 1 else final
        out: list[Missing] = []
        before: float | None = 0.0
        for key, rung, rest in zip(order, rungs, rests, strict=True):
            could_be = next((names for names in self.claim.sets if key in names), (key,))
            removed = removed_share(self.bench.split, self.baseline, fits[rung])
            share = None if removed is None or before is None else removed - before
            out.append(
                Missing(
                    fits[keys].model.effect(key),
                    fits[rung],
                    fits[rest],
                    self._rivals(key, keys),
                    could_be,
                    self._instead(could_be, key, rest),
                    share,
                )
            )
            before = removed
        return fits[keys], tuple(out)

    def _final(self, weighed: Candidate) -> Candidate:
        """A set fitted from where it was weighed, and from where it is known to leave less."""
        if self.also is None or set(self.also) != set(weighed.model.parameter_names):
            return self.bench.finish(weighed)
        starts = [weighed.values, self.also]
        return self.bench.fit(weighed.model, starts, refined=weighed.refined)

    def _weighed(self, keys: Keys) -> Candidate:
        """A set as it was weighed; or, of the likeliest that has all of it, what is left of it.

        What every likely set has need not have been weighed by itself.
        """
        known = self.posterior.sets
        if keys in known:
            return known[keys].candidate
        larger = [one for one in known if set(keys) < set(one)]
        candidate = known[max(larger, key=lambda one: known[one].log_evidence)].candidate
        return self._part(candidate, keys)

    def _part(self, candidate: Candidate, keys: Keys) -> Candidate:
        """A model's part with fewer of its effects, to be fitted from its values."""
        model = candidate.model
        for key in candidate.keys:
            if key not in (*keys, *self.baseline.keys):
                model = model.without(key)
        values = {name: candidate.values[name] for name in model.parameter_names}
        return unfitted(model, values, model.refinable(candidate.refined))

    def _order(self, keys: Keys) -> list[str]:
        """Effects of a set, at every rung the one with which the model is most probable."""
        order: list[str] = []
        left = list(keys)
        while left:
            weighed = {
                key: self.posterior.sets[found].log_evidence
                for key in left
                if (found := tuple(sorted((*order, key)))) in self.posterior.sets
            }
            # A set that was not weighed left little to hope for.
            order.append(max(weighed, key=lambda key: weighed[key]) if weighed else left[0])
            left.remove(order[-1])
        return order

    def _fit(self, keys: Keys, final: Candidate) -> Candidate:
        """A smaller model, from where it was weighed, or from the final model's values."""
        if keys in self.posterior.sets:
            return self.bench.finish(self.posterior.sets[keys].candidate)
        return self.bench.finish(self._part(final, keys))

    def _at_least(self, final: Candidate, rung: Candidate) -> Candidate:
        """The final model, which leaves no more than a rung of its ladder does."""
        if rung.failure or final.fitted.weighted <= rung.fitted.weighted:
            return final
        starts: Sequence[Mapping[str, float]] = starting_values(final.model, rung.values)
        again = self.bench.fit(final.model, starts, refined=final.refined)
        better = not again.failure and again.fitted.weighted < final.fitted.weighted
        return again if better else final

    def _instead(self, could_be: Keys, key: str, rest: Keys) -> tuple[Candidate, ...]:
        """The final model with other effects in an effect's place, as far as they were weighed."""
        others = [tuple(sorted((*rest, name))) for name in could_be if name not in (key, *rest)]
        known = [self.posterior.sets[keys] for keys in others if keys in self.posterior.sets]
        fitted = [self.bench.finish(weighed.candidate) for weighed in known]
        return tuple(one for one in fitted if not one.failure)

    def _rivals(self, key: str, keys: Keys) -> tuple[Tried, ...]:
        """What was weighed in the place of an effect of the final model, best first."""
        if keys not in self.posterior.sets:
            return ()  # there is nothing to hold them against
        rest = {k for k in keys if k != key}
        tried = [
            self._tried(next(iter(set(one) - rest)), one, keys)
            for one in self.posterior.sets
            if len(one) == len(keys) and one != keys and rest < set(one)
        ]
        return tuple(sorted(tried, key=lambda t: -t.evidence))
