"""Page of the calibration benchmark: whether probabilities are what they say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.provenance import made_by
from identifiability.report.markdown import percent, table


def calibration_page(record: Mapping[str, Any]) -> str:
    """Page in Markdown from the plain record of `benchmark.seeds`."""
    claims, seeds = record["claims"], " ".join(map(str, record["seeds"]))
    low, high = claims["interval"]
    parts = [
        "# Calibration: whether the probabilities of an investigation are what they say",
        f"Made by `identifiability benchmark calibration --cases {record['cases']} "
        f"--seed {seeds} --out results`\n({made_by(record)}). Joints of all sizes with "
        "hidden effects from a simulator that shares no equations\nwith the library, torque or "
        "angle imposed, 100 to 1,000 Hz, short trials or one long record, eight\nkinds of noise "
        "(white, AR(1) of 0.9 and 0.99, random walk, hum, differenced, an encoder's rounding,\n"
        "both channels noisy), with 1e-5 to 1e-3 of the response's energy.",
        f"Effects were named in {claims['n']} cases, rightly in {claims['right']} of them "
        f"({100 * low:.0f} to {100 * high:.0f} %, Wilson's\n95 % interval). A name is given where "
        "its probability is 95 % or more.",
        *_by_seed(record["runs"]),
        "*Right*: all effects are named, alone or in a set; or nothing is, where nothing or "
        "something unknown\nis there. *Partly*: some are. *Wrong*: something false is named, or "
        "said to be unknown where nothing\nis. Of *right*, *partly* and *abstained* cases count "
        "whose effects are above three times the noise.",
        table(
            [
                "cases",
                "imposed",
                "n",
                "weak",
                "right",
                "95 % interval",
                "partly",
                "abstained",
                "wrong",
                "failed",
                "Brier",
                "log score",
            ],
            [
                [
                    t["tier"],
                    t["imposed"],
                    str(t["n"]),
                    str(t["weak"]),
                    str(t["right"]),
                    f"{100 * t['right_interval'][0]:.0f} to {100 * t['right_interval'][1]:.0f} %",
                    str(t["partly"]),
                    str(t["abstained"]),
                    str(t["wrong"]),
                    str(t["failed"]),
                    _number(t["brier"]),
                    _number(t["log_score"]),
                ]
                for t in record["tiers"]
            ],
        ),
        "Stated probabilities of all sets of effects, and how often those sets were the truth "
        "(effects of one\nform not told apart):",
        table(
            ["stated", "n", "mean", "true", "95 % interval"],
            [
                [
                    f"{percent(r['from'])} to {percent(r['to'])}",
                    str(r["n"]),
                    "" if r["stated"] is None else f"{100 * r['stated']:.1f} %",
                    str(r["true"]),
                    f"{100 * r['interval'][0]:.1f} to {100 * r['interval'][1]:.1f} %",
                ]
                for r in record["reliability"]
                if r["n"]
            ],
        ),
        "K, B and I where nothing is missing and that was claimed, and I where all effects were "
        "named; 95 %\nintervals by the curvature of the posterior (the hidden effects' equations "
        "are not the library's):",
        table(
            ["parameters", "intervals", "cover", "95 % interval", "median error", "largest"],
            [
                [
                    "I, effects named" if j["effects"] else "K, B, I, nothing missing",
                    str(j["n"]),
                    str(j["covered"]),
                    f"{100 * j['interval'][0]:.0f} to {100 * j['interval'][1]:.0f} %",
                    percent(j["error"]),
                    percent(j["largest_error"]),
                ]
                for j in record["joint"]
                if j["n"]
            ],
        ),
        *_missed(
            [
                (run["seed"], s)
                for run in record["runs"]
                for s in run["scores"]
                if s["outcome"] in ("wrong", "failed")
            ]
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _by_seed(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Every seed as it came out."""
    rows = []
    for run in runs:
        outcomes = [s["outcome"] for s in run["scores"]]
        low, high = run["claims"]["interval"]
        rows.append(
            [
                str(run["seed"]),
                str(len(outcomes)),
                f"{run['claims']['right']} of {run['claims']['n']}",
                f"{100 * low:.0f} to {100 * high:.0f} %",
                *(
                    str(outcomes.count(kind))
                    for kind in ("right", "partly", "abstained", "wrong", "failed")
                ),
            ]
        )
    head = ["seed", "cases", "names right", "95 % interval"]
    head += ["right", "partly", "abstained", "wrong", "failed"]
    return ["By seed, weak effects counted too:", table(head, rows)]


def _missed(scores: Sequence[tuple[int, Mapping[str, Any]]]) -> list[str]:
    """Cases that went wrong, or failed, with their seed."""
    if not scores:
        return ["No case went wrong, and none failed."]
    rows = [
        [
            str(seed),
            s["name"],
            f"{s['noise']}, {s['ratio']:g}",
            s["failure"] or "; ".join(" or ".join(names) for names in s["sets"]) or s["claim"],
            percent(s["probability"]),
        ]
        for seed, s in scores
    ]
    return [
        "Cases that went wrong, or failed:",
        table(["seed", "case", "noise", "claimed", "probability"], rows),
    ]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
