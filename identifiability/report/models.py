"""Models side by side, as a table of a page and of a terminal: what K, B and I become."""

from __future__ import annotations

from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.candidate import Residual
from identifiability.investigation.models import FittedModel, fitted_models
from identifiability.investigation.wording.numbers import error_text, vaf_text
from identifiability.investigation.wording.values import (
    name_in_words,
    own_values_in_words,
    value_in_words,
)
from identifiability.numerals import number
from identifiability.report.page import Page

_JOINT = ("K", "B", "I")


def models_table(page: Page, findings: Findings) -> None:
    """One row a model: what K, B and I become, and what is left."""
    models, split = fitted_models(findings), findings.split
    units = findings.found.baseline.model.parameters
    parts = [("fitted", split.fitted)] + ([("held out", split.held_out)] if split.held_out else [])
    rows = [
        [
            _name(one, findings),
            *(value_in_words(one, name, unit=False) for name in _JOINT),
            own_values_in_words(one),
            *(_error(getattr(one.candidate, name.replace(" ", "_"))) for name, _ in parts),
            *(_vaf(getattr(one.candidate, name.replace(" ", "_"))) for name, _ in parts),
        ]
        for one in models
    ]
    floors = [split.noise_floor(trials) for _, trials in parts]
    if all(floors):
        errors = [number(floor or 0.0, 2) for floor in floors]
        rows.append(
            ["noise alone", *[""] * 4, *errors, *(vaf_text(floor or 0.0) for floor in floors)]
        )
    page.table(
        [
            "model",
            *(f"{n} [{units[n].unit}]" for n in _JOINT),
            "of its own",
            *(f"E {name}" for name, _ in parts),
            *(f"VAF {name} [%]" for name, _ in parts),
        ],
        rows,
        marked=[
            "chosen" if one.role == "final" and findings.verdict.sets else "" for one in models
        ],
        text_columns=(0, 4),
    )
    page.paragraph(
        "E is the share of the response's energy that a model leaves, VAF = 1 - E; held-out trials "
        "were not fitted. ± is one standard deviation, with the noise estimated beside the "
        "parameters. Of a model that leaves more than noise it is the least that can be defended."
    )


def models_text(findings: Findings) -> list[str]:
    """The same for a terminal."""
    models = fitted_models(findings)
    units = findings.found.baseline.model.parameters
    heads = [f"{n} [{units[n].unit}]" for n in _JOINT]
    lines = [f"{'model':<38}{''.join(f'{h:>20}' for h in heads)}{'E fitted':>12}{'E held out':>12}"]
    for one in models:
        values = [value_in_words(one, name, unit=False) for name in _JOINT]
        lines.append(
            f"{_name(one, findings):<38}{''.join(f'{v:>20}' for v in values)}"
            f"{_error(one.candidate.fitted):>12}{_error(one.candidate.held_out):>12}"
        )
        if own := own_values_in_words(one):
            lines.append(f"    {own}")
    floor = findings.split.noise_floor()
    lines.append(f"{'noise alone':<98}" + f"{number(floor, 2) if floor else 'unknown':>12}")
    return lines


def _name(one: FittedModel, findings: Findings) -> str:
    """What a model is; what is not claimed is a clue."""
    clue = one.role in ("step", "final") and not findings.verdict.names(one.added)
    return name_in_words(one) + (" (a clue)" if clue else "")


def _error(left: Residual) -> str:
    return error_text(left.error) if left.by_trial else "-"


def _vaf(left: Residual) -> str:
    return vaf_text(left.error) if left.by_trial else ""
