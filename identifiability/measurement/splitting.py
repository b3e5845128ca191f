"""Which trials, or which half of one record, models are fitted to, and on which they are judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.measurement.prepared import Prepared
from identifiability.measurement.trials import Trial

Rule = Literal["named", "by amplitude", "second half", "first half", "nothing"]

_BEYOND = 0.5  # of a half lies outside the angles that the other reaches
_MOVES = 0.05  # of the imposed signal's scatter, below which a half of it is at rest

_WORDS: dict[Rule, tuple[str, str]] = {
    "named": ("{fitted} of {all} trials", "{held} of {all} trials, those named"),
    "by amplitude": ("{fitted} of {all} trials", "{held} of {all} trials, chosen by amplitude"),
    "second half": ("the first half of the record", "the second half of the record"),
    "first half": (
        "the second half of the record",
        "the first half of the record: most of the second lies beyond its angles",
    ),
    "nothing": ("the record", "nothing: there is one trial, and it moves in one half only"),
}


@dataclass(frozen=True, eq=False)
class Parts:
    """Trials, or parts of one, that models are fitted to, and those they are judged on.

    Attributes
    ----------
    fitted, held_out : tuple of Prepared
        The second is empty where nothing could be held out.
    rule : {"named", "by amplitude", "second half", "first half", "nothing"}
        How they were chosen.
    numbers : tuple of int
        Of the held-out trials, among all; none where it is half of one.
    """

    fitted: tuple[Prepared, ...]
    held_out: tuple[Prepared, ...]
    rule: Rule
    numbers: tuple[int, ...] = ()

    @property
    def what_is_fitted(self) -> str:
        """In words, which part is fitted."""
        return self._worded(0)

    @property
    def what_is_held_out(self) -> str:
        """In words, which part is held out."""
        return self._worded(1)

    def _worded(self, which: int) -> str:
        fitted, held = len(self.fitted), len(self.held_out)
        return _WORDS[self.rule][which].format(fitted=fitted, held=held, all=fitted + held)


def hold_out(prepared: Sequence[Prepared], n_named: int = 0) -> Parts:
    """Choose what to hold out.

    Held out are whole conditions: of several trials about every third, such that each kind of
    perturbation stays in both parts where it can; of one long record the second half, or the
    first where most of the second lies beyond the angles that the first reaches: what no fitted
    sample came near would judge how well parameters are known, not whether the model is right. Of
    one record that is perturbed, or moves, in one half only nothing is held out.

    Parameters
    ----------
    prepared : sequence of Prepared
        At least one.
    n_named : int
        Number of trials, at the end, that the user named to be held out.
    """
    trials = tuple(prepared)
    rule: Rule = "by amplitude"
    if n_named:
        chosen, rule = set(range(len(trials) - n_named, len(trials))), "named"
    elif len(trials) == 1:
        return _one_half(trials[0])
    else:
        chosen = _by_amplitude([p.trial for p in trials])
    return Parts(
        tuple(p for i, p in enumerate(trials) if i not in chosen),
        tuple(p for i, p in enumerate(trials) if i in chosen),
        rule,
        tuple(sorted(chosen)),
    )


def halves(record: Prepared) -> tuple[Prepared, Prepared]:
    """Both halves of a record."""
    middle = (record.first + record.last) // 2
    return record.part(record.first, middle), record.part(middle, record.last)


def _one_half(record: Prepared) -> Parts:
    one, other = halves(record)
    least = _MOVES * np.std(record.drive.signals[record.first : record.last, 0])
    for half in (one, other):
        imposed = half.drive.signals[half.first : half.last, 0]
        if np.std(imposed) <= least or np.ptp(half.compared) == 0:
            return Parts((record,), (), "nothing")
    reached, asked = (p.trial.angle[p.first : p.last] for p in (one, other))
    beyond = np.mean((asked < reached.min()) | (asked > reached.max()))
    if beyond > _BEYOND:
        return Parts((other,), (one,), "first half")
    return Parts((one,), (other,), "second half")


def _by_amplitude(trials: Sequence[Trial]) -> set[int]:
    """About a third of the trials: those with middling and with the largest amplitudes.

    Ordered by the size of what was imposed, every third trial is held out, beginning with the
    largest: an extrapolation and interpolations.
    """
    imposed = [t.torque if t.driven == "torque" else t.angle for t in trials]
    order = np.argsort([-np.std(x) for x in imposed], kind="stable")
    if len(trials) == 2:
        return {int(order[0])}
    return {int(i) for i in order[:: 3 if len(trials) > 3 else 2][: len(trials) // 2]}
