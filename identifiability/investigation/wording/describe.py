"""Any result of an investigation, in sentences."""

from __future__ import annotations

from functools import singledispatch

from identifiability.errors import InputError
from identifiability.investigation.across.agreement import Across
from identifiability.investigation.findings import Findings
from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location
from identifiability.investigation.wording.across import across_sentences
from identifiability.investigation.wording.claim import claim_sentence
from identifiability.investigation.wording.comparison import comparison_sentences
from identifiability.investigation.wording.next_experiment import next_experiment_sentence
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.investigation.wording.verdict import (
    because,
    probability_sentences,
    verdict_sentence,
)


@singledispatch
def describe(result: object) -> tuple[str, ...]:
    """Say in sentences what was found.

    Parameters
    ----------
    result : object
        Comparison, Location, Unexplained, Probabilities, Claim, NextExperiment, Across or Findings.

    Returns
    -------
    tuple of str
        One sentence an aspect of a comparison or a view of a location; one on what is left, on
        what can be named or on the next experiment; one a set of effects; of findings the verdict
        and then its reasons.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> from identifiability import Claim, describe
    >>> describe(Claim("effects", ("series_tendon",), (("series_tendon",),), 0.97))
    ('Missing is series tendon, with a probability of 97 %.',)
    """
    raise InputError(
        f"found {type(result).__name__}, expected what an investigation found: Findings, or a "
        "Comparison, Location, Unexplained, Probabilities, Claim or NextExperiment, such as "
        "study.compare(candidate)"
    )


@describe.register
def _(result: Comparison) -> tuple[str, ...]:
    return comparison_sentences(result)


@describe.register
def _(result: Probabilities) -> tuple[str, ...]:
    return probability_sentences(result)


@describe.register
def _(result: Claim) -> tuple[str, ...]:
    return (claim_sentence(result),)


@describe.register
def _(result: Location) -> tuple[str, ...]:
    return result.sentences


@describe.register
def _(result: Unexplained) -> tuple[str, ...]:
    return (unexplained_sentence(result),)


@describe.register
def _(result: NextExperiment) -> tuple[str, ...]:
    return (next_experiment_sentence(result),)


@describe.register
def _(result: Across) -> tuple[str, ...]:
    return across_sentences(result)


@describe.register
def _(result: Findings) -> tuple[str, ...]:
    return (verdict_sentence(result), *because(result))
