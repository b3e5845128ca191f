"""Page of the coverage benchmark: how often intervals of K, B and I hold the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from identifiability.inference.curvature import NORMAL_95
from identifiability.provenance import made_by
from identifiability.report.markdown import percent, table


def coverage_page(record: Mapping[str, Any]) -> str:
    """Page in Markdown from the plain record of `benchmark.coverage`."""
    rows = record["rows"]
    low, high = record["mark"]
    inside = [r for r in rows if low <= r["covered"] / r["n"] <= high]
    # Chance alone moves a coverage that is right: what its interval excludes is not chance.
    off = [r for r in rows if r["interval"][1] < low or r["interval"][0] > high]
    failed = sum(r["failed"] for r in rows if r["name"] == "K")
    parts = [
        "# Coverage: how often 95 % intervals of K, B and I hold the truth",
        f"Made by `identifiability benchmark coverage --recordings {record['recordings']} "
        f"--seed {record['seed']} --out results`\n({made_by(record)}): "
        f"{record['recordings']} simulated recordings a row, of joints that are exactly K, B\n"
        "and I, at 100 to 1,000 Hz, half of them six short trials, half one record of 8 s, fitted\n"
        "as `identifiability fit` does. Noise is in the response, 1 to 5 % of its scatter;\n"
        "*encoder* rounds the angle to 1/400 of its stroke; *both channels* adds white noise to\n"
        f"what was imposed too. Intervals are {NORMAL_95:g} stated standard deviations to either "
        "side.",
        f"{len(inside)} of {len(rows)} rows lie within {percent(low)} to {percent(high)}; "
        f"{len(off)} lie outside by more than chance\nexplains (Wilson's 95 % interval of the "
        f"coverage does not reach the range). {failed} fits failed.",
        "*Bias* and *scatter* are mean and standard deviation of the error in stated standard "
        "deviations:\n0 and 1 where these are right. *Width* is the median stated standard "
        "deviation.",
        table(
            ["noise", "imposed", "", "covered", "95 % interval", "bias", "scatter", "width"],
            [
                [
                    r["kind"],
                    r["imposed"],
                    r["name"],
                    percent(r["covered"] / r["n"]) + (" **off**" if r in off else ""),
                    f"{100 * r['interval'][0]:.1f} to {100 * r['interval'][1]:.1f} %",
                    f"{r['bias']:+.2f}",
                    f"{r['scatter']:.2f}",
                    percent(r["width"]),
                ]
                for r in rows
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"
