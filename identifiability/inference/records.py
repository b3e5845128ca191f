"""Widths and fits of recorded trials as plain records, for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from identifiability.inference.recordings import RecordingFit
from identifiability.inference.widths import Widths
from identifiability.provenance import stamp

SCHEMA = 1


def widths_record(result: Widths, conditions: Mapping[str, Any]) -> dict[str, Any]:
    """Plain record of the widths of one setting.

    Parameters
    ----------
    result : Widths
    conditions : mapping
        Setting and measurement, plain values.
    """
    return {"schema": SCHEMA, **stamp(__name__), **conditions, **result.to_dict()}


def fit_record(result: RecordingFit) -> dict[str, Any]:
    """Plain record of a fit, for JSON."""
    held = result.held_out
    return {
        "schema": SCHEMA,
        **stamp(__name__),
        "model": repr(result.problem.model),
        "driven": result.prepared[0].trial.driven,
        "trials": [
            {
                **p.record(),
                "noise_sd": noise.sd * fraction**0.5,
                "independent_fraction": fraction,
            }
            for p, noise, fraction in zip(
                result.prepared, result.noises, result.independent_fractions, strict=True
            )
        ],
        "E": result.goodness.error,
        "vaf": result.goodness.vaf,
        **result.widths.to_dict(),
        "windows": [
            {
                "T": w.window,
                "n_windows": w.n_windows,
                "E": w.goodness.error,
                "vaf": w.goodness.vaf,
                "verdict": w.widths.verdict,
                "parameters": w.widths.to_dict()["parameters"],
            }
            for w in result.windows
        ],
        "held_out": None
        if held is None
        else {
            "fitted": held.fitted,
            "held_out": held.held_out,
            "rule": held.rule,
            "parameters": {n: held.fit[n] for n in held.fit.names},
            "E_fitted": held.goodness_fitted.error,
            "vaf_fitted": held.goodness_fitted.vaf,
            "E_held_out": held.goodness_held_out.error,
            "vaf_held_out": held.goodness_held_out.vaf,
        },
        "warnings": list(result.warnings),
    }
