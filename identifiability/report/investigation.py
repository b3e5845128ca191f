"""The report of an investigation: one HTML file that needs no network, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.files import write_json, write_text
from identifiability.inference.widths import Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.ladder.found import Found, Tried
from identifiability.investigation.record import investigation_record
from identifiability.investigation.verdict.pinned import interval, not_pinned_down
from identifiability.investigation.wording import verdict as words
from identifiability.investigation.wording.consequence import consequence_sentence
from identifiability.investigation.wording.describe import describe
from identifiability.investigation.wording.next_experiment import next_experiment_sentence
from identifiability.investigation.wording.pinned import loose_sentence
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.joint.parameters import Parameter, with_unit
from identifiability.plots.investigation import (
    alone_figure,
    error_text,
    ladder_figure,
    widths_figure,
)
from identifiability.plots.investigation_unexplained import unexplained_figure
from identifiability.plots.investigation_where import (
    comparison_figure,
    responses_figure,
    where_figure,
)
from identifiability.plots.style import save
from identifiability.report.models import models_table, models_text
from identifiability.report.page import Page
from identifiability.report.widths import width_in_words

_ROWS = 6  # sets listed in the terminal, at most
_SHOWN = 0.005  # probability from which a set is listed


@dataclass(frozen=True)
class _Figures:
    """Draws figures into a page and a folder."""

    page: Page
    out: Path
    written: list[str] = field(default_factory=list)

    def show(self, name: str, draw: Callable[[], Any], caption: str) -> None:
        # A figure that cannot be drawn must not take the report with it.
        try:
            figure = draw()
        except (ValueError, ArithmeticError, IndexError, KeyError) as error:
            self.page.paragraph(f"(This figure could not be drawn: {error}.)")
            return
        drawn = save(figure, self.out / f"{name}.png")
        self.written.append(drawn.name)
        self.page.figure(drawn.read_bytes(), caption, alt=caption)


def write_investigation(findings: Findings, out: Path, *, command: str) -> list[str]:
    """Write record, report and figures into a folder; returns the files' names."""
    record = investigation_record(findings, command=command)
    write_json(out / "investigation.json", record)
    return ["investigation.json", "report.html", *write_report(findings, record, out)]


def investigation_text(findings: Findings) -> str:
    """What was found, as text."""
    lines = [words.verdict_sentence(findings), consequence_sentence(findings), ""]
    lines += models_text(findings)
    lines += ["", *words.because(findings)]
    if findings.next_experiment is not None:
        lines += ["", f"Next experiment. {next_experiment_sentence(findings.next_experiment)}"]
    if findings.posterior is not None:
        lines += ["", "probability of what may be missing:"]
    for one in () if findings.posterior is None else findings.posterior.rows[:_ROWS]:
        if one.probability >= _SHOWN:
            name = words.set_in_words(one.effects)
            lines.append(f"  {name:<40}{words.percent(one.probability):>18}")
    if findings.widths is not None:
        lines.append("")
        for row in findings.widths.rows:
            low, high, source = interval(row)
            lines.append(
                f"{row.name} = {row.optimum:.4g} (95 % by {source}: {low:.4g} to {high:.4g}): "
                f"{width_in_words(row.verdict)}"
            )
        loose = not_pinned_down(findings.widths, findings.split.rules.loose)
        lines += ["", *map(loose_sentence, loose)]
    lines += [f"note: {warning}" for warning in findings.warnings]
    return "\n".join(lines)


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
    page = Page("What does the joint model miss?")
    figures = _Figures(page, out)
    _verdict(page, figures, findings)
    _data_and_model(page, figures, findings)
    _where(page, figures, findings)
    _which(page, figures, findings)
    _ladder(page, figures, findings, record)
    _unexplained(page, figures, findings)
    _parameters(page, figures, findings)
    _next(page, findings)
    _how(page, findings, record)
    write_text(out / "report.html", page.render())
    return figures.written


def _failed(page: Page, findings: Findings, part: str) -> None:
    """Say why a part is not there, if it failed."""
    if part in findings.failures:
        page.paragraph(f"This part could not be done: {findings.failures[part]}.")


