"""A model of a session: weighed with all trials, fitted to those that are not held out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.split import Split
from identifiability.investigation.wording.verdict import model_in_words
from identifiability.joint.model import Model


@dataclass(frozen=True, eq=False)
class Attempt:
    """A model that was weighed and fitted.

    Attributes
    ----------
    added : tuple of str
        Keys of the effects beside the model that the session starts from.
    candidate : Candidate
        Its least-squares fit: values, and what it leaves of the fitted and held-out trials.
    log_evidence : float
        Of its weighing by all trials, in nats.
    sds : mapping of str to float
        Standard deviations of its parameters, with the noise estimated beside them.
    split : Split
        The trials.
    """

    added: tuple[str, ...]
    candidate: Candidate
    log_evidence: float
    sds: Mapping[str, float]
    split: Split

    @property
    def model(self) -> Model:
        """Its model."""
        return self.candidate.model

    @property
    def values(self) -> Mapping[str, float]:
        """Its parameters, by least squares."""
        return self.candidate.values

    @property
    def name(self) -> str:
        """Such as "K, B, I + series tendon"."""
        return model_in_words(self.model.effect_keys)

    def __repr__(self) -> str:
        errors = f"E = {self.candidate.fitted.error:.3g}"
        if self.split.held_out:
            errors += f", {self.candidate.held_out.error:.3g} held out"
        return f"{self.name}: {errors}"

    def _repr_html_(self) -> str:
        from identifiability.workbench.show import page

        return page(self)


@dataclass(frozen=True, eq=False)
class Ranked:
    """What one effect more would bring.

    Attributes
    ----------
    key : str
        Of the effect.
    gained : float
        Log evidence [nats] above that of the model without it.
    attempt : Attempt or None
    failure : str
        Why there is no attempt.
    """

    key: str
    gained: float
    attempt: Attempt | None
    failure: str = ""

    def __repr__(self) -> str:
        if self.attempt is None:
            return f"+ {self.key.replace('_', ' ')}: no fit ({self.failure})"
        return f"+ {self.key.replace('_', ' ')}: {self.gained:+.1f} nats; {self.attempt!r}"


class Ranking(tuple[Ranked, ...]):
    """Effects by what each would bring, the most first."""

    def _repr_html_(self) -> str:
        from identifiability.workbench.show import page

        return page(self)
