"""The report of an investigation: one HTML file that needs no network, and its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from identifiability.files import write_json, write_text
from identifiability.inference.widths import Width, Widths
from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.models import fitted_models
from identifiability.investigation.record import investigation_record
from identifiability.investigation.rivals import Rivals
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.verdict.pinned import interval, not_pinned_down
from identifiability.investigation.wording import verdict as words
from identifiability.investigation.wording.certainty import certainty_sentence
from identifiability.investigation.wording.consequence import consequence_sentence
from identifiability.investigation.wording.describe import describe
from identifiability.investigation.wording.next_step import next_step_sentence, safety_sentence
from identifiability.investigation.wording.numbers import error_text
from identifiability.investigation.wording.pinned import loose_sentence
from identifiability.investigation.wording.unexplained import unexplained_sentence
from identifiability.investigation.wording.values import width_in_words
from identifiability.joint.parameters import with_unit
from identifiability.numerals import number, range_text
from identifiability.plots.investigation import ladder_figure, widths_figure
from identifiability.plots.investigation_unexplained import (
    missing_torque_figure,
    unexplained_figure,
)
from identifiability.plots.investigation_where import (
    comparison_figure,
    responses_figure,
    where_figure,
)
from identifiability.plots.rivals import rivals_figure
from identifiability.plots.style import MODEL_COLOURS
from identifiability.report.figures import Figures
from identifiability.report.models import models_table, models_text
from identifiability.report.page import Page
from identifiability.report.ranking import SHOWN, ranking

_ROWS = 6  # sets listed in the terminal, at most
_RIVALS = 3  # whose curves are laid on each other, at most


def write_investigation(findings: Findings, out: Path, *, command: str) -> list[str]:
    """Write record, report and figures into a folder; returns the files' names."""
    record = investigation_record(findings, command=command)
    write_json(out / "investigation.json", record)
    return ["investigation.json", "report.html", *write_report(findings, record, out)]


def investigation_text(findings: Findings) -> str:
    """What was found, as text."""
    lines = [words.verdict_sentence(findings), consequence_sentence(findings), ""]
    lines += models_text(findings)
    lines += ["", *words.because(findings), "", f"Next. {next_step_sentence(findings)}"]
    if safety := safety_sentence(findings):
        lines.append(safety)
    if findings.posterior is not None:
        lines += ["", "probability of what may be missing:"]
    for one in () if findings.posterior is None else findings.posterior.rows[:_ROWS]:
        if one.probability >= SHOWN:
            name = words.set_in_words(one.effects)
            lines.append(f"  {name:<40}{words.percent(one.probability):>18}")
    if findings.widths is not None:
        lines.append("")
        for row in findings.widths.rows:
            low, high, source = interval(row)
            lines.append(
                f"{words.plain(row.name)} = {number(row.optimum, 4)} (95 % by {source}: "
                f"{range_text(low, high)}): {width_in_words(row.verdict)}"
            )
        loose = not_pinned_down(findings.widths, findings.split.rules.loose)
        lines += ["", *map(loose_sentence, loose)] if loose else []
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
    figures = Figures(page, out)
    _verdict(page, figures, findings)
    _proof(page, figures, findings)
    _rivals(figures, findings)
    _left(page, figures, findings)
    _where(page, figures, findings)
    page.heading("What may be missing, by probability")
    _failed(page, findings, "probabilities")
    ranking(page, figures, findings)
    _parameters(page, figures, findings)
    _next(page, findings)
    _how(page, findings, record)
    figures.show_cuts([*findings.split.fitted, *findings.split.held_out])
    write_text(out / "report.html", page.render())
    return figures.written


def _failed(page: Page, findings: Findings, part: str) -> None:
    """Say why a part is not there, if it failed."""
    if part in findings.failures:
        page.paragraph(f"This part could not be done: {findings.failures[part]}.")


def _is_unknown(findings: Findings) -> bool:
    kind = findings.verdict.kind
    return kind.startswith("unknown") or kind == "unrepeatable"


def _verdict(page: Page, figures: Figures, findings: Findings) -> None:
    split = findings.split
    page.paragraph(
        f"{_trials(len(split.fitted))} fitted, {len(split.held_out)} held out "
        f"({split.how_held_out}); {split.driven} imposed."
    )
    box = []
    if sure := certainty_sentence(findings):
        box.append(("How sure", sure))
    box += [
        ("K, B and I", consequence_sentence(findings)),
        ("Next", next_step_sentence(findings)),
    ]
    if safety := safety_sentence(findings):
        box.append(("Safety", safety))
    page.box(words.verdict_sentence(findings), box, kind=words.TITLES[findings.verdict.kind])
    models_table(page, findings)
    if _is_unknown(findings):
        _missing_torque(figures, findings, findings.unexplained_after)
    if reasons := words.because(findings)[1:]:
        page.heading("Why")
        page.items(reasons)
    if findings.remarks:
        page.heading("Notes on the trials")
        page.items(list(findings.remarks))
    if findings.failed:
        page.heading("What could not be done")
        page.items(list(findings.failed))


