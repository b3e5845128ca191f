"""How much the data speak for one fitted model against another.

Evidence for a larger model is the logarithm of the ratio of the weighted residuals, times the
number of samples that count as independent, less a penalty for its parameters: the Bayesian
information criterion of Schwarz 1978 (Ann Stat 6: 461-464) with an unknown scale of the noise.
Trials that were held out add twice their gain in log likelihood, with no penalty: an effect may
show only in the condition that was not fitted. The residual of a model that is not exact is
correlated, so it counts for few samples; at the noise floor nearly all count.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import difference, effective_samples
from identifiability.investigation.split import Split


def evidence_for(larger: Candidate, smaller: Candidate, best: Candidate) -> float:
    """Decrease of the information criterion from one model to another.

    Parameters
    ----------
    larger, smaller : Candidate
    best : Candidate
        Whose residual is taken for the noise.
    """
    if not np.isfinite(larger.fitted.weighted):
        return -np.inf
    samples = effective_samples(best.fitted, difference(smaller.fitted, larger.fitted))
    extra = len(larger.free) - len(smaller.free)
    ratio = smaller.fitted.weighted / larger.fitted.weighted
    return float(samples * np.log(ratio) - extra * np.log(samples))


def predictive_evidence(larger: Candidate, smaller: Candidate) -> float:
    """Twice the gain in log likelihood of the held-out trials from one model to another.

    Parameters
    ----------
    larger, smaller : Candidate
        Neither was fitted to these trials.
    """
    if not larger.held_out.by_trial or not smaller.held_out.by_trial:
        return 0.0
    best = min(larger.held_out, smaller.held_out, key=lambda part: part.weighted)
    samples = effective_samples(best, difference(smaller.held_out, larger.held_out))
    return float(samples * np.log(smaller.held_out.weighted / larger.held_out.weighted))


def total_evidence(larger: Candidate, smaller: Candidate, best: Candidate) -> float:
    """Evidence of the fitted trials, and of the held-out ones."""
    return evidence_for(larger, smaller, best) + predictive_evidence(larger, smaller)


def unpenalised(rival: Candidate, final: Candidate) -> float:
    """What a rival's larger number of parameters cost it: parsimony may rank, but not exclude."""
    extra = len(rival.free) - len(final.free)
    samples = effective_samples(final.fitted, difference(final.fitted, rival.fitted))
    return float(max(0, extra) * np.log(samples))


def held_out_gain(candidate: Candidate, current: Candidate) -> float:
    """Logarithm of the ratio of the weighted held-out residuals, positive if smaller."""
    if not current.held_out.by_trial or not candidate.held_out.by_trial:
        return 0.0
    if not np.isfinite(candidate.held_out.weighted):
        return -np.inf
    return float(np.log(current.held_out.weighted / candidate.held_out.weighted))


def pooled_error(candidate: Candidate) -> float:
    """E pooled over all trials, fitted and held out."""
    parts = [candidate.fitted.errors]
    if candidate.held_out.by_trial:
        parts.append(candidate.held_out.errors)
    return float(np.mean(np.concatenate(parts)))


def removed_share(split: Split, before: Candidate, after: Candidate) -> float | None:
    """Share of the misfit beyond the noise that is gone from one model to another.

    On the held-out trials where there are any; ``None`` where there was no misfit.
    """
    held = bool(split.held_out)
    first, last = ((c.held_out if held else c.fitted).error for c in (before, after))
    floor = split.noise_floor(split.held_out if held else split.fitted) or 0.0
    if first <= floor:
        return None
    return float((first - max(last, floor)) / (first - floor))


def least(candidates: Iterable[Candidate]) -> Candidate:
    """The candidate that leaves least."""
    return min(
        (c for c in candidates if not c.failure), key=lambda candidate: candidate.fitted.weighted
    )
