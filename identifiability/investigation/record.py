"""An investigation as a plain record, for JSON and for the report."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from identifiability.files import plain
from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.ladder.found import Tried
from identifiability.investigation.models import fitted_models
from identifiability.investigation.next_experiment import NextExperiment
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.pinned import not_pinned_down
from identifiability.investigation.where.record import comparison_record, location_record
from identifiability.investigation.wording import verdict as wording
from identifiability.investigation.wording.next_experiment import next_experiment_sentence
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.measurement.prepared import Prepared
from identifiability.provenance import stamp

SCHEMA = 2


def investigation_record(findings: Findings, *, command: str = "") -> dict[str, Any]:
    """Plain record of an investigation.

    Parameters
    ----------
    findings : Findings
    command : str
        The command that made it.

    Returns
    -------
    dict
        ``schema``, ``baseline``, ``steps``, ``verdict``, ``posterior``, ``discrepancy`` and
        ``next_experiment``, then everything else that the report shows. E is Eq. 3's error pooled
        over trials. In the posterior ``effects`` of none is none of the known ones; ``present``
        is the probability of each effect, whatever else there is.
    """
    found, verdict, split = findings.found, findings.verdict, findings.split
    written: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "baseline": {
                "effects": list(found.baseline.keys),
                **_errors(found.baseline),
                "noise_floor": split.noise_floor(),
                "noise_floor_held_out": split.noise_floor(split.held_out)
                if split.held_out
                else None,
                "parameters": dict(found.baseline.values),
            },
            "steps": [
                {
                    "added": missing.name,
                    "claimed": verdict.names(missing.key),
                    "fitted_as": missing.key,
                    "equivalent": list(missing.could_be[1:]),
                    "share": missing.share,
                    **_errors(missing.rung),
                    "parameters": dict(missing.rung.values),
                    "without": _errors(missing.without),
                    "in_its_place": [_tried(r) for r in missing.rivals],
                }
                for missing in found.missing
            ],
            "models": [
                {
                    "role": one.role,
                    "effects": list(one.candidate.keys),
                    "added": one.added,
                    "in_the_place_of": one.replaced,
                    **_errors(one.candidate),
                    "parameters": dict(one.candidate.values),
                    "sd": dict(one.sds),
                }
                for one in fitted_models(findings)
            ],
            "verdict": {
                "kind": verdict.kind,
                "effects": list(verdict.effects),
                "equivalence_sets": [list(names) for names in verdict.sets],
                "sentence": wording.verdict_sentence(findings),
                "because": wording.because(findings),
                "reasons": [asdict(reason) for reason in verdict.reasons],
                "share_explained": verdict.share,
                "smallest_seen": [asdict(seen) for seen in verdict.smallest_seen],
            },
            **_posterior(findings.posterior),
            "next_experiment": _next_experiment(findings.next_experiment),
            "rankings": [
                {
                    "model": list(found.baseline.keys),
                    "chosen": found.missing[0].key if found.missing else "",
                    "candidates": [_tried(r) for r in found.alone],
                }
            ],
            "fits": found.n_weighed,
            "comparison": None
            if findings.comparison is None
            else comparison_record(findings.comparison),
            "location": None if findings.location is None else location_record(findings.location),
            "unexplained": {
                "baseline": _unexplained(findings.unexplained_before),
                "final": _unexplained(findings.unexplained_after),
            },
            "widths": None if findings.widths is None else findings.widths.to_dict(),
            "not_pinned_down": []
            if findings.widths is None
            else [asdict(p) for p in not_pinned_down(findings.widths, split.rules.loose)],
            "trials": [
                *(_trial(r, "fitted") for r in split.fitted),
                *(_trial(r, "held out") for r in split.held_out),
            ],
            "held_out": split.how_held_out,
            "driven": split.driven,
            "rules": asdict(split.rules),
            "timings": dict(findings.timings),
            "failures": dict(findings.failures),
            "warnings": list(findings.warnings),
            **stamp(__name__, "identifiability.investigation.investigate"),
            "seed": findings.seed,
            "data_sha256": data_hash((*split.fitted, *split.held_out)),
            "command": command,
        }
    )
    return written


def data_hash(trials: Sequence[Prepared]) -> str:
    """SHA-256 over the files' hashes, or the samples where a trial came from no file."""
    digest = hashlib.sha256()
    for ready in trials:
        if ready.trial.sha256:
            digest.update(ready.trial.sha256.encode())
        else:
            digest.update(np.ascontiguousarray(ready.trial.torque).tobytes())
            digest.update(np.ascontiguousarray(ready.trial.angle).tobytes())
    return digest.hexdigest()


