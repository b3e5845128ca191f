"""Widths and fits of recorded trials as plain records, for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from identifiability.inference.consistency import consistency
from identifiability.inference.recordings import RecordingFit
from identifiability.inference.widths import Widths
from identifiability.provenance import stamp

SCHEMA = 1
FIT_SCHEMA = 2


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
    held, noisy = result.held_out, result.with_noise
    driven = result.prepared[0].trial.driven
    return {
        "schema": FIT_SCHEMA,
        **stamp(__name__),
        "model": repr(result.problem.model),
        "driven": driven,
        "trials": [
            {
                **p.record(),
                "noise_level": float(noisy.noises[which].levels[trial]),
            }
            for p, which, trial in zip(result.prepared, noisy.which, noisy.trial, strict=True)
        ],
        "noise": {
            "of": "angle [rad]" if driven == "torque" else "torque [Nm]",
            "carried": "torque [Nm]" if driven == "torque" else "angle [rad]",
            "estimates": [noise.to_dict() for noise in noisy.noises],
            "rounds": noisy.rounds,
            "settled": noisy.settled,
            "attenuation_corrected": noisy.corrected,
        },
        "consistency": asdict(consistency(result)),
        "least_squares": {n: result.least_squares[n] for n in result.least_squares.names},
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
