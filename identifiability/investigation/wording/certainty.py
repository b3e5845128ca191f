"""How sure a verdict is, in words and numbers."""

from __future__ import annotations

from identifiability.investigation.findings import Findings
from identifiability.investigation.wording.verdict import likely_set, percent

# Words for probabilities, as the IPCC's guidance on uncertainty has them (Mastrandrea et al. 2010).
# Its strongest, "virtually certain" and "extremely likely", are more than blind cases bear out, in
# which nine of ten names were right.
_WORDS = (
    (0.90, "very likely"),
    (0.66, "likely"),
    (0.33, "about as likely as not"),
    (0.10, "unlikely"),
    (0.0, "very unlikely"),
)


def in_words(probability: float) -> str:
    """A probability in words and as a number."""
    words = next(words for least, words in _WORDS if probability >= least)
    return f"{words} ({percent(probability)})"


def certainty_sentence(findings: Findings) -> str:
    """How probable the verdict is, and what else may be; empty where nothing was weighed."""
    posterior, verdict = findings.posterior, findings.verdict
    if posterior is None:
        return ""
    nothing, unknown = posterior.nothing, posterior.none_of_these
    if verdict.kind == "nothing_missing":
        others = [row for row in posterior.rows if row.effects][:1]
        also = [
            f"{likely_set('+'.join(r.effects or ()))}: {percent(r.probability)}" for r in others
        ]
        also.append(f"something unknown: {percent(unknown)}")
        return f"That nothing is missing is {in_words(nothing)}; {'; '.join(also)}."
    if verdict.sets:
        claimed = posterior.claim(verdict.sets)
        return (
            f"This is {in_words(claimed)}; that nothing is missing: {percent(nothing)}; that it is "
            f"something unknown: {percent(unknown)}."
        )
    return (
        f"That something is missing is {in_words(1 - nothing)}; that it is no effect known here "
        f"has a probability of {percent(unknown)}."
    )
