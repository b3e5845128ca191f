"""A self-contained HTML page: text, tables and figures in one file, for screens and for paper."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1a1a1a; --quiet: #555; --line: #d4d4d4;
        --stress: #eef4fb; --edge: #0072b2; --bad: #a33; }
@media screen and (prefers-color-scheme: dark) {
  :root { --paper: #16191d; --ink: #e8e8e8; --quiet: #aab2ba; --line: #3d444c; --stress: #1c2a39;
          --edge: #56b4e9; --bad: #ff9a8f; }
}
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
       max-width: 70rem; margin: 0 auto; padding: 1.2rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; border-bottom: 1px solid var(--line); }
p, li { max-width: 46rem; }
.verdict { background: var(--stress); border-left: 6px solid var(--edge); padding: .8rem 1.1rem;
           margin: 1rem 0; print-color-adjust: exact; }
.verdict p { margin: .4rem 0; max-width: 56rem; }
.verdict .kind { color: var(--quiet); margin: 0; }
.verdict .title { font-weight: 700; font-size: 1.3rem; line-height: 1.35; margin-top: 0; }
table { border-collapse: collapse; margin: .8rem 0; font-size: .88rem; line-height: 1.35; }
th, td { text-align: right; vertical-align: baseline; padding: .3rem .5rem;
         border-bottom: 1px solid var(--line); }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
td.long { overflow-wrap: anywhere; }
tr.chosen td { font-weight: 600; background: var(--stress); print-color-adjust: exact; }
tr.failed td { color: var(--bad); }
figure { margin: 1.2rem 0; }
figure .scroll { overflow-x: auto; }
figure img { display: block; width: 100%; height: auto; background: #fff; border-radius: 3px; }
figure.column img { max-width: 28rem; }
figure.page img { max-width: 60rem; }
figcaption { color: var(--quiet); font-size: .93rem; max-width: 46rem; margin-top: .3rem; }
code { background: var(--stress); padding: .1rem .3rem; overflow-wrap: anywhere; }
@media screen and (max-width: 960px) {
  table { font-size: .8rem; }
  th, td { padding: .25rem .3rem; }
}
@media screen and (max-width: 640px) {
  body { padding: .8rem; }
  figure.page img { min-width: 37rem; }
  thead { display: none; }
  table, tbody, tr, td { display: block; width: 100%; }
  tr { border-bottom: 2px solid var(--line); padding: .3rem 0; }
  td, td:first-child, td.text { display: flex; justify-content: space-between; gap: 1rem;
       text-align: right; border: 0; padding: .12rem .3rem; min-width: 0; }
  td:first-child { font-weight: 600; }
  td:empty { display: none; }
  td::before { content: attr(data-head); color: var(--quiet); font-weight: 400; text-align: left;
               flex: 0 0 auto; max-width: 50%; }
}
@page { size: A4; margin: 14mm; }
@media print {
  body { font-size: 9.5pt; max-width: none; padding: 0; }
  table { font-size: 7.5pt; }
  th, td { padding: .12rem .25rem; }
  figure.column img { width: 85mm; }
  figure.page img { width: 180mm; }
  figure .scroll { overflow: visible; }
  figure, .verdict, tr { break-inside: avoid; }
  thead { display: table-header-group; }
  h2 { break-after: avoid; }
}
"""


_LONG = 24  # letters of a word that may be broken anywhere


def _text_class(text: str) -> str:
    """Class of a cell of running text."""
    return '"text long"' if max(map(len, text.split()), default=0) > _LONG else "text"


class Page:
    """HTML built up part by part; all text is escaped."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts: list[str] = [f"<h1>{html.escape(title)}</h1>"]
        self._n_figures = 0

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def box(self, title: str, lines: Sequence[tuple[str, str]], *, kind: str = "") -> None:
        """Add what must be seen first.

        Parameters
        ----------
        title : str
        lines : sequence of (str, str)
            What each is about, in a word or two, and what is said of it.
        kind : str
            What kind of thing the title says; may be empty.
        """
        inner = f'<p class="kind">{html.escape(kind)}</p>' if kind else ""
        inner += f'<p class="title">{html.escape(title)}</p>'
        inner += "".join(f"<p><b>{html.escape(a)}.</b> {html.escape(b)}</p>" for a, b in lines)
        self._parts.append(f'<div class="verdict">{inner}</div>')

    def items(self, lines: Sequence[str]) -> None:
        """Add a list; nothing if there is nothing in it."""
        if lines:
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
        """Add a table, which becomes a list where the screen is narrow.

        Columns in which nothing is said are left out, and so is a table without rows.

        Parameters
        ----------
        header : sequence of str
        rows : sequence of sequences of str
        marked : sequence of str
            Class of each row, such as ``"chosen"``; may be empty.
        text_columns : sequence of int
            Columns of running text.
        """
        if not rows:
            return
        used = [i for i in range(len(header)) if any(row[i] for row in rows)]

        def cell(tag: str, i: int, text: str) -> str:
            kind = f" class={_text_class(text)}" if i in text_columns else ""
            head = f' data-head="{html.escape(header[i])}"' if tag == "td" else ""
            whole = html.escape(text).replace(" × ", "&nbsp;×&nbsp;").replace(" %", "&nbsp;%")
            return f"<{tag}{kind}{head}>{whole}</{tag}>"

        def line(tag: str, row: Sequence[str]) -> str:
            return "".join(cell(tag, i, row[i]) for i in used)

        body = []
        for i, row in enumerate(rows):
            kind = marked[i] if i < len(marked) else ""
            body.append(f"<tr{f' class={kind}' if kind else ''}>{line('td', row)}</tr>")
        self._parts.append(
            f"<table><thead><tr>{line('th', header)}</tr></thead>"
            f"<tbody>{''.join(body)}</tbody></table>"
        )

    def figure(self, svg: bytes, caption: str, *, alt: str, wide: bool = True) -> None:
        """Embed a figure.

        Parameters
        ----------
        svg : bytes
        caption : str
            What it shows and how to read it; it is numbered.
        alt : str
            What is to be seen, for those who do not.
        wide : bool
            Whether it is as wide as a page, not as a column of one.
        """
        self._n_figures += 1
        data = base64.b64encode(svg).decode()
        self._parts.append(
            f'<figure class="{"page" if wide else "column"}"><div class="scroll">'
            f'<img alt="{html.escape(alt)}" src="data:image/svg+xml;base64,{data}"></div>'
            f"<figcaption><b>Figure {self._n_figures}.</b> {html.escape(caption)}</figcaption>"
            "</figure>"
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
