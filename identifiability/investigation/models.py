"""Models side by side: what each makes of K, B and I, and what it leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.candidate import Candidate

Role = Literal["baseline", "step", "final", "instead", "nearest"]


@dataclass(frozen=True, eq=False)
class FittedModel:
    """One model that was fitted to the trials.

    Attributes
    ----------
    role : {"baseline", "step", "final", "instead", "nearest"}
        The model that was doubted; one effect more; all that is claimed; that with an effect in
        another's place which the data do not tell from it; what known effects make of it where
        something unknown is missing and none of them is claimed.
    added : str
        Effect by which it differs from the model above it; empty for the baseline, and where there
        are several.
    replaced : str
        Effect in whose place that is; empty where it comes besides.
    candidate : Candidate
    sds : mapping of str to float
        Standard deviations of its parameters, with the noise estimated beside them: of the sampled
        posterior where it was sampled, by curvature elsewhere. What is at a bound has none.
    """

    role: Role
    added: str
    replaced: str
    candidate: Candidate
    sds: Mapping[str, float]


def fitted_models(findings: Findings) -> tuple[FittedModel, ...]:
    """The baseline, the model with each effect added, and those with others in their place.

    Where something unknown is missing, and nothing is added, what comes nearest.

    Parameters
    ----------
    findings : Findings
    """
    found = findings.found
    baseline = FittedModel("baseline", "", "", found.baseline, _sds(findings, found.baseline))
    steps = [
        FittedModel(
            "final" if missing.rung is found.final else "step",
            missing.key,
            "",
            missing.rung,
            _sds(findings, missing.rung),
        )
        for missing in found.missing
    ]
    instead = [
        FittedModel(
            "instead",
            next(key for key in one.keys if key not in found.final.keys),
            missing.key,
            one,
            _sds(findings, one),
        )
        for missing in found.missing
        for one in missing.instead
    ]
    models = (baseline, *steps, *instead)
    if found.nearest is None:
        return models
    return (*models, FittedModel("nearest", "", "", found.nearest, _sds(findings, found.nearest)))


def _sds(findings: Findings, candidate: Candidate) -> dict[str, float]:
    posterior, base = findings.posterior, findings.found.baseline.keys
    keys = tuple(sorted(set(candidate.keys) - set(base)))
    known: dict[str, float] = {}
    if posterior is not None and keys in posterior.sets:
        known |= posterior.sets[keys].sds
    if candidate is findings.found.final and findings.widths is not None:
        known |= {
            row.name: row.posterior_sd
            for row in findings.widths.rows
            if row.verdict != "not converged"
        }
    return {name: sd for name, sd in known.items() if name in candidate.free and sd > 0}