def _trials(n: int) -> str:
    return "1 trial" if n == 1 else f"{n} trials"


def _missing_torque(figures: Figures, findings: Findings, rest: Unexplained | None) -> None:
    if rest is None or not rest.torque:
        return
    largest = max(float(np.abs(t.mean).max()) for t in rest.torque)
    final = rest is findings.unexplained_after and findings.found.missing
    model = "the model with what is named" if final else "K, B and I"
    figures.show(
        f"missing_torque{'_final' if final else ''}",
        lambda: missing_torque_figure(findings.split, rest),
        f"The torque that {model} cannot make, with nothing assumed of its form: by the state of "
        "the joint (white or grey: not told from nothing, or not visited), and in time, with its "
        "95 % band. Positive opposes a positive angle.",
        f"Map of the missing torque over angle and velocity, and its course in each trial; it "
        f"reaches {number(largest, 2)} Nm.",
    )


def _proof(page: Page, figures: Figures, findings: Findings) -> None:
    split, models = findings.split, _drawn(findings)
    page.heading("The error on data that were not fitted" if split.held_out else "The error")
    of: Literal["held_out", "fitted"] = "held_out" if split.held_out else "fitted"
    errors = [f"{words.model_in_words(m.keys)} leaves {_error(m, of)}" for m in models]
    noise = " in units of the noise (grey: 95 % of it)" if split.has_noise else ""
    figures.show(
        "held_out" if split.held_out else "overlay",
        lambda: responses_figure(split, *models, of=of),
        f"Trials that no model was fitted to, what each model predicts, and under each what it "
        f"leaves{noise}. Far beyond the band the scale is logarithmic."
        if split.held_out
        else f"Measured and predicted responses, and under each what is left{noise}.",
        f"Curves of the trials, measured and predicted: {'; '.join(errors)}.",
    )
    if findings.found.missing:
        figures.show(
            "ladder",
            lambda: ladder_figure(findings),
            "Error of the model with every effect added, on trials that were fitted and that were "
            "not; dotted, with a band of two standard errors: what the noise of each part leaves."
            " Open: with another effect in its place.",
            f"The error by model: {'; '.join(errors)}.",
        )
    if split.held_out:
        figures.show(
            "overlay",
            lambda: responses_figure(split, *models),
            "The same for the trials that were fitted.",
            "Curves of the fitted trials, measured and predicted.",
        )


def _error(model: Candidate, of: str) -> str:
    return error_text(getattr(model, of).error)


def _drawn(findings: Findings) -> list[Candidate]:
    """Models whose predictions are drawn: all, or those that matter where they are many."""
    models = fitted_models(findings)
    if len(models) > len(MODEL_COLOURS):
        models = tuple(one for one in models if one.role != "step")
    return [one.candidate for one in models[: len(MODEL_COLOURS)]]


def _rivals(figures: Figures, findings: Findings) -> None:
    """What the data do not tell apart, where it differs most."""
    final = findings.found.final
    instead = [one for one in fitted_models(findings) if one.role == "instead"]
    for one in instead[:_RIVALS] if findings.verdict.sets else ():
        rivals = Rivals(findings.split, final, one.candidate)
        pair = f"{words.plain(one.replaced)} and {words.plain(one.added)}"
        gap = float(np.abs(rivals.by_trial[rivals.most[0]]).max())
        unit = "rad" if findings.split.driven == "torque" else "Nm"
        figures.show(
            f"rivals_{one.replaced}_{one.added}",
            lambda rivals=rivals: rivals_figure(rivals),  # type: ignore[misc]
            f"Models with {pair}, which the data do not tell apart, in the trial in which they "
            "differ most; on the right about the time at which they do.",
            f"Predictions of {pair} on top of each other; at most they are "
            f"{number(gap, 2)} {unit} apart.",
        )


def _left(page: Page, figures: Figures, findings: Findings) -> None:
    page.heading("The torque that is missing")
    before, after = findings.unexplained_before, findings.unexplained_after
    _failed(page, findings, "unexplained torque")
    if before is not None:
        page.paragraph(f"K, B and I alone. {unexplained_sentence(before)}")
        _account(figures, findings, before, "baseline")
    if after is not before:
        page.paragraph(f"With what is named. {unexplained_sentence(after)}")
        _account(figures, findings, after, "final")


def _account(figures: Figures, findings: Findings, rest: Unexplained, name: str) -> None:
    """Pictures of what is left, where that is more than noise; the torque where it is not yet."""
    if rest.best.kind == "none":
        return
    if not (_is_unknown(findings) and rest is findings.unexplained_after):
        _missing_torque(figures, findings, rest)
    figures.show(
        f"kinds_{name}",
        lambda: unexplained_figure(rest, with_torque=False),
        "What kind of thing is left, with no effect named: by how many powers of ten each kind is "
        "more probable than noise. Kinds beyond the dashed line are not excluded.",
        f"Bars of kinds of explanation; the best is {rest.best.name}.",
    )


