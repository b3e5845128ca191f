"""How the objects of a session show themselves: a sentence, a small table, a figure."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from identifiability.inference.widths import Widths
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.where.compare import Comparison
from identifiability.investigation.where.locate import Location
from identifiability.investigation.wording.describe import describe
from identifiability.investigation.wording.numbers import NATS
from identifiability.investigation.wording.values import width_in_words
from identifiability.investigation.wording.verdict import percent, plain
from identifiability.joint.parameters import plus_minus, with_unit
from identifiability.numerals import range_text
from identifiability.plots.investigation import widths_figure
from identifiability.plots.investigation_unexplained import unexplained_figure
from identifiability.plots.investigation_where import (
    comparison_figure,
    responses_figure,
    where_figure,
)
from identifiability.plots.rivals import rivals_figure
from identifiability.plots.style import png_of
from identifiability.workbench.attempt import Attempt, Ranked, Ranking
from identifiability.workbench.difference import Difference
from identifiability.workbench.session import Session

_CELL = "padding:.15em .7em;text-align:{};border-bottom:1px solid #8884"


def difference_sentence(difference: Difference) -> str:
    """Which of two models is more probable, and where they differ most."""
    first, second, rivals = difference.first, difference.second, difference.rivals
    likely, other = (first, second) if difference.nats >= 0 else (second, first)
    likelier = max(difference.probability, 1 - difference.probability)
    number, _ = rivals.most
    ready, gap = rivals.trials[number], rivals.by_trial[number]
    unit = "rad" if rivals.split.driven == "torque" else "Nm"
    share = float(np.sqrt(np.mean(gap**2) / np.mean(ready.compared**2)))
    return (
        f"{likely.name} is more probable than {other.name}: {percent(likelier)}, if one of the two "
        f"is right ({abs(difference.nats):.1f} nats); they differ most in "
        f"{ready.trial.name} at {rivals.time:.3g} s, by {np.abs(gap).max():.2g} {unit}, and by "
        f"{100 * share:.2g} % of the response over that trial."
    )


def page(result: object) -> str:
    """What was found, as one piece of HTML."""
    drawn = picture(result)
    if drawn is None:
        return said(result)
    data = base64.b64encode(drawn).decode()
    alt = type(result).__name__
    shown = f'<img style="max-width:100%" alt="{alt}" src="data:image/png;base64,{data}">'
    return said(result) + shown


@singledispatch
def said(result: object) -> str:
    """What was found in sentences or a table."""
    return "".join(map(_paragraph, describe(result)))


def picture(result: object) -> bytes | None:
    """What was found as a picture (PNG), where there is one."""
    draw = _FIGURES.get(type(result))
    return None if draw is None else png_of(draw(result))


def _predicted(attempt: Attempt) -> Any:
    """What a model predicts."""
    split = attempt.split
    return responses_figure(split, attempt.candidate, of="held_out" if split.held_out else "fitted")


_FIGURES: dict[type, Callable[[Any], Any]] = {
    Location: where_figure,
    Comparison: comparison_figure,
    Unexplained: unexplained_figure,
    Widths: widths_figure,
    Attempt: _predicted,
    Difference: lambda difference: rivals_figure(difference.rivals),
}


@said.register
def _(result: Attempt) -> str:
    """Parameters of a model with their widths, and its errors."""
    parameters = result.model.parameters
    rows = [
        [
            plain(name),
            with_unit(plus_minus(result.values[name], result.sds.get(name)), parameters[name].unit),
            parameters[name].description,
        ]
        for name in result.candidate.free
    ]
    title = f"<p><b>{html.escape(result.name)}</b>: {html.escape(_errors(result))}</p>"
    return title + _table(["parameter", "value", ""], rows, (0, 2))


@said.register
def _(result: Ranking) -> str:
    """Effects by what each would bring."""
    if not result:
        return _paragraph("Beside this model nothing was ranked yet: rank() does.")
    rows = [_ranked_row(one) for one in result]
    head = ["one effect more", "evidence gained [nats]", "E fitted", "E held out", ""]
    return _table(head, rows, (0, 4)) + _paragraph(NATS)


@said.register
def _(result: Difference) -> str:
    """Two models in one sentence and a table."""
    pair = (result.first, result.second)
    names = list(dict.fromkeys(n for one in pair for n in one.candidate.free))
    rows = [
        [
            plain(name),
            *(
                plus_minus(one.values[name], one.sds.get(name)) if name in one.values else ""
                for one in pair
            ),
        ]
        for name in names
    ]
    table = _table(["parameter", *(one.name for one in pair)], rows, (0,))
    return _paragraph(difference_sentence(result)) + table


@said.register
def _(result: Session) -> str:
    """The history of models; the present one stands out."""
    floor = result.study.split.noise_floor()
    rows = [
        [
            ("▶ " if i == result.place else "") + one.name,
            *(plus_minus(one.values[n], one.sds.get(n)) for n in ("K", "B", "I")),
            *_errors_of(one),
        ]
        for i, one in enumerate(result.history)
    ]
    rows.append(["noise alone", "", "", "", f"{floor:.2g}" if floor else "unknown", ""])
    heads = ["model", "K [Nm/rad]", "B [Nms/rad]", "I [kg m²]", "E fitted", "E held out"]
    return _table(heads, rows, (0,))


@said.register
def _(result: Widths) -> str:
    """Every parameter with its width, and whether the ellipse describes it."""
    rows = [
        [
            plain(row.name),
            with_unit(plus_minus(row.optimum, row.posterior_sd), row.unit),
            range_text(*row.profile_95),
            width_in_words(row.verdict),
        ]
        for row in result.rows
    ]
    return _table(["parameter", "value", "95 % by profile", "quadratic width"], rows, (0, 3))


def _ranked_row(one: Ranked) -> list[str]:
    name = one.key.replace("_", " ")
    if one.attempt is None:
        return [name, "", "", "", one.failure]
    return [name, f"{one.gained:+.1f}", *_errors_of(one.attempt), ""]


def _errors_of(attempt: Attempt) -> list[str]:
    held_out = attempt.candidate.held_out.error
    shown = f"{held_out:.3g}" if attempt.split.held_out else "-"
    return [f"{attempt.candidate.fitted.error:.3g}", shown]


def _errors(attempt: Attempt) -> str:
    fitted, held_out = _errors_of(attempt)
    floor = attempt.split.noise_floor()
    noise = "" if floor is None else f"; noise alone leaves {floor:.2g}"
    return f"E = {fitted} on the fitted trials, {held_out} on those held out{noise}."


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int]) -> str:
    """A table; the columns in `text` begin at the left."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f'<{tag} style="{_CELL.format("left" if i in text else "right")}">'
            f"{html.escape(str(cell))}</{tag}>"
            for i, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return (
        '<div style="overflow-x:auto"><table style="border-collapse:collapse">'
        f"<thead><tr>{cells('th', heads)}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(text)}</p>"
