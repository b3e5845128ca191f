"""A self-contained HTML page: text, tables and figures in one file."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 70rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; border-bottom: 1px solid #ccc; }
p { max-width: 46rem; }
.verdict { background: #eef4fb; border-left: 6px solid #0072b2; padding: .9rem 1.1rem;
           font-size: 1.15rem; margin: 1rem 0; }
.verdict p { margin: .35rem 0; max-width: none; }
.verdict .title { font-weight: 700; font-size: 1.3rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .88rem; }
th, td { text-align: right; padding: .25rem .55rem; border-bottom: 1px solid #ddd;
         white-space: nowrap; }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
td.text { white-space: normal; min-width: 6.5rem; }
td.text:last-child { min-width: 13rem; }
tr.chosen td { font-weight: 600; background: #eef4fb; }
tr.failed td { color: #a33; }
img { max-width: 100%; height: auto; }
figure { margin: 1rem 0; }
figcaption { color: #444; font-size: .93rem; max-width: 46rem; }
@page { size: A4; margin: 14mm; }
@media print {
  body { font-size: 10pt; max-width: none; padding: 0; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td { white-space: normal; padding: .15rem .3rem; }
  td.text, td.text:last-child { min-width: 0; overflow-wrap: anywhere; }
  figure, .verdict, tr { break-inside: avoid; }
  h2 { break-after: avoid; }
}
code { background: #f4f4f4; padding: .1rem .3rem; overflow-wrap: anywhere; }
"""


class Page:
    """HTML built up part by part; all text is escaped."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts: list[str] = [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def box(self, title: str, lines: Sequence[str]) -> None:
        """Add a title and lines that stand out."""
        inner = f'<p class="title">{html.escape(title)}</p>'
        inner += "".join(f"<p>{html.escape(line)}</p>" for line in lines)
        self._parts.append(f'<div class="verdict">{inner}</div>')

    def items(self, lines: Sequence[str]) -> None:
        """Add a list."""
        inner = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
        self._parts.append(f"<ul>{inner}</ul>")

    def code(self, text: str) -> None:
        """Add a line of code."""
        self._parts.append(f"<p><code>{html.escape(text)}</code></p>")

    def table(
        self,
        header: Sequence[str],
        rows: Sequence[Sequence[str]],
        *,
        marked: Sequence[str] = (),
        text_columns: Sequence[int] = (),
    ) -> None:
        """Add a table.

        Parameters
        ----------
        header : sequence of str
        rows : sequence of sequences of str
        marked : sequence of str
            Class of each row, such as ``"chosen"``; may be empty.
        text_columns : sequence of int
            Columns of running text.
        """

        def cells(tag: str, row: Sequence[str]) -> str:
            return "".join(
                f"<{tag}{' class=text' if i in text_columns else ''}>{html.escape(str(c))}</{tag}>"
                for i, c in enumerate(row)
            )

        body = []
        for i, row in enumerate(rows):
            kind = marked[i] if i < len(marked) else ""
            body.append(f"<tr{f' class={kind}' if kind else ''}>{cells('td', row)}</tr>")
        self._parts.append(
            f'<div class="scroll"><table><thead><tr>{cells("th", header)}</tr></thead>'
            f"<tbody>{''.join(body)}</tbody></table></div>"
        )

    def figure(self, picture: bytes, caption: str, *, alt: str) -> None:
        """Embed a figure, the bytes of a PNG."""
        data = base64.b64encode(picture).decode()
        self._parts.append(
            f'<figure><img alt="{html.escape(alt)}" src="data:image/png;base64,{data}">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )

    def render(self) -> str:
        """Return the whole page."""
        body = "\n".join(self._parts)
        return (
            f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{html.escape(self.title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
            f"<body>\n{body}\n</body>\n</html>\n"
        )
