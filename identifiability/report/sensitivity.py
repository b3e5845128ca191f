"""Page of what tracking hangs on."""

from __future__ import annotations

from typing import Any

from identifiability.report.markdown import number, percent, table

Record = dict[str, Any]

_NOTABLE = 0.1  # change of a share


def sensitivity_page(record: Record) -> str:
    """Page in Markdown from the plain record of `identifiability.study.sensitivity`."""
    grid, cells = record["grid"], record["cells"]
    models = len(grid["K_CE"]) * len(grid["B_CE"]) * len(grid["ratio"])
    text = f"""\
# What it hangs on whether posterior spread follows the Hessian

Made by `identifiability sensitivity --out results`. {models} musculoskeletal models that span the
paper's grid ([the whole of it](atlas.md)), an {record["perturbation"]}, three durations, both
readings of the noise: each computed as in the atlas, and again with one thing changed.
{cells["done"]} of {cells["total"]} fits are there.

## The answer
"""
    lines = [text, *(f"- {sentence}" for sentence in answers(record)), ""]
    lines += [
        "Of the standard deviations of K, B and I, the share that is within a tenth of the "
        "quadratic width:",
        "",
        _overview(record),
        "",
        "## All numbers",
        "",
        "*Within a tenth*: as above, with Wilson's 95 % interval (a fit counts once). *Ratio*: "
        "median of posterior over quadratic. *Holds*: fits in which the ellipse holds for K, B and "
        "I at once (widths to 10 %, ends of the 95 % interval to 0.25 widths). Correlated noise "
        "has the standard deviation of the white one.",
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
        lines += [f"### {reading.capitalize()} noise", "", table(heads, rows), ""]
    return "\n".join(lines)


def answers(record: Record) -> list[str]:
    """What each change does, the largest first, and which do little."""
    base, *others = _variants(record)
    strong, weak = [], []
    for name in others:
        place, change = _largest_change(record, base, name)
        if abs(change) >= _NOTABLE:
            strong.append((abs(change), name, place))
        else:
            weak.append((abs(change), name, place))
    found = []
    for _, name, (reading, T) in sorted(strong, key=lambda one: -one[0]):
        before, after = (_row(record, variant, reading, T) for variant in (base, name))
        found.append(
            f"**{name[0].upper()}{name[1:]}**: {_share(after)} of the widths are within a tenth, "
            f"{_share(before)} without ({reading} noise, {1000 * T:.0f} ms, where it matters most)."
        )
    if weak:
        found.append(
            f"Little hangs on the rest, by no more than {100 * max(weak)[0]:.0f} in 100 widths: "
            f"{'; '.join(name for _, name, _ in weak)}."
        )
    return found


def _largest_change(record: Record, base: str, name: str) -> tuple[tuple[str, float], float]:
    """Reading and duration where a share changes most, and by how much."""
    changes = {
        (r["reading"], r["T"]): _within(r) - _within(_row(record, base, r["reading"], r["T"]))
        for r in record["rows"]
        if r["variant"] == name
    }
    place = max(changes, key=lambda at: abs(changes[at]))
    return place, changes[place]


def _overview(record: Record) -> str:
    """Shares by variant, for every reading and duration."""
    places = list(dict.fromkeys((r["reading"], r["T"]) for r in record["rows"]))
    heads = ["", *(f"{reading}, {1000 * T:.0f} ms" for reading, T in places)]
    rows = [
        [name, *(_share(_row(record, name, reading, T)) for reading, T in places)]
        for name in _variants(record)
    ]
    return table(heads, rows)


def _variants(record: Record) -> list[str]:
    return list(dict.fromkeys(r["variant"] for r in record["rows"]))


def _row(record: Record, variant: str, reading: str, T: float) -> Record:
    found: Record = next(
        r for r in record["rows"] if (r["variant"], r["reading"], r["T"]) == (variant, reading, T)
    )
    return found


def _within(row: Record) -> float:
    return float(row["within"] / row["of"])


def _share(row: Record) -> str:
    return percent(_within(row))
