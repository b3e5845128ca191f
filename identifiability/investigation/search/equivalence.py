"""Which effects could stand in each other's place: alike by form, or alike on these data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identifiability.investigation.search.gate import FORM, Ranked, does_as_well, pooled_error
from identifiability.investigation.search.search import Search
from identifiability.joint.effects.base import Effect


def equivalence_set(key: str, search: Search, library: Mapping[str, type[Effect]]) -> list[str]:
    """Effects that explain the data as well as one of the final model's, that one included.

    A rival belongs to the set unless the data speak decisively against it: its fit is worse by the
    decisive difference, a larger model's penalty not counted against it (parsimony may rank, but
    not exclude), or its prediction of the held-out trials is, and it stays worse once it is fitted
    to these too. Where the final model leaves more than noise its equations are not exact, and a
    rival is not excluded either that comes as near as inexact equations may (`FORM`). Effects of
    the same form belong to it always; a refinement of the effect (a tendon that also stiffens) is
    no rival, nor is one with values that no joint has or that more likely stand for another.

    Parameters
    ----------
    key : str
        Effect of the final model.
    search : Search
    library : mapping of str to type of Effect

    Returns
    -------
    list of str
        Best first.
    """
    members = []
    for r in search.alternatives[key]:
        if r.candidate.failure or r.caveat or key in library[r.key].refines:
            continue
        if comes_near(key, r, search) or does_as_well(r, search.final):
            members.append(r.key)
    alike = [k for k in library[key].equivalent if k in library and k not in members]
    found = list(dict.fromkeys([key, *alike, *members]))
    # A muscle has a tendon: of effects of one form the anatomical name comes first.
    order = list(library)
    first = min([key, *alike], key=order.index)
    return [first, *(k for k in found if k != first)]


def comes_near(key: str, rival: Ranked, search: Search) -> bool:
    """Whether a rival leaves so little more than an effect that inexact equations hide which it is.

    Where the final model leaves only noise its equations are as good as exact, and hide nothing.
    """
    mine, before = pooled_error(search.final), pooled_error(search.without[key])
    if search.exact or not np.isfinite(before):
        return False
    return pooled_error(rival.candidate) - mine < FORM * (before - mine)


def same_form(keys: Sequence[str], library: Mapping[str, type[Effect]]) -> bool:
    """Whether all effects of a set are of one mathematical form."""
    return all(k == keys[0] or k in library[keys[0]].equivalent for k in keys)