def _where(page: Page, figures: Figures, findings: Findings) -> None:
    page.heading("Where K, B and I fail")
    for part in ("location", "comparison"):
        _failed(page, findings, part)
    if (location := findings.location) is not None:
        page.items(list(describe(location)))
        panels = [panel.title for view in location.views.values() for panel in view.panels()]
        if panels:
            figures.show(
                "where",
                lambda: where_figure(location),
                "How large the residual of K, B and I is against what it is judged by (dashed), "
                "and the torque that is missing by angle and velocity, with 95 % intervals.",
                f"Panels of the residual's size {', '.join(panels)}.",
            )
    if (comparison := findings.comparison) is not None:
        page.paragraph(
            "If the model is right, K, B and I are the same for every window, amplitude, direction "
            "and kind of trial."
        )
        page.items(list(describe(comparison)))
        if changing := [c.by for c in comparison.constancy if c.groups]:
            figures.show(
                "comparison",
                lambda: comparison_figure(comparison),
                "K, B and I fitted to parts of the trials, with 95 % intervals; grey line and blue "
                "band: to all of them.",
                f"Estimates of K, B and I by {', '.join(changing)}.",
            )


def _parameters(page: Page, figures: Figures, findings: Findings) -> None:
    found = findings.widths
    if found is None and "widths" not in findings.failures:
        return
    page.heading("Parameters and their widths")
    _failed(page, findings, "widths")
    if found is None:
        return
    loose = [loose_sentence(p) for p in not_pinned_down(found, findings.split.rules.loose)]
    page.items(loose or ["All parameters are known to better than half their value."])
    _widths_table(page, found)
    figures.show(
        "widths",
        lambda: widths_figure(found),
        "Widths over values of all parameters: with all others held (slice), by the Hessian "
        "(quadratic), by the profile likelihood, and of the sampled posterior; in brackets, what "
        "the posterior says of the quadratic one.",
        f"Widths of {_names(found)} by four estimates, on one logarithmic axis.",
    )


def _names(found: Widths) -> str:
    return ", ".join(words.plain(row.name) for row in found.rows)


def _next(page: Page, findings: Findings) -> None:
    following = findings.next_experiment
    if following is None and "next experiment" not in findings.failures:
        return
    page.heading("Next experiment")
    _failed(page, findings, "next experiment")
    if following is None:
        return
    page.table(
        ["perturbation", "expected evidence a trial"],
        [
            [d.perturbation, number(d.expected_evidence)]
            for d in (following.best, *following.others)
        ],
        text_columns=(0,),
    )
    page.paragraph(
        f"Expected evidence: how far apart the two models stay when each is fitted to what the "
        f"other predicts, squared, in units of the noise. {number(following.needed)} is enough."
    )


def _how(page: Page, findings: Findings, record: dict[str, Any]) -> None:
    page.heading("How this was computed")
    page.items(
        [
            f"identifiability {record['package']}, code {record['code'][:12]}, seed "
            f"{record['seed']}",
            f"data SHA-256 {record['data_sha256']}",
            "E is the summed squared residual over the summed squared response of a trial (Eq. 3 "
            "of Kistemaker & Rozendaal 2011), averaged over trials.",
            "A set's probability follows from the likelihood of the recordings, averaged over what "
            "the parameters may be before them (Laplace's approximation).",
            f"All numbers, and the {len(record['rules'])} conventions that decided (rules), are in "
            "investigation.json; the figures are in figures/ as SVG, PDF and PNG.",
        ]
    )
    if record["command"]:
        page.code(record["command"])
    rows = [
        [
            t["name"],
            t["role"],
            str(t["samples"]),
            number(t["sampling_rate"], 4),
            _number(t["noise_sd"]),
            "; ".join(t["notes"]),
        ]
        for t in record["trials"]
    ]
    page.table(
        ["trial", "role", "samples", "rate [Hz]", "noise sd", "what was done to it"],
        rows,
        text_columns=(0, 1, 5),
    )


def _widths_table(page: Page, found: Widths) -> None:
    rows = [
        [
            words.plain(row.name),
            with_unit(number(row.optimum, 4), row.unit),
            _number(row.slice, 2),
            _number(row.quadratic, 2),
            _number(row.profile, 2),
            "" if row.verdict == "not converged" else _number(row.posterior_sd, 2),
            _interval(row),
            width_in_words(row.verdict),
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
            "the quadratic width",
        ],
        rows,
        text_columns=(0, 1, 6, 7),
    )
    page.items([f"{row.reason.replace(row.name, words.plain(row.name))}." for row in found.rows])


def _interval(row: Width) -> str:
    low, high, source = interval(row)
    return f"{range_text(low, high)} ({source})"


def _number(value: float | None, digits: int = 3) -> str:
    return "" if value is None or not np.isfinite(value) else number(value, digits)
