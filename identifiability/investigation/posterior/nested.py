"""The choice made again without the held-out trials, whose errors are quoted.

All trials together choose best, but then errors on those that are held out are of trials that had
a part in the choice. So it is made again, among the sets that came near, without them.
"""

from __future__ import annotations

from collections.abc import Mapping

from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.posterior.kept import Evaluations
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.posterior.weighing import Job, Weighing
from identifiability.investigation.rules import Rules
from identifiability.joint.effects import Effect
from identifiability.progress import Progress

_NEAR, _MOST = 1e-3, 6  # probability from which sets are weighed again, and how many at most


def weigh_nested(
    kept: Evaluations,
    baseline: Candidate,
    library: Mapping[str, type[Effect]],
    chosen: Probabilities,
    rules: Rules,
    progress: Progress,
) -> Probabilities:
    """Weigh the sets that came near on a part of the trials.

    Parameters
    ----------
    kept : Evaluations
        What evaluates models of that part.
    baseline : Candidate
        The model that the search started from.
    library : mapping of str to type of Effect
        Effects that were tried.
    chosen : Probabilities
        By all trials.
    rules : Rules
    progress : callable
        Told ``(what, done, total)``.

    Raises
    ------
    InputError
        Where the model to start from cannot be evaluated.
    """
    weighing = Weighing(kept.evaluator, library, baseline.keys, rules, progress, kept)
    likely = [r.effects for r in chosen.rows if r.effects and r.probability >= _NEAR]
    jobs = []
    for keys in ((), *likely[:_MOST]):
        candidate = chosen.sets[keys].candidate
        jobs.append(Job(candidate.model, [candidate.values], candidate.refined))
    for i, _ in enumerate(weighing.weigh(jobs)):
        progress("weighing without the held-out trials", i + 1, len(jobs))
    weighing.require_base()
    weighing.settle()
    return weighing.together.posterior()
