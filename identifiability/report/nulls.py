"""Page of the benchmark of blind joints that miss nothing: whether intervals hold K, B and I."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.benchmark.score import wilson
from identifiability.inference.curvature import NORMAL_95
from identifiability.provenance import made_by
from identifiability.report.markdown import percent, table


def nulls_page(record: Mapping[str, Any]) -> str:
    """Page in Markdown from the plain record of `benchmark.nulls`."""
    rows: Sequence[Mapping[str, Any]] = record["rows"]
    own = [r for r in rows if r["way"] == "auto"]
    parts = [
        "# K, B and I of blind joints that miss nothing",
        f"Made by `identifiability benchmark nulls --cases {record['cases']} --seed "
        f"{record['seed']} --out results`\n({made_by(record)}): the blind joints of the "
        "[calibration](calibration.md) that miss nothing,\n100 to 1,000 Hz, short trials or one "
        "long record, with noise of 1e-5 to 1e-3 of the response's energy.\nK, B, I and the noise "
        "are fitted as every model of an investigation is. Intervals are "
        f"{NORMAL_95:g} stated\nstandard deviations to either side; were errors normal, one in "
        f"2,000 would be larger than {record['far']:g}.",
        table(
            ["imposed", "intervals", "hold the truth", "95 % interval", "far off", "largest"],
            [
                _line("torque", [r for r in own if r["imposed"] == "torque"]),
                _line("angle", [r for r in own if r["imposed"] == "angle"]),
                _line(
                    "torque, taken to be straight in all",
                    [r for r in rows if r["way"] == "straight"],
                ),
            ],
        ),
        "*Far off* are errors of more than that many stated standard deviations; *largest* is in "
        "these.\nThe last row is a control: a recorder of 100 or 200 Hz may have seen a torque "
        "that ran smooth\nbetween its samples. Straight lines lose so little of it that least "
        "squares hardly tell, and many\nstandard deviations of K, B and I where the noise is slow.",
        "## By noise",
        table(
            [
                "imposed",
                "noise",
                "intervals",
                "hold the truth",
                "95 % interval",
                "far off",
                "largest",
                "median error",
            ],
            [
                [
                    r["imposed"],
                    r["noise"],
                    str(r["n"]),
                    percent(r["covered"] / r["n"]),
                    _interval(r["interval"]),
                    str(r["far"]),
                    f"{r['largest']:.1f}",
                    f"{100 * r['error']:.2g} %",
                ]
                for r in own
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _line(name: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    n, covered, far = (sum(r[key] for r in rows) for key in ("n", "covered", "far"))
    largest = max((r["largest"] for r in rows), default=0.0)
    held = percent(covered / n) if n else ""
    return [name, str(n), held, _interval(wilson(covered, n)), str(far), f"{largest:.1f}"]


def _interval(ends: Sequence[float]) -> str:
    return f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f} %"
