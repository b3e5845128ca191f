"""The ranking of a report: which sets of effects are how probable, and what each would do alone."""

from __future__ import annotations

from dataclasses import replace

from identifiability.investigation.findings import Findings
from identifiability.investigation.ladder.found import Found, Tried
from identifiability.investigation.posterior.probabilities import Probabilities
from identifiability.investigation.wording import verdict as words
from identifiability.investigation.wording.numbers import times
from identifiability.plots.investigation import alone_figure
from identifiability.report.figures import Figures
from identifiability.report.page import Page

SHOWN = 0.005
"""Probability from which a set is listed."""

_SEEN = 1e-3  # share of the response from which a torque without a name is spoken of
_VISIBLE = 2.3  # log evidence [nats], ten times, from which a bar is to be seen
_OTHERS = 4  # in the place of an effect that are listed


def ranking(page: Page, figures: Figures, findings: Findings) -> None:
    """What may be missing, the most probable first: the verdict goes by these numbers."""
    found, posterior = findings.found, findings.posterior
    if posterior is None:
        return
    rows = [row for row in posterior.rows if row.probability >= SHOWN] or posterior.rows[:1]
    page.paragraph(
        f"Of {found.n_weighed} sets of effects that were fitted, these are probable, by one "
        "likelihood of the recordings in which the noise of both channels and its colour are "
        "estimated for each. Something unknown is a torque of any form. Before the data every "
        "number of effects is as probable, and every set of so many." + _begun_only(posterior)
    )
    page.table(
        ["missing", "probability"],
        [(words.set_in_words(row.effects), words.percent(row.probability)) for row in rows],
        text_columns=(0,),
    )
    rest = posterior.discrepancy
    if rest is not None and rest.kind != "none" and rest.size >= _SEEN:
        page.paragraph(
            f"Beside the most probable of them there is a torque that nothing names, mostly of "
            f"kind {rest.kind}; it makes {words.percent(rest.size)} of the response."
        )
    if not found.alone:
        return
    present = {one.key: posterior.present(one.key) for one in found.alone}
    ordered = tuple(
        sorted(found.alone, key=lambda one: (bool(one.failure), -present[one.key], -one.evidence))
    )
    named = {key for names in findings.verdict.sets for key in names}
    if any(one.evidence > _VISIBLE for one in ordered):
        figures.show(
            "ranking",
            lambda: alone_figure(replace(found, alone=ordered), named, present),
            "Effects by the probability that they are there, whatever else is, which decides. "
            "Bars: by how much each alone makes the trials more probable. Alone, what is a poor "
            "picture of two effects may be left behind by both.",
            "Bars of all effects that were tried; the most probable is "
            f"{words.plain(ordered[0].key)}, with {words.percent(present[ordered[0].key])}.",
        )
    page.table(
        ["effect", "kind", "it is there", "alone: times as probable", "alone leaves", "parameters"],
        [tried_row(one, present[one.key]) for one in ordered],
        marked=["failed" if one.failure else "" for one in ordered],
        text_columns=(0, 1, 5),
    )
    _in_their_place(page, found)
    page.paragraph(
        "“Times as probable” is how many times as probable the trials are with the effect as "
        "without it, averaged over what the parameters may be before them; what an effect leaves "
        "is a share of the response's energy."
    )


def _begun_only(posterior: Probabilities) -> str:
    """What was left out of a long record's weighing, and how far behind it was."""
    if not posterior.screened:
        return ""
    return (
        f" {len(posterior.screened)} more were begun by a part of the samples, which put each of "
        f"them {min(posterior.screened.values()):.0f} nats or more behind the best of as many "
        "effects, and were not weighed by all."
    )


def tried_row(tried: Tried, present: float) -> list[str]:
    """One effect: its probability, and what it does alone."""
    name, kind = words.plain(tried.key), tried.effect.kind
    if tried.failure:
        return [name, kind, "", "", "", f"no fit: {tried.failure}"]
    units = {n: p.unit for n, p in tried.candidate.model.parameters.items()}
    return [
        name,
        kind,
        words.percent(present),
        times(tried.evidence),
        words.percent(tried.error),
        words.values_in_words(tried.own_values, units),
    ]


def _in_their_place(page: Page, found: Found) -> None:
    rows = [
        [
            words.plain(missing.key),
            words.plain(other.key),
            times(other.evidence),
            words.percent(other.probability),
        ]
        for missing in found.missing
        for other in missing.rivals[:_OTHERS]
    ]
    if rows:
        page.paragraph("In the place of each effect of the final model, the best others:")
        page.table(
            ["in the place of", "effect", "times as probable", "probability"],
            rows,
            text_columns=(0, 1),
        )