def _next_experiment(following: NextExperiment | None) -> dict[str, Any] | None:
    if following is None:
        return None
    return {
        **following.to_dict(),
        "resolved": following.resolved,
        "sentence": next_experiment_sentence(following),
    }


def _posterior(posterior: Probabilities | None) -> dict[str, Any]:
    """All that the probabilities say; nothing where there are none."""
    if posterior is None:
        return dict.fromkeys(("posterior", "present", "weighed", "discrepancy"))
    compared, recorded = posterior.samples
    return {
        "posterior": [
            {
                "effects": None if row.effects is None else list(row.effects),
                "probability": row.probability,
                "log_evidence": row.log_evidence,
            }
            for row in posterior.rows
        ],
        "present": _present(posterior),
        # Of long records parts all over them.
        "weighed": {
            "samples": compared,
            "of": recorded,
            "begun_only": [
                {"effects": list(keys), "behind": behind}
                for keys, behind in posterior.screened.items()
            ],
        },
        "discrepancy": _discrepancy(posterior),
    }


def _present(posterior: Probabilities) -> dict[str, float]:
    """Probability that each effect is there, whatever else is."""
    sets = [row.effects or () for row in posterior.rows]
    named = dict.fromkeys(e for keys in (*sets, *posterior.beside_unknown) for e in keys)
    found = {effect: posterior.present(effect) for effect in named}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _discrepancy(posterior: Probabilities) -> dict[str, Any] | None:
    """What the most probable model leaves, as shares of the response's root mean square."""
    if posterior.discrepancy is None:
        return None
    found = posterior.discrepancy
    return {
        "beside": list(posterior.best),
        "nearest_form": posterior.description,
        "kind": found.kind,
        "size": found.size * posterior.response,
        "share": found.size,
        "shares": dict(found.sizes),
        "noise": posterior.noise,
    }


def _errors(candidate: Candidate) -> dict[str, float | str | None]:
    """Errors of a fit, and how its model was integrated, with the error E of that."""
    held = candidate.held_out
    return {
        "error_fit": candidate.fitted.error,
        "error_held_out": held.error if held.by_trial else None,
        "integration": str(candidate.scheme or ""),
        "solver_error": candidate.solver_error,
    }


def _tried(tried: Tried) -> dict[str, Any]:
    """An effect as it was weighed: log evidence in nats, error of all trials in their band."""
    if tried.failure:
        return {"effect": tried.key, "failure": tried.failure}
    return {
        "effect": tried.key,
        "evidence": tried.evidence,
        "probability": tried.probability,
        "error": tried.error,
        "model": list(tried.candidate.keys),
        "parameters": dict(tried.candidate.values),
        "refined": list(tried.candidate.refined),
    }


def _unexplained(rest: Unexplained | None) -> dict[str, Any] | None:
    if rest is None:
        return None
    return {
        "sentence": unexplained_sentence(rest),
        "best": rest.best.key,
        "kind": rest.best.kind,
        "margin": rest.margin,
        "decided": rest.decided,
        "share": rest.share,
        "noise_ratio": rest.noise_ratio,
        "latency_s": None if rest.delay_readout is None else rest.delay_readout.delay,
        "families": [
            {"key": f.key, "kind": f.kind, "log_evidence": f.log_evidence} for f in rest.families
        ],
    }


def _trial(prepared: Prepared, role: str) -> dict[str, Any]:
    noise_sd = prepared.lead.sd if prepared.lead.n_samples else None
    return {**prepared.record(), "role": role, "noise_sd": noise_sd}