def _verdict(page: Page, figures: _Figures, findings: Findings) -> None:
    split = findings.split
    page.paragraph(
        f"{len(split.fitted)} trial(s) fitted, {len(split.held_out)} held out "
        f"({split.how_held_out}); {split.driven} imposed; "
        f"{findings.found.n_weighed} sets of effects weighed."
    )
    reasons = words.because(findings)
    box = [
        words.verdict_sentence(findings),
        *reasons[:1],
        consequence_sentence(findings),
    ]
    if findings.next_experiment is not None:
        box.append(f"Next: {next_experiment_sentence(findings.next_experiment)}")
    page.box(words.TITLES[findings.verdict.kind], box)
    models_table(page, findings)
    if split.held_out:
        found = findings.found
        figures.show(
            "held_out",
            lambda: responses_figure(
                split, found.baseline, found.final if found.missing else None, of="held_out"
            ),
            "Trials that no model was fitted to, what each predicts, and under each what is left"
            + (", over the noise (grey: 95 % of it)." if split.has_noise else "."),
        )
    page.items(reasons[1:])
    if findings.warnings:
        page.heading("What could not be done")
        page.items(list(findings.warnings))


def _data_and_model(page: Page, figures: _Figures, findings: Findings) -> None:
    found = findings.found
    page.heading("Data and model")
    after = found.final if found.missing else None
    figures.show(
        "overlay",
        lambda: responses_figure(findings.split, found.baseline, after),
        "Measured and predicted responses, and under each what is left.",
    )
    _failed(page, findings, "comparison")
    if (comparison := findings.comparison) is not None:
        page.paragraph(
            "If the model is right, K, B and I are the same for every window, amplitude, direction "
            "and kind of trial."
        )
        page.items(list(describe(comparison)))
        figures.show(
            "comparison",
            lambda: comparison_figure(comparison),
            "K, B and I of the baseline model, fitted to parts of the trials.",
        )


def _where(page: Page, figures: _Figures, findings: Findings) -> None:
    page.heading("Where the baseline fails")
    _failed(page, findings, "location")
    if (location := findings.location) is not None:
        page.items(list(describe(location)))
        figures.show(
            "where", lambda: where_figure(location), "Where the residual exceeds the noise."
        )


def _probabilities(page: Page, findings: Findings) -> None:
    posterior = findings.posterior
    if posterior is None:
        _failed(page, findings, "probabilities")
        return
    page.paragraph(
        f"Probability of every set of effects that was fitted ({findings.found.n_weighed} of "
        "them), by one likelihood of the recordings, with the noise of both channels and its colour"
        " estimated for each. Something unknown is a torque of any form. Every number of effects is"
        " taken to be as probable before the data, and then every set of so many."
    )
    shown = [r for r in posterior.rows if r.probability >= _SHOWN] or posterior.rows[:1]
    page.table(
        ("missing", "probability"),
        [(words.set_in_words(row.effects), words.percent(row.probability)) for row in shown],
        text_columns=(0,),
    )
    rest = posterior.discrepancy
    if rest is not None and rest.kind != "none":
        page.paragraph(
            f"Beside the most probable of them there is a torque that nothing names, mostly of "
            f"kind {rest.kind}; it makes {words.percent(rest.size)} of the response."
        )


def _which(page: Page, figures: _Figures, findings: Findings) -> None:
    found = findings.found
    named = {key for names in findings.verdict.sets for key in names}
    page.heading("Which effect is missing")
    _probabilities(page, findings)
    if not found.alone:
        return
    figures.show(
        "alone",
        lambda: alone_figure(found, named),
        "Every effect alone beside the baseline model. What alone is a poor picture of two effects "
        "may be left behind by both.",
    )
    page.table(
        ["effect", "kind", "log evidence [nats]", "left of the response's energy", "parameters"],
        [_tried_row(one) for one in found.alone],
        marked=["failed" if one.failure else "" for one in found.alone],
        text_columns=(0, 1, 4),
    )
    _in_their_place(page, found)


def _in_their_place(page: Page, found: Found) -> None:
    rows = [
        [
            words.plain(missing.key),
            words.plain(r.key),
            f"{r.evidence:.1f}",
            words.percent(r.probability),
        ]
        for missing in found.missing
        for r in missing.rivals[:4]
    ]
    if len(found.missing) < 2 or not rows:
        return
    page.paragraph("In the place of each effect of the final model, the best others:")
    page.table(
        ["in the place of", "effect", "log evidence against the final model [nats]", "probability"],
        rows,
        text_columns=(0, 1),
    )


def _ladder(page: Page, figures: _Figures, findings: Findings, record: dict[str, Any]) -> None:
    page.heading("Error ladder")
    if findings.found.missing:
        figures.show(
            "ladder",
            lambda: ladder_figure(findings),
            "Error of the model with every effect added, on trials that were fitted and on those "
            "that were not.",
        )
    floor = record["baseline"]["noise_floor"]
    rungs = [("K, B, I", record["baseline"])]
    rungs += [("+ " + words.plain(step["added"]), step) for step in record["steps"]]
    rows = [_rung(name, rung["error_fit"], rung["error_held_out"]) for name, rung in rungs]
    rows.append(_rung("noise floor", floor, record["baseline"]["noise_floor_held_out"]))
    page.table(["model", "E fitted", "E held out", "VAF fitted [%]", "VAF held out [%]"], rows)


