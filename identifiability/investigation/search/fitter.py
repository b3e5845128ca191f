"""Fits of the search: each model once, from starts about one that was fitted before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from identifiability.inference.starts import refined_values, starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.joint.model import Model

Fits = dict[tuple[tuple[str, ...], tuple[str, ...]], Candidate]
"""By the model's effects, and those of them that are refined."""


@dataclass(eq=False)
class Fitter:
    """Fits models to one body of evidence, each once.

    Attributes
    ----------
    bench : Workbench
    first : Candidate or None
        The model that the search started from.
    known : mapping
        All fits.
    """

    bench: Workbench
    first: Candidate | None = None
    known: Fits = field(default_factory=dict)
    _to_all: Fits = field(default_factory=dict, init=False, repr=False)

    def fit(
        self,
        model: Model,
        near: Candidate,
        *,
        refined: Sequence[str] = (),
        thorough: bool = True,
    ) -> Candidate:
        """Fit a model from starts about a fitted one; each model is fitted once."""
        refined = tuple(sorted(key for key in refined if key in model.effect_keys))
        known = self.known.get((model.effect_keys, refined))
        if known is not None:
            found = self.bench.finish(known) if thorough else known
        else:
            starts = self.starts(model, near, refined)
            found = self.bench.fit(model, starts, refined=refined, thorough=thorough)
        self.known[model.effect_keys, refined] = found
        return found

    def starts(
        self, model: Model, near: Candidate, refined: tuple[str, ...]
    ) -> list[dict[str, float]]:
        """Values to start a model from, about a fitted one."""
        names = model.parameter_names
        shared = {name: value for name, value in near.values.items() if name in names}
        if len(shared) == len(names) and set(refined) != set(near.refined):
            return refined_values(model, near.values, near.free)
        if not near.keys:
            return starting_values(model, shared, most=6)
        starts = starting_values(model, shared, most=2)
        alone = self._alone([key for key in model.effect_keys if key not in near.keys])
        if alone:
            # A shape that served once is a better start than the nominal one.
            starts[:1] = starting_values(model, shared | alone, most=1)
        # With a second effect the first one may have to take another shape.
        plain = {n: shared[n] for n in ("K", "B", "I")}
        return starts + starting_values(model, plain, most=1)

    def _alone(self, keys: Sequence[str]) -> dict[str, float]:
        """Shapes that effects had when each was added to the baseline alone."""
        return {
            name: value
            for key in keys
            if (found := self.alone(key)) is not None
            for name, value in found.values.items()
            if name.startswith(f"{key}.") and found.model.parameters[name].null is None
        }

    def alone(self, key: str) -> Candidate | None:
        """Plain fit of one effect added to the first model, if there was one."""
        base = () if self.first is None else self.first.keys
        found = self.known.get((tuple(sorted((*base, key))), ()))
        return None if found is None or found.failure else found

    def richer(self, plain: Candidate, key: str) -> Candidate:
        """Fit with an effect refined, where it can be; the plain fit otherwise."""
        if plain.failure or not refinable(plain, key):
            return plain
        richer = self.refine(plain, (*plain.refined, key))
        return plain if richer.failure else richer

    def refine(self, plain: Candidate, keys: Sequence[str]) -> Candidate:
        """Fit with some effects refined."""
        self.fit(plain.model, plain, refined=keys, thorough=False)
        return self.fit(plain.model, plain, refined=keys)

    def fit_to_all(self, candidate: Candidate) -> Candidate:
        """Fit a candidate's model, from its values, to the held-out trials too."""
        key = candidate.model.effect_keys, candidate.refined
        if key not in self._to_all:
            self._to_all[key] = self._none_held_out.fit(
                candidate.model, [candidate.values], refined=candidate.refined
            )
        return self._to_all[key]

    @cached_property
    def _none_held_out(self) -> Workbench:
        """The bench with the held-out trials among those to be fitted."""
        split = self.bench.split
        everything = (*split.fitted, *split.held_out)
        return replace(self.bench, split=replace(split, fitted=everything, held_out=()))


def refinable(candidate: Candidate, key: str) -> bool:
    """Whether an effect of a candidate has refining parameters that are not free."""
    return key not in candidate.refined and candidate.model.effect(key).has_refinement
