"""What probabilities allow to name, in a sentence."""

from __future__ import annotations

from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.wording.verdict import listed, percent, plain

_UNNAMED = {
    "nothing": "Nothing is named: that nothing is missing has a probability of {}.",
    "unknown": "Nothing is named: that it is no effect of the library has a probability of {}.",
    "undecided": "Nothing is named: the most probable set has a probability of {} only.",
    "noise": "Nothing is named: to the most probable model {} of the response is noise.",
}


def claim_sentence(claim: Claim) -> str:
    """What is named, and how sure that is; or why nothing is."""
    if claim.sets:
        named = "; and ".join(listed([plain(key) for key in s], "or") for s in claim.sets)
        return f"Missing is {named}, with a probability of {percent(claim.probability)}."
    unnamed = _UNNAMED[claim.kind].format(percent(claim.probability))
    if claim.present:
        there = listed([plain(key) for key in claim.present])
        return f"{unnamed} Beside it, there is {there}."
    return unnamed
