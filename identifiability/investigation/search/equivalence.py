"""Which effects could stand in each other's place: alike by form, or alike on these data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.search.criterion import pooled_error
from identifiability.investigation.search.gate import Gate, Ranked
from identifiability.joint.effects import Effect

Library = Mapping[str, type[Effect]]


def could_be(
    key: str,
    final: Candidate,
    rivals: Sequence[Ranked],
    near: Sequence[str],
    gate: Gate,
    library: Library,
) -> tuple[str, ...]:
    """Effects that explain the data as well as one of the final model's, that one included.

    A rival belongs to the set unless the data speak decisively against it: its fit is worse by the
    decisive difference, a larger model's penalty not counted against it (parsimony may rank, but
    not exclude), or its prediction of the held-out trials is, and it stays worse once it is fitted
    to these too. Effects of the same form belong to it always; a refinement of the effect (a tendon
    that also stiffens) is no rival, nor is one with values that no joint has or that more likely
    stand for another.

    Parameters
    ----------
    key : str
        Effect of the final model.
    final : Candidate
    rivals : sequence of Ranked
        What was fitted in its place, best first.
    near : sequence of str
        Rivals that inexact equations do not tell from it: see `comes_near`.
    gate : Gate
    library : mapping of str to type of Effect

    Returns
    -------
    tuple of str
        Best first.
    """
    members = [
        r.key
        for r in rivals
        if not r.candidate.failure
        and not r.caveat
        and key not in library[r.key].refines
        and (r.key in near or gate.does_as_well(r, final))
    ]
    alike = [k for k in library[key].equivalent if k in library and k not in members]
    found = list(dict.fromkeys([key, *alike, *members]))
    # A muscle has a tendon: of effects of one form the anatomical name comes first.
    order = list(library)
    first = min([key, *alike], key=order.index)
    return (first, *(k for k in found if k != first))


def comes_near(final: Candidate, without: Candidate, rival: Ranked, form: float) -> bool:
    """Whether a rival leaves so little more than an effect that inexact equations hide which it is.

    For a final model that leaves more than noise: one that leaves only noise has equations as good
    as exact, and they hide nothing.

    Parameters
    ----------
    final, without : Candidate
        The final model with and without the effect.
    rival : Ranked
    form : float
        Share of a misfit that inexact equations may leave.
    """
    mine, before = pooled_error(final), pooled_error(without)
    if rival.candidate.failure or not np.isfinite(before):
        return False
    return pooled_error(rival.candidate) - mine < form * (before - mine)


def same_form(keys: Sequence[str], library: Library) -> bool:
    """Whether all effects of a set are of one mathematical form."""
    return all(k == keys[0] or k in library[keys[0]].equivalent for k in keys)
