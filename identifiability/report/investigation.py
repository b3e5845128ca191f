"""The report of an investigation: one HTML file that needs no network, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.files import write_text
from identifiability.investigation.investigate import Findings
from identifiability.investigation.search.gate import DECISIVE, Ranked
from identifiability.investigation.search.search import Ranking
from identifiability.investigation.verdict.pinned import interval, not_pinned_down
from identifiability.investigation.wording.describe import describe
from identifiability.joint.parameters import with_unit
from identifiability.plots.investigation import (
    error_text,
    ladder_figure,
    ranking_figure,
    widths_figure,
)
from identifiability.plots.investigation_unexplained import unexplained_figure
from identifiability.plots.investigation_where import (
    comparison_figure,
    responses_figure,
    where_figure,
)
from identifiability.plots.style import png, save
from identifiability.report.page import Page

_KINDS = {
    "explained": "Explained",
    "one_of": "One of several effects",
    "unknown_static": "An unknown effect of the present state",
    "unknown_memory": "An unknown effect with memory",
    "measurement": "The measurement",
    "unrepeatable": "Not repeatable",
    "nothing_missing": "Nothing missing",
}


def write_report(findings: Findings, record: dict[str, Any], out: Path) -> list[str]:
    """Write ``report.html`` and the figures in it.

    Parameters
    ----------
    findings : Findings
    record : dict
        From `identifiability.investigation.record.investigation_record`.
    out : Path
        An existing folder.

    Returns
    -------
    list of str
        Names of the figure files.
    """
    search, verdict = findings.search, findings.verdict
    page = Page("What does the joint model miss?")
    written: list[str] = []

    def show(name: str, draw: Callable[[], Any], caption: str) -> None:
        # A figure that cannot be drawn must not take the report with it.
        try:
            figure = draw()
        except (ValueError, ArithmeticError, IndexError, KeyError) as error:
            page.paragraph(f"(This figure could not be drawn: {error}.)")
            return
        save(figure, out / f"{name}.png")
        written.append(f"{name}.png")
        page.figure(png(figure), caption, alt=caption)

    split = findings.split
    page.paragraph(
        f"{len(split.fitted)} trial(s) fitted, {len(split.held_out)} held out "
        f"({split.how_held_out}); {split.driven} imposed; {search.n_fits} models fitted."
    )
    page.box([_KINDS[verdict.kind] + ".", verdict.sentence])
    page.items(list(verdict.because))

    page.heading("Data and model")
    after = search.final if search.final is not search.baseline else None
    show(
        "overlay",
        lambda: responses_figure(split, search.baseline, after),
        "Measured and predicted responses, and under each what is left.",
    )
    if findings.comparison is not None:
        comparison = findings.comparison
        page.paragraph(
            "If the model is right, K, B and I are the same for every window, amplitude, direction "
            "and kind of trial."
        )
        page.items(list(describe(comparison)))
        show(
            "comparison",
            lambda: comparison_figure(comparison),
            "K, B and I of the baseline model, fitted to parts of the trials.",
        )
    if findings.location is not None:
        location = findings.location
        page.heading("Where the baseline fails")
        page.items(list(describe(location)))
        show("where", lambda: where_figure(location), "Where the residual exceeds the noise.")

    page.heading("Which effect is missing")
    sets = dict(zip(search.alternatives, verdict.equivalence_sets, strict=False))
    for number, step in enumerate(search.steps, 1):
        show(
            f"ranking_{number}",
            lambda step=step: ranking_figure(step, sets.get(step.chosen, ())),  # type: ignore[misc]
            f"Ranking {number}: every effect added to the model and fitted anew. Split above "
            f"{DECISIVE:.0f} is decisive; an effect is admitted if the held-out trials agree.",
        )
        _ranking_table(page, step)
        if step.screened_out:
            names = ", ".join(key.replace("_", " ") for key in step.screened_out)
            page.paragraph(f"Not fitted at this step, their signature not being there: {names}.")
    page.paragraph(f"The search ended because {search.ended}.")
    if search.alternatives and len(search.ladder) > 1:
        page.paragraph("In the place of each effect of the final model, the best others:")
        rows = [
            [
                key.replace("_", " "),
                r.key.replace("_", " "),
                f"{r.evidence:.1f}",
                error_text(r.candidate.held_out.error),
            ]
            for key, ranked in search.alternatives.items()
            for r in ranked[:4]
            if not r.candidate.failure
        ]
        page.table(
            ["in the place of", "effect", "evidence against the final model", "E held out"],
            rows,
            text_columns=(0, 1),
        )

    for r in search.descriptions:
        if r.candidate.failure:
            continue
        replaced = [key.replace("_", " ") for key in search.replaced_by(r)]
        page.paragraph(
            f"Held against {' and '.join(replaced)}: {r.key.replace('_', ' ')}, which names no "
            f"one mechanism, {'and displaces' if r.passes else 'but does not displace'} "
            f"{'it' if len(replaced) == 1 else 'them'}. Split against the final model "
            f"{r.evidence:.1f}, E held out {error_text(r.candidate.held_out.error)}."
        )

    page.heading("Error ladder")
    show(
        "ladder",
        lambda: ladder_figure(findings),
        "Error of the model with every effect added, on trials that were fitted and on those that "
        "were not.",
    )
    floor = record["baseline"]["noise_floor"]
    rungs = [("K, B, I", record["baseline"])]
    rungs += [("+ " + step["added"].replace("_", " "), step) for step in record["steps"]]
    rows = [_rung(name, rung["error_fit"], rung["error_held_out"]) for name, rung in rungs]
    rows.append(_rung("noise floor", floor, record["baseline"]["noise_floor_held_out"]))
    page.table(["model", "E fitted", "E held out", "VAF fitted [%]", "VAF held out [%]"], rows)

    page.heading("Unexplained torque")
    before = findings.unexplained_before
    if before is not None:
        left = " ".join(describe(before))
        page.paragraph(f"Baseline. {left}")
        show(
            "unexplained_baseline",
            lambda: unexplained_figure(before),
            "What the baseline lacks, with nothing assumed but its family.",
        )
    if findings.unexplained_after is not before:
        left = " ".join(describe(findings.unexplained_after))
        page.paragraph(f"Final model. {left}")
        show(
            "unexplained_final",
            lambda: unexplained_figure(findings.unexplained_after),
            "What the final model still lacks.",
        )

    page.heading("Parameters and their widths")
    if findings.widths is None:
        page.paragraph("Widths were not computed.")
        _values_table(page, search.final.values, search.final.model.parameters)
    else:
        found = findings.widths
        loose = not_pinned_down(found)
        page.items(list(loose) or ["All parameters are known to better than half their value."])
        _widths_table(page, found)
        show("widths", lambda: widths_figure(found), "Widths over values of all parameters.")

    page.heading("Next experiment")
    following = findings.next_experiment
    if following is None:
        page.paragraph(
            "Nothing is open between effects that an experiment could separate."
            if verdict.kind in ("explained", "nothing_missing")
            else "No pair of named effects is left that an experiment could separate."
        )
    else:
        page.paragraph(following.sentence)
        page.table(
            ["perturbation", "expected evidence a trial"],
            [
                [d.perturbation, f"{d.expected_evidence:.3g}"]
                for d in (following.best, *following.others)
            ],
            text_columns=(0,),
        )

    page.heading("How this was computed")
    page.items(
        [
            f"identifiability {record['package']}, seed {record['seed']}",
            f"data SHA-256 {record['data_sha256']}",
            "E is the summed squared residual over the summed squared response of a trial (Eq. 3 "
            "of Kistemaker & Rozendaal 2011), averaged over trials; VAF is 1 - E.",
            "Split is the number of independent samples times the logarithm of the ratio of "
            "residuals, less the penalty of the Bayesian information criterion.",
        ]
    )
    if record["command"]:
        page.code(record["command"])
    page.table(
        ["trial", "role", "samples", "rate [Hz]", "noise sd", "what was done to it"],
        [
            [
                t["name"],
                t["role"],
                str(t["samples"]),
                f"{t['sampling_rate']:.0f}",
                _number(t["noise_sd"]),
                "; ".join(t["notes"]),
            ]
            for t in record["trials"]
        ],
        text_columns=(0, 1, 5),
    )
    if findings.warnings:
        page.heading("What could not be done")
        page.items(list(findings.warnings))
    write_text(out / "report.html", page.render())
    return written


def _ranking_table(page: Page, step: Ranking) -> None:
    rows, marked = [], []
    for r in step.ranking:
        marked.append("chosen" if r.key == step.chosen else "failed" if r.candidate.failure else "")
        rows.append(_ranking_row(r))
    page.table(
        ["effect", "kind", "evidence", "E fitted", "E held out", "parameters", "remarks"],
        rows,
        marked=marked,
        text_columns=(0, 1, 5, 6),
    )


def _ranking_row(r: Ranked) -> list[str]:
    if r.candidate.failure:
        return [
            r.key.replace("_", " "),
            r.effect.kind,
            "",
            "",
            "",
            "",
            f"no fit: {r.candidate.failure}",
        ]
    remarks = [r.reason] if r.reason else []
    if not r.candidate.thorough:
        remarks.append("fell behind after a glance")
    own = [n for n in r.candidate.at_bound if n.startswith(f"{r.key}.")]
    if own and r.evidence > 0:
        remarks.append(f"at a bound: {', '.join(n.split('.')[1].replace('_', ' ') for n in own)}")
    return [
        r.key.replace("_", " "),
        r.effect.kind,
        f"{r.evidence:.1f}",
        error_text(r.candidate.fitted.error),
        error_text(r.candidate.held_out.error) if r.candidate.held_out.by_trial else "",
        ", ".join(r.values_in_words()),
        "; ".join(remarks),
    ]


def _rung(name: str, fitted: float | None, held_out: float | None) -> list[str]:
    vaf = ["" if e is None else f"{100 * (1 - e):.2f}" for e in (fitted, held_out)]
    return [name, _number(fitted), _number(held_out), *vaf]


def _values_table(page: Page, values: Any, parameters: Any) -> None:
    page.table(
        ["parameter", "value", "unit"],
        [[n, f"{v:.4g}", parameters[n].unit] for n, v in values.items()],
        text_columns=(2,),
    )


def _widths_table(page: Page, found: Any) -> None:
    rows = [
        [
            row.name.replace("_", " ").replace(".", ": "),
            with_unit(f"{row.optimum:.4g}", row.unit),
            _number(row.slice),
            _number(row.quadratic),
            _number(row.profile),
            "" if row.verdict == "not converged" else _number(row.posterior_sd),
            "{:.4g} to {:.4g} ({})".format(*interval(row)),
            f"{row.verdict}: {row.reason}",
        ]
        for row in found.rows
    ]
    page.table(
        [
            "parameter",
            "value",
            "slice",
            "quadratic",
            "profile",
            "posterior sd",
            "95 %",
            "verdict",
        ],
        rows,
        text_columns=(1, 6, 7),
    )


def _number(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.3g}"
