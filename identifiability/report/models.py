"""Models side by side, as a table of a page and of a terminal: what K, B and I become."""

from __future__ import annotations

import numpy as np

from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.models import FittedModel, fitted_models
from identifiability.investigation.wording import verdict as words
from identifiability.joint.parameters import plus_minus, with_unit
from identifiability.plots.investigation import error_text
from identifiability.report.page import Page

_JOINT = ("K", "B", "I")


def models_table(page: Page, findings: Findings) -> None:
    """One row a model: what K, B and I become, and what is left."""
    models = fitted_models(findings)
    units = findings.found.baseline.model.parameters
    rows = [
        [
            _name(one),
            *(plus_minus(one.candidate.values[n], one.sds.get(n)) for n in _JOINT),
            _own(one),
            error_text(one.candidate.fitted.error),
            *_held_out(one.candidate),
        ]
        for one in models
    ]
    floor = findings.split.noise_floor()
    rows.append(["noise alone", "", "", "", "", f"{floor:.2g}" if floor else "unknown", "", ""])
    page.table(
        [
            "model",
            *(f"{n} [{units[n].unit}]" for n in _JOINT),
            "the effect's own",
            "E fitted",
            "E held out",
            "VAF held out [%]",
        ],
        rows,
        marked=["chosen" if one.role == "final" else "" for one in models],
        text_columns=(0, 4),
    )
    page.paragraph(
        "Values are those of the smallest error E on the fitted trials; ± is one standard "
        "deviation, with the noise estimated beside them. Of a model that leaves more than noise "
        "it is the least that can be defended."
    )


def models_text(findings: Findings) -> list[str]:
    """The same for a terminal."""
    models = fitted_models(findings)
    units = findings.found.baseline.model.parameters
    heads = [f"{n} [{units[n].unit}]" for n in _JOINT]
    lines = [f"{'model':<32}{''.join(f'{h:>20}' for h in heads)}{'E fitted':>11}{'E held out':>12}"]
    for one in models:
        values = [plus_minus(one.candidate.values[n], one.sds.get(n)) for n in _JOINT]
        held = one.candidate.held_out.error
        lines.append(
            f"{_name(one):<32}{''.join(f'{v:>20}' for v in values)}"
            f"{error_text(one.candidate.fitted.error):>11}"
            + (f"{error_text(held):>12}" if findings.split.held_out else f"{'-':>12}")
        )
        if own := _own(one):
            lines.append(f"    {own}")
    floor = findings.split.noise_floor()
    lines.append(f"{'noise alone':<92}" + (f"{floor:>11.2g}" if floor else f"{'unknown':>11}"))
    return lines


def _name(one: FittedModel) -> str:
    """What a row of the table of models is."""
    if one.role == "baseline":
        return ", ".join(["K, B, I", *map(words.plain, one.candidate.keys)])
    if one.role == "instead":
        return f"{words.plain(one.added)} in its place"
    return f"+ {words.plain(one.added)}"


def _own(one: FittedModel) -> str:
    """Parameters of the effect by which a model differs from the one above it."""
    if not one.added:
        return ""
    own, parameters, values = f"{one.added}.", one.candidate.model.parameters, one.candidate.values
    return ", ".join(
        f"{words.plain(name[len(own) :])} "
        + with_unit(plus_minus(values[name], one.sds.get(name)), parameters[name].unit)
        for name in one.candidate.free
        if name.startswith(own)
    )


def _held_out(candidate: Candidate) -> list[str]:
    error = candidate.held_out.error
    if not np.isfinite(error):
        return ["-", "-"]
    return [error_text(error), f"{100 * (1 - error):.2f}"]
