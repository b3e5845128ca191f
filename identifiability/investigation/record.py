"""An investigation as a plain record, for JSON and for the report."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from identifiability.files import plain
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.investigate import Findings
from identifiability.investigation.search.gate import Ranked
from identifiability.investigation.split import Ready
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.pinned import not_pinned_down
from identifiability.provenance import package_version

SCHEMA = 1


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
        ``schema``, ``baseline``, ``steps``, ``verdict`` and ``next_experiment``, then everything
        else that the report shows. E is Eq. 3's error pooled over trials.
    """
    search, verdict, split = findings.search, findings.verdict, findings.split
    sets = dict(zip(search.alternatives, verdict.equivalence_sets, strict=False))
    found = {
        "schema": SCHEMA,
        "baseline": {
            "effects": list(search.baseline.keys),
            **_errors(search.baseline),
            "noise_floor": split.noise_floor(),
            "noise_floor_held_out": split.noise_floor(split.held_out) if split.held_out else None,
            "parameters": dict(search.baseline.values),
        },
        "steps": [
            {
                "added": sets[key][0] if key in sets else key,
                "fitted_as": key,
                "equivalent": list(sets.get(key, ())[1:]),
                **_errors(candidate),
                "parameters": dict(candidate.values),
            }
            for key, candidate in search.ladder
        ],
        "verdict": {
            "kind": verdict.kind,
            "effects": list(verdict.effects),
            "equivalence_sets": [list(s) for s in verdict.equivalence_sets],
            "sentence": verdict.sentence,
            "because": list(verdict.because),
            "share_explained": verdict.share,
            "smallest_seen": [
                {
                    "effect": d.key,
                    "parameter": d.parameter,
                    "size": d.size,
                    "unit": d.unit,
                    "sentence": d.sentence,
                }
                for d in verdict.smallest_seen
            ],
        },
        "next_experiment": None
        if findings.next_experiment is None
        else findings.next_experiment.to_dict(),
        "rankings": [
            {
                "model": list(step.before.keys),
                "chosen": step.chosen,
                "candidates": [_ranked(r) for r in step.ranking],
            }
            for step in search.steps
        ],
        "alternatives": {
            key: [_ranked(r) for r in ranked] for key, ranked in search.alternatives.items()
        },
        "descriptions": [_ranked(r) for r in search.descriptions],
        "fits": search.n_fits,
        "ended": search.ended,
        "unexplained": {
            "baseline": _unexplained(findings.unexplained_before),
            "final": _unexplained(findings.unexplained_after),
        },
        "widths": None if findings.widths is None else findings.widths.to_dict(),
        "not_pinned_down": []
        if findings.widths is None
        else list(not_pinned_down(findings.widths)),
        "trials": [
            *(_trial(r, "fitted") for r in split.fitted),
            *(_trial(r, "held out") for r in split.held_out),
        ],
        "held_out": split.how_held_out,
        "driven": split.driven,
        "warnings": list(findings.warnings),
        "package": package_version(),
        "seed": findings.seed,
        "data_sha256": data_hash((*split.fitted, *split.held_out)),
        "command": command,
    }
    written: dict[str, Any] = plain(found)
    return written


def data_hash(trials: Sequence[Ready]) -> str:
    """SHA-256 over the files' hashes, or the samples where a trial came from no file."""
    digest = hashlib.sha256()
    for ready in trials:
        if ready.trial.sha256:
            digest.update(ready.trial.sha256.encode())
        else:
            digest.update(np.ascontiguousarray(ready.trial.torque).tobytes())
            digest.update(np.ascontiguousarray(ready.trial.angle).tobytes())
    return digest.hexdigest()


def _errors(candidate: Candidate) -> dict[str, float | str | None]:
    """Errors of a fit, and how its model was integrated, with the error E of that."""
    held = candidate.held_out
    return {
        "error_fit": candidate.fitted.error,
        "error_held_out": held.error if held.by_trial else None,
        "integration": str(candidate.scheme or ""),
        "solver_error": candidate.solver_error,
    }


def _ranked(ranked: Ranked) -> dict[str, Any]:
    candidate = ranked.candidate
    if candidate.failure:
        return {"effect": ranked.key, "failure": candidate.failure}
    return {
        "effect": ranked.key,
        "evidence": ranked.evidence,
        "held_out_gain": ranked.held_out_gain,
        "admitted": ranked.passes,
        "reason": ranked.reason,
        "objection": ranked.objection,
        "doubt": ranked.doubt,
        "evidence_of_all_trials": ranked.refitted,
        **_errors(candidate),
        "parameters": {n: v for n, v in candidate.values.items() if n.startswith(f"{ranked.key}.")},
        "at_bound": list(candidate.at_bound),
        "refined": list(candidate.refined),
        "fitted_to_the_end": candidate.thorough,
        "starts_agreeing": candidate.n_agreeing,
        "starts": candidate.n_starts,
    }


def _unexplained(rest: Unexplained | None) -> dict[str, Any] | None:
    if rest is None:
        return None
    return {
        "sentence": rest.sentence,
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


def _trial(ready: Ready, role: str) -> dict[str, Any]:
    trial = ready.trial
    return {
        "name": trial.name,
        "role": role,
        "source": trial.source,
        "sha256": trial.sha256,
        "samples": ready.last - ready.first,
        "sampling_rate": trial.sampling_rate,
        "noise_sd": ready.lead.sd if ready.lead.n_samples else None,
        "notes": list(trial.notes),
    }
