"""How the objects of a session show themselves: a sentence, a small table, a figure."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

import numpy as np

from identifiability.investigation.wording.numbers import NATS
from identifiability.investigation.wording.verdict import percent
from identifiability.joint.parameters import plus_minus, with_unit
from identifiability.plots.investigation_where import responses_figure
from identifiability.plots.rivals import rivals_figure
from identifiability.plots.style import png_of
from identifiability.workbench.attempt import Attempt, Ranked
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


def attempt_html(attempt: Attempt) -> str:
    """Parameters of a model with their widths, its errors, and what it predicts."""
    parameters = attempt.model.parameters
    rows = [
        [
            name.replace(".", ": ").replace("_", " "),
            with_unit(
                plus_minus(attempt.values[name], attempt.sds.get(name)), parameters[name].unit
            ),
            parameters[name].description,
        ]
        for name in attempt.candidate.free
    ]
    split = attempt.split
    figure = responses_figure(
        split, attempt.candidate, of="held_out" if split.held_out else "fitted"
    )
    title = f"<p><b>{html.escape(attempt.name)}</b>: {html.escape(_errors(attempt))}</p>"
    return (
        title
        + _table(["parameter", "value", ""], rows, (0, 2))
        + _picture(png_of(figure), "Measured and predicted responses.")
    )


def ranking_html(ranking: Sequence[Ranked]) -> str:
    """Effects by what each would bring."""
    if not ranking:
        return "<p>Beside this model nothing was ranked yet: rank() does.</p>"
    rows = [_ranked_row(one) for one in ranking]
    head = ["one effect more", "evidence gained [nats]", "E fitted", "E held out", ""]
    return _table(head, rows, (0, 4)) + f"<p>{NATS}</p>"


def difference_html(difference: Difference) -> str:
    """Two models in one sentence, a table and a figure."""
    pair = (difference.first, difference.second)
    names = list(dict.fromkeys(n for one in pair for n in one.candidate.free))
    rows = [
        [
            name.replace(".", ": ").replace("_", " "),
            *(
                plus_minus(one.values[name], one.sds.get(name)) if name in one.values else ""
                for one in pair
            ),
        ]
        for name in names
    ]
    table = _table(["parameter", *(one.name for one in pair)], rows, (0,))
    sentence = f"<p>{html.escape(difference_sentence(difference))}</p>"
    picture = png_of(rivals_figure(difference.rivals))
    return sentence + table + _picture(picture, "The trial in which the two models differ most.")


def session_html(session: Session) -> str:
    """The history of models; the present one stands out."""
    floor = session.study.split.noise_floor()
    rows = [
        [
            ("▶ " if i == session.place else "") + one.name,
            *(plus_minus(one.values[n], one.sds.get(n)) for n in ("K", "B", "I")),
            *_errors_of(one),
        ]
        for i, one in enumerate(session.history)
    ]
    rows.append(["noise alone", "", "", "", f"{floor:.2g}" if floor else "unknown", ""])
    heads = ["model", "K [Nm/rad]", "B [Nms/rad]", "I [kg m²]", "E fitted", "E held out"]
    return _table(heads, rows, (0,))


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


def _picture(picture: bytes, alt: str) -> str:
    data, said = base64.b64encode(picture).decode(), html.escape(alt)
    return f'<img style="max-width:100%" alt="{said}" src="data:image/png;base64,{data}">'
