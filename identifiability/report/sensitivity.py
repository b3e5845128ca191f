"""Page of what tracking hangs on."""

from __future__ import annotations

from itertools import product
from typing import Any

from identifiability.report.markdown import number, percent, table

Record = dict[str, Any]


def sensitivity_page(record: Record) -> str:
    """Page in Markdown from the plain record of `identifiability.study.sensitivity`."""
    grid, cells = record["grid"], record["cells"]
    models = len(grid["K_CE"]) * len(grid["B_CE"]) * len(grid["ratio"])
    lines = [
        "# What it hangs on whether posterior spread follows the Hessian",
        "",
        f"Made by `identifiability sensitivity --out results`. {models} musculoskeletal models",
        "that span the paper's grid ([the whole of it](atlas.md)), an",
        f"{record['perturbation']}, three durations, both readings of the noise: each computed as",
        f"in the atlas, and again with one thing changed. {cells['done']} of {cells['total']} fits",
        "are there. *Within a tenth*: of the standard deviations of K, B and I, the share that is",
        "within a tenth of the quadratic width, with Wilson's 95 % interval (a fit counts once).",
        "*Ratio*: median of posterior over quadratic. *Holds*: fits in which the ellipse holds for",
        "all three (widths to 10 %, ends of intervals to 0.25 widths).",
        "",
        "## The answer",
        "",
        *(f"- {sentence}" for sentence in answers(record)),
        "",
    ]
    for reading in dict.fromkeys(row["reading"] for row in record["rows"]):
        rows = [
            [
                row["variant"],
                f"{1000 * row['T']:.0f} ms",
                f"{_share(row)} ({' to '.join(percent(v) for v in row['interval'])})",
                number(row["ratio"]),
                f"{row['holds']} of {row['cells']}",
            ]
            for row in record["rows"]
            if row["reading"] == reading
        ]
        heads = ["", "T", "within a tenth", "ratio", "holds"]
        lines += [f"## {reading.capitalize()} noise", "", table(heads, rows), ""]
    return "\n".join(lines)


def answers(record: Record) -> list[str]:
    """What each change does, a sentence each."""
    rows = {(r["variant"], r["reading"], r["T"]): r for r in record["rows"]}
    variants = list(dict.fromkeys(r["variant"] for r in record["rows"]))
    readings = list(dict.fromkeys(r["reading"] for r in record["rows"]))
    base, *others = variants
    found = []
    for name in others:
        parts = []
        for reading, T in product(readings, record["grid"]["T"]):
            before, after = (rows.get((v, reading, T)) for v in (base, name))
            if before is not None and after is not None:
                parts.append((reading, T, before, after))
        told = []
        for reading in readings:
            shares = [
                f"{_share(before)} becomes {_share(after)} at {1000 * T:.0f} ms"
                for which, T, before, after in parts
                if which == reading
            ]
            told.append(f"{reading}: {', '.join(shares)}")
        found.append(f"**{name[0].upper()}{name[1:]}.** {'; '.join(told)}.")
    return found


def _share(row: Record) -> str:
    return percent(row["within"] / row["of"])