def _unexplained(page: Page, figures: _Figures, findings: Findings) -> None:
    page.heading("Unexplained torque")
    before, after = findings.unexplained_before, findings.unexplained_after
    _failed(page, findings, "unexplained torque")
    if before is not None:
        page.paragraph(f"Baseline. {unexplained_sentence(before)}")
        figures.show(
            "unexplained_baseline",
            lambda: unexplained_figure(before),
            "What the baseline lacks, with nothing assumed but its family.",
        )
    if after is not before:
        page.paragraph(f"Final model. {unexplained_sentence(after)}")
        figures.show(
            "unexplained_final",
            lambda: unexplained_figure(after),
            "What the final model still lacks.",
        )


def _parameters(page: Page, figures: _Figures, findings: Findings) -> None:
    page.heading("Parameters and their widths")
    found, final = findings.widths, findings.found.final
    if found is None:
        if "widths" not in findings.failures:
            page.paragraph("Widths were not computed.")
        _failed(page, findings, "widths")
        _values_table(page, final.values, final.model.parameters)
        return
    loose = [loose_sentence(p) for p in not_pinned_down(found, findings.split.rules.loose)]
    page.items(loose or ["All parameters are known to better than half their value."])
    _widths_table(page, found)
    figures.show("widths", lambda: widths_figure(found), "Widths over values of all parameters.")


def _next(page: Page, findings: Findings) -> None:
    page.heading("Next experiment")
    following = findings.next_experiment
    if "next experiment" in findings.failures:
        _failed(page, findings, "next experiment")
    elif following is None:
        page.paragraph(
            "Nothing is open between effects that an experiment could separate."
            if findings.verdict.kind in ("explained", "nothing_missing")
            else "No pair of named effects is left that an experiment could separate."
        )
    else:
        page.paragraph(next_experiment_sentence(following))
        page.table(
            ["perturbation", "expected evidence a trial"],
            [
                [d.perturbation, f"{d.expected_evidence:.3g}"]
                for d in (following.best, *following.others)
            ],
            text_columns=(0,),
        )


def _how(page: Page, findings: Findings, record: dict[str, Any]) -> None:
    page.heading("How this was computed")
    page.items(
        [
            f"identifiability {record['package']}, seed {record['seed']}",
            f"data SHA-256 {record['data_sha256']}",
            "E is the summed squared residual over the summed squared response of a trial (Eq. 3 "
            "of Kistemaker & Rozendaal 2011), averaged over trials; VAF is 1 - E.",
            "Evidence is the likelihood of the recordings, averaged over what the parameters may "
            "be before them (Laplace's approximation), as its natural logarithm, in nats.",
            "Conventions: "
            + ", ".join(f"{name.replace('_', ' ')} {v:.3g}" for name, v in record["rules"].items())
            + ".",
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


def _tried_row(tried: Tried) -> list[str]:
    name, kind = words.plain(tried.key), tried.effect.kind
    if tried.failure:
        return [name, kind, "", "", f"no fit: {tried.failure}"]
    units = {n: p.unit for n, p in tried.candidate.model.parameters.items()}
    return [
        name,
        kind,
        f"{tried.evidence:.1f}",
        words.percent(tried.error),
        words.values_in_words(tried.own_values, units),
    ]


def _rung(name: str, fitted: float | None, held_out: float | None) -> list[str]:
    vaf = ["" if e is None else f"{100 * (1 - e):.2f}" for e in (fitted, held_out)]
    errors = ["" if e is None else error_text(e) for e in (fitted, held_out)]
    return [name, *errors, *vaf]


def _values_table(
    page: Page, values: Mapping[str, float], parameters: Mapping[str, Parameter]
) -> None:
    page.table(
        ["parameter", "value", "unit"],
        [[n, f"{v:.4g}", parameters[n].unit] for n, v in values.items()],
        text_columns=(2,),
    )


def _widths_table(page: Page, found: Widths) -> None:
    rows = [
        [
            row.name.replace("_", " ").replace(".", ": "),
            with_unit(f"{row.optimum:.4g}", row.unit),
            _number(row.slice),
            _number(row.quadratic),
            _number(row.profile),
            "" if row.verdict == "not converged" else _number(row.posterior_sd),
            "{:.4g} to {:.4g} ({})".format(*interval(row)),
            f"{width_in_words(row.verdict)}: {row.reason}",
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
