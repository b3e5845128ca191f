"""The demo as text, record and picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill, indent
from typing import Any

from identifiability.files import plain, write_json
from identifiability.inference.consistency import consistency
from identifiability.inference.recordings import RecordingFit
from identifiability.inference.widths import Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.models import fitted_models
from identifiability.investigation.wording.verdict import verdict_sentence
from identifiability.measurement.example import B_CE, INERTIA, K_CE, K_SE
from identifiability.plots.demo import demo_figure
from identifiability.plots.style import save
from identifiability.provenance import stamp
from identifiability.report.fit import answer
from identifiability.report.models import models_text

TRUTH = {"K": K_CE, "B": B_CE, "I": INERTIA, "series_tendon.stiffness": K_SE}
"""Parameters of the joint that the shipped trials are of."""


def write_demo(recording: RecordingFit, findings: Findings, out: Path) -> list[str]:
    """Write record and picture into a folder; returns the files' names."""
    figure = demo_figure(recording, findings, K_CE)
    for name in ("summary.svg", "summary.png"):
        save(figure, out / name)
    write_json(out / "summary.json", demo_record(recording, findings))
    return ["summary.svg", "summary.png", "summary.json"]


def demo_record(recording: RecordingFit, findings: Findings) -> dict[str, Any]:
    """What the picture shows, as plain data."""
    held = recording.held_out
    found: dict[str, Any] = plain(
        {
            **stamp(
                "identifiability.inference.recordings", "identifiability.investigation.investigate"
            ),
            "truth": TRUTH,
            "vaf": recording.goodness.vaf,
            "vaf_held_out": None if held is None else held.goodness_held_out.vaf,
            "K_least_squares": recording.least_squares["K"],
            "K_by_window": [
                {"T": w.window, "K": w.widths["K"].optimum, "sd": w.widths["K"].posterior_sd}
                for w in recording.windows
            ],
            "models": [
                {
                    "effects": list(one.candidate.keys),
                    "error_fit": one.candidate.fitted.error,
                    "error_held_out": one.candidate.held_out.error,
                    "parameters": {n: one.candidate.values[n] for n in one.candidate.free},
                    "sd": dict(one.sds),
                }
                for one in fitted_models(findings)
            ],
            "noise_floor": findings.split.noise_floor(findings.split.held_out),
        }
    )
    return found


def demo_text(
    study: Sequence[tuple[float, Widths]], recording: RecordingFit, findings: Findings
) -> str:
    """What was found, in less than a screen.

    Parameters
    ----------
    study : sequence of (float, Widths)
        Windows T [s] of the paper's setting, and what was learnt about K, B and I in each.
    recording : RecordingFit
    findings : Findings
    """
    windows = ", ".join(f"{1000 * T:g}" for T, _ in study)
    *joint, tendon = TRUTH.items()
    truth = ", ".join(f"{name} {value:g}" for name, value in joint)

    def by_window(field: str) -> str:
        return ", ".join(f"{getattr(w['K'], field):.0f}" for _, w in study)

    return f"""1. The paper's joint: muscle of {K_CE:g} Nm/rad, tendon of {K_SE:g} Nm/rad, no noise
   K, B and I fitted to windows of {windows} ms give K = {by_window("optimum")} Nm/rad.
   A measurement error of E = 0.001 leaves K uncertain by {by_window("quadratic")} Nm/rad by the
   paper's quadratic estimate, by {by_window("posterior_sd")} where the posterior is sampled
   within physical bounds.

2. Two simulated trials of that joint, with noise: K, B and I explain {recording.goodness.vaf:.2f} %
{_indented(answer(consistency(recording)))}

3. What K, B and I miss
{_indented(verdict_sentence(findings))}

{indent(chr(10).join(models_text(findings)), "   ")}

   The joint's own: {truth}, and {tendon[1]:g} Nm/rad of the tendon."""


def _indented(text: str) -> str:
    return fill(text, 92, initial_indent="   ", subsequent_indent="   ")
