"""The page of a benchmark, made from the record of `benchmark.record` alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.provenance import made_by
from identifiability.report.markdown import table

Record = Mapping[str, Any]

_TIERS = {
    "singles": "one effect",
    "pairs": "two or three effects",
    "unknown": "an effect that is not in the library",
    "controls": "no effect: only noise of several kinds, or variation from trial to trial",
    "nulls": "no effect: only white noise",
    "quick": "some of each, six short trials",
}


def page(record: Record) -> str:
    """Page in Markdown from the plain record; several seeds stand side by side."""
    runs = record["runs"]
    several = len(runs) > 1
    seeds = ", ".join(str(run["seed"]) for run in runs)
    parts = [
        "# Hidden effects: what the investigation found",
        "Made by `identifiability benchmark investigation --out results`; the data come from an\n"
        "independent simulator (SciPy, tight tolerances, partly other equations than the\n"
        "library's).\n"
        f"{record['cases_run']} of {record['cases_in_tiers']} cases were run"
        f" (seed{'s' if several else ''} {seeds}, {made_by(record)}).",
        "*Right*: every hidden effect named and nothing else, alone or in a set that the data\n"
        "cannot tell apart; where nothing is hidden, or nothing known, that this was said.\n"
        "*Wrong*: something was named that is not there. Intervals are Wilson's, 95 %.",
        _side_by_side(record) if several else _rates(runs[0]),
        "\n".join(f"*{key}*: {text}." for key, text in _TIERS.items() if _has(record, key)),
        "*Weak*: an effect hides below three times the noise when the model is fitted without it.",
        "![confusion matrix](investigation/confusion.png)",
    ]
    if several:
        for run in runs:
            parts += [f"## Seed {run['seed']}", _rates(run)]
    for run in runs:
        parts += ["## Every case" + (f", seed {run['seed']}" if several else ""), _cases(run)]
    return "\n\n".join(parts) + "\n"


def _side_by_side(record: Record) -> str:
    """Right and wrong of every tier, a column a seed, and all seeds together."""
    runs = record["runs"]

    def text(t: Record | None) -> str:
        return "" if t is None else f"{t['right']} right, {t['wrong']} wrong of {t['n']}"

    return table(
        ["tier", *(f"seed {run['seed']}" for run in runs), "together: right", "wrong"],
        [
            [
                name,
                *(text(run["tiers"].get(name)) for run in runs),
                f"{t['right']} of {t['n']} {_span(t['right_interval'])}",
                f"{t['wrong']} {_span(t['wrong_interval'])}",
            ]
            for name, t in record["together"].items()
        ],
    )


def _rates(run: Record) -> str:
    rows = []
    for name, t in run["tiers"].items():
        first = (
            f"{t['first_pick']}/{t['first_pick_of']} {_span(t['first_pick_interval'])}"
            if t["first_pick_of"]
            else ""
        )
        rows.append(
            [
                name,
                str(t["n"]),
                f"{t['right']} {_span(t['right_interval'])}",
                f"{t['wrong']} {_span(t['wrong_interval'])}",
                first,
                "" if t["median_removed"] is None else f"{100 * t['median_removed']:.1f} %",
                _whole(t["median_seconds"]),
            ]
        )
    heads = ["tier", "cases", "right", "wrong", "first pick right"]
    return table([*heads, "misfit removed, median", "s, median"], rows)


def _cases(run: Record) -> str:
    rows = []
    for s in run["cases"]:
        hidden = ", ".join(s["truth"]) or s["kind"]
        rows.append(
            [
                s["name"],
                hidden + (" (weak)" if s["weak"] else ""),
                s["verdict"] or s["failure"].replace("|", "\\|"),
                "; ".join(" or ".join(members) for members in s["named"]),
                s["outcome"],
                _whole(s["seconds"]),
            ]
        )
    return table(["case", "hidden", "verdict", "named", "outcome", "s"], rows)


def _whole(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def _has(record: Record, tier: str) -> bool:
    return any(name.split(",")[0] == tier for name in record["together"])


def _span(interval: Sequence[float]) -> str:
    low, high = interval
    return f"({100 * low:.0f}-{100 * high:.0f} %)"
