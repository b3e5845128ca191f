"""The search for missing effects: add, swap, drop, simplify; each time refitted, and judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.search.criterion import (
    pooled_error,
    removed_share,
    total_evidence,
)
from identifiability.investigation.search.equivalence import comes_near, could_be
from identifiability.investigation.search.fitter import Fitter
from identifiability.investigation.search.found import Found, Missing, Ranking
from identifiability.investigation.search.gate import Gate, Ranked
from identifiability.investigation.search.ranking import Ranker
from identifiability.investigation.search.rivals import Rivals
from identifiability.joint.effects import Effect
from identifiability.progress import Progress, silent


def search(
    bench: Workbench,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    *,
    most: int | None = None,
    progress: Progress = silent,
) -> Found:
    """Search for effects that a fitted model lacks.

    Parameters
    ----------
    bench : Workbench
    baseline : Candidate
        The model to start from.
    library : mapping of str to type of Effect
        Effects to be tried.
    most : int, optional
        Most effects to add; the rules' number by default.
    progress : callable
        Told ``(what, done, total)``.

    Returns
    -------
    Found
    """
    most = bench.rules.most_effects if most is None else most
    return _Search(ranker_of(bench, baseline, library, progress), baseline).run(most)


def found_of(
    bench: Workbench,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    final: Candidate,
    sets: Sequence[Sequence[str]],
    *,
    progress: Progress = silent,
) -> Found:
    """All that is to be known of missing effects that were found otherwise.

    Parameters
    ----------
    bench, baseline, library, progress
        See `search`.
    final : Candidate
        The model with the effects that are missing; the baseline where none is.
    sets : sequence of sequence of str
        For each of them all that it could be, its own key included.
    """
    run = _Search(ranker_of(bench, baseline, library, progress), baseline)
    return run.of(bench.finish(final), sets)


def rank(
    bench: Workbench,
    current: Candidate,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    *,
    progress: Progress = silent,
) -> Ranking:
    """Add every effect of a library to a model, refit, and rank.

    The answer depends on the arguments alone, not on what was fitted before.

    Parameters
    ----------
    bench : Workbench
    current : Candidate
        The model that effects are added to.
    baseline : Candidate
        The model without any effect: a further effect is judged by what those before it removed.
    library, progress
        See `search`.

    Returns
    -------
    Ranking
    """
    return ranker_of(bench, baseline, library, progress).rank(current)


def ranker_of(
    bench: Workbench,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    progress: Progress,
) -> Ranker:
    """What fits, judges and ranks effects beside models of one study: see `rank`."""
    return Ranker(bench, library, Fitter(bench, baseline), Gate(bench, baseline), progress)


@dataclass(frozen=True, eq=False)
class _Search:
    """One search from a baseline."""

    ranker: Ranker
    baseline: Candidate

    @cached_property
    def rivals(self) -> Rivals:
        return Rivals(self.ranker, self.baseline)

    def run(self, most: int) -> Found:
        gate, current, rankings = self.ranker.gate, self.baseline, list[Ranking]()
        ended = "most effects"
        while len(self.rivals.added(current)) < most:
            ranking = self.ranker.rank(current)
            rankings.append(ranking)
            if not ranking.chosen:
                ended = "nothing admitted"
                break
            current = next(r.candidate for r in ranking.ranked if r.key == ranking.chosen)
            current = self._improve(current, ranking.chosen)
            if gate.at_floor(current):
                ended = "at the floor"
                break
        final = self._simplify(self._prune(current))
        exact = gate.leaves_noise(final)
        return self._found(final, rankings, ended, self.rivals.descriptions(final, exact))

    def of(self, final: Candidate, sets: Sequence[Sequence[str]]) -> Found:
        """What there is to know of a final model that is given."""
        ranking = self.ranker.rank(self.baseline)
        ladder = self._ladder(final)
        chosen = ladder[0][0] if ladder else ""
        # Descriptions were weighed with the effects.
        found = self._found(final, [replace(ranking, chosen=chosen)], "by probability", ())
        missing = []
        for one in found.missing:
            could_be = next(tuple(names) for names in sets if one.key in names)
            missing.append(replace(one, could_be=could_be, near=()))
        return replace(found, missing=tuple(missing))

    def _found(
        self,
        final: Candidate,
        rankings: Sequence[Ranking],
        ended: str,
        descriptions: tuple[Ranked, ...],
    ) -> Found:
        exact = self.ranker.gate.leaves_noise(final)
        return Found(
            self.baseline,
            tuple(rankings),
            final,
            self._missing(final, rankings, exact),
            removed_share(self.ranker.bench.split, self.baseline, final),
            descriptions,
            exact,
            len(self.ranker.fitter.known),
            ended,
        )

    def _improve(self, current: Candidate, newest: str) -> Candidate:
        """Swap earlier effects for others now that one more is known."""
        added = self.rivals.added(current)
        if len(added) < 2:
            return current
        for key in added:
            if key == newest:
                continue
            for other in self.rivals.in_place_of(key, current):
                if other.passes and not other.doubt:
                    current = other.candidate
                    break
        return current

    def _prune(self, current: Candidate) -> Candidate:
        """Drop what the final model does not need."""
        for key in self.rivals.added(current):
            if len(self.rivals.added(current)) < 2:
                break
            smaller = self.rivals.without(key, current)
            if smaller.failure:
                continue
            if total_evidence(current, smaller, current) < self.ranker.bench.rules.decisive:
                current = smaller
        return current

    def _simplify(self, current: Candidate) -> Candidate:
        """Take the plainer effect, or the first of those of one form, where it does as well."""
        library, fitter = self.ranker.library, self.ranker.fitter
        order = list(library)
        for key in [k for k in self.rivals.added(current) if k in library]:
            effect = library[key]
            for other in (*effect.refines, *effect.equivalent):
                if other not in order or other in current.keys:
                    continue
                if other in effect.equivalent and order.index(other) > order.index(key):
                    continue
                model = current.model.without(key) + library[other]()
                found = fitter.fit(model, current, refined=current.refined)
                plainer = len(found.free) < len(current.free) or other in effect.equivalent
                if found.failure or not plainer:
                    continue
                if total_evidence(current, found, current) < self.ranker.bench.rules.decisive:
                    current = found
                    break
        return current

    def _missing(
        self, final: Candidate, rankings: Sequence[Ranking], exact: bool
    ) -> tuple[Missing, ...]:
        """One record for each effect of the final model, in the order of the error ladder."""
        library, gate, split = self.ranker.library, self.ranker.gate, self.ranker.bench.split
        out: list[Missing] = []
        before: float | None = 0.0
        for key, rung in self._ladder(final):
            without = self.rivals.without(key, final)
            rivals = self._in_place_of(key, final, rankings)
            near = tuple(
                r.key
                for r in rivals
                if not exact
                and not gate.does_as_well(r, final)
                and comes_near(final, without, r, split.rules.form)
            )
            removed = removed_share(split, self.baseline, rung)
            share = None if removed is None or before is None else removed - before
            equals = could_be(key, final, rivals, near, gate, library)
            effect = final.model.effect(key)
            out.append(Missing(effect, rung, without, rivals, equals, near, share))
            before = removed
        return tuple(out)

    def _ladder(self, final: Candidate) -> list[tuple[str, Candidate]]:
        """Effects one by one, at every rung the one that lowers the error most."""
        rungs: list[tuple[str, Candidate]] = []
        left, below = self.rivals.added(final), self.baseline
        while len(left) > 1:
            tried = [
                (
                    key,
                    self.ranker.fitter.fit(
                        below.model + final.model.effect(key), below, refined=final.refined
                    ),
                )
                for key in left
            ]
            key, below = min(tried, key=lambda pair: pooled_error(pair[1]))
            rungs.append((key, below))
            left.remove(key)
        return [*rungs, *((key, final) for key in left)]

    def _in_place_of(
        self, key: str, final: Candidate, rankings: Sequence[Ranking]
    ) -> tuple[Ranked, ...]:
        """What could stand in the place of an effect of the final model, best first."""
        if len(self.rivals.added(final)) == 1 and rankings and rankings[0].chosen == key:
            tried = [(r.key, r.candidate) for r in rankings[0].ranked if r.key != key]
            ranked = [self.ranker.gate.judge(k, c, final, final) for k, c in tried]
        else:
            ranked = self.rivals.in_place_of(key, final)
        ranked = [self.rivals.with_all_trials(r, final) for r in ranked]
        return tuple(sorted(ranked, key=lambda r: -r.evidence))
