"""Page of the benchmark of durations: how long an investigation takes, and where its time goes."""

from __future__ import annotations

from typing import Any

from identifiability.provenance import made_by

_PARTS = 3  # of an investigation, that take longest


def durations_page(record: dict[str, Any]) -> str:
    """Page in Markdown from the plain record of ``benchmark.durations``."""
    rows, allowed = record["rows"], record["most_silent"]
    lines = [
        "# How long an investigation takes, and where its time goes",
        "",
        f"Made by `identifiability benchmark durations --seed {record['seed']} --out results`",
        f"({made_by(record)}) on {record['processors']} processors. Joints with a",
        "delayed reflex, both channels noisy, from a simulator that shares no equations with the",
        "library. What is timed is the command, from when it is typed until report and figures are",
        "written: with an empty compile cache, and once more with a full one. *Fits*: how many",
        "times as long as `identifiability fit` of the same files, in the same run. *Silent*: the",
        f"longest time without a word; {allowed:g} s is the mark.",
        "",
        "| recordings | imposed | trials | samples | empty cache [s] | mark "
        "| full cache [s] | mark | fits | silent [s] | found |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        size, empty, full = r["size"], r["empty"], r["full"]
        silent = max(empty["silence"], full["silence"])
        lines.append(
            f"| {size['name']} | {size['imposed']} | {size['trials']} | {size['samples']:,} "
            f"| {_against(empty['seconds'], size['mark_empty'])} "
            f"| {_against(full['seconds'], size['mark_full'])} "
            f"| {r['fits']:.1f} | {_marked(silent, allowed)} | {_found(full['found'])} |"
        )
    lines += ["", "Where the time goes, with a full cache, and what was silent longest:", ""]
    for r in rows:
        full = r["full"]
        longest = sorted(full["timings"].items(), key=lambda part: -part[1])[:_PARTS]
        told = ", ".join(f"{part} {seconds:.0f} s" for part, seconds in longest)
        lines.append(
            f"- {r['size']['name']}, {r['size']['imposed']} imposed: {told}; "
            f'{full["silence"]:.0f} s after "{full["before"]}"'
        )
    return "\n".join(lines) + "\n"


def _against(seconds: float, mark: float | None) -> str:
    """Seconds and their mark, as two cells."""
    if mark is None:
        return f"{seconds:.0f} |"
    return f"{_marked(seconds, mark)} | {mark:.0f}"


def _marked(seconds: float, most: float) -> str:
    """Seconds, in bold where they are too many."""
    return f"{seconds:.0f}" if seconds <= most else f"**{seconds:.0f}**"


def _found(found: list[str]) -> str:
    kind, *effects = found
    return " and ".join(e.replace("_", " ") for e in effects) or kind
