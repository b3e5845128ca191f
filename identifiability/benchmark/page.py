"""Summary of a benchmark: rates with intervals, the confusion matrix, every case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from identifiability.benchmark.score import OUTCOMES, Score, wilson
from identifiability.provenance import package_version

_TIERS = {
    "singles": "one effect",
    "pairs": "two or three effects",
    "unknown": "an effect that is not in the library",
    "controls": "no effect: only noise of several kinds, or variation from trial to trial",
    "nulls": "no effect: only white noise",
    "quick": "some of each, six short trials",
}


def summary(scores: Sequence[Score], *, seed: int, tried: int) -> dict[str, Any]:
    """Plain record of a benchmark.

    Parameters
    ----------
    scores : sequence of Score
    seed : int
    tried : int
        Number of cases that the tiers hold.
    """
    tiers = {}
    for tier in dict.fromkeys(s.tier for s in scores):
        for weak in (False, True):
            mine = [s for s in scores if s.tier == tier and s.weak is weak]
            if mine:
                tiers[f"{tier}{', weak' if weak else ''}"] = _tier(mine)
    return {
        "schema": 1,
        "package": package_version(),
        "seed": seed,
        "cases_run": len(scores),
        "cases_in_tiers": tried,
        "tiers": tiers,
        "cases": [s.to_dict() for s in scores],
    }


def _tier(scores: Sequence[Score]) -> dict[str, Any]:
    n = len(scores)
    counts = Counter(s.outcome for s in scores)
    found = sum(counts[o] for o in ("right", "right among others"))
    false = counts["wrong"]
    picks = [s.first_pick for s in scores if s.first_pick is not None]
    removed = sorted(s.removed for s in scores if s.removed is not None)
    named = [s for s in scores if s.outcome in ("right", "right among others", "partly", "wrong")]
    return {
        "n": n,
        "outcomes": {o: counts[o] for o in OUTCOMES},
        "right": found,
        "right_interval": wilson(found, n),
        "wrong": false,
        "wrong_interval": wilson(false, n),
        "first_pick": sum(picks),
        "first_pick_of": len(picks),
        "first_pick_interval": wilson(sum(picks), len(picks)),
        "named": len(named),
        "median_removed": removed[len(removed) // 2] if removed else None,
        "median_seconds": sorted(s.seconds for s in scores)[n // 2],
    }


def page(record: dict[str, Any]) -> str:
    """Page in Markdown from the plain record."""
    lines = [
        "# Hidden effects: what the investigation found",
        "",
        "Made by `identifiability benchmark investigation --out results`; the data come from an",
        "independent simulator (SciPy, tight tolerances, partly other equations than the",
        "library's).",
        f"{record['cases_run']} of {record['cases_in_tiers']} cases were run"
        f" (seed {record['seed']}, version {record['package']}).",
        "",
        "*Right*: every hidden effect named and nothing else, alone or in a set that the data",
        "cannot tell apart; where nothing is hidden, or nothing known, that this was said.",
        "*Wrong*: something was named that is not there. Intervals are Wilson's, 95 %.",
        "",
        "| tier | cases | right | wrong | first pick right | misfit removed, median | s, median |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, t in record["tiers"].items():
        removed = "" if t["median_removed"] is None else f"{100 * t['median_removed']:.1f} %"
        first = (
            f"{t['first_pick']}/{t['first_pick_of']} {_span(t['first_pick_interval'])}"
            if t["first_pick_of"]
            else ""
        )
        lines.append(
            f"| {name} | {t['n']} | {t['right']} {_span(t['right_interval'])} | {t['wrong']} "
            f"{_span(t['wrong_interval'])} | {first} | {removed} | {t['median_seconds']:.0f} |"
        )
    lines += [
        "",
        *(f"*{key}*: {text}." for key, text in _TIERS.items() if _has(record, key)),
        "",
        "*Weak*: an effect hides below three times the noise when the model is fitted without it.",
        "",
        "![confusion matrix](investigation/confusion.png)",
        "",
        "## Every case",
        "",
        "| case | hidden | verdict | named | outcome | s |",
        "|---|---|---|---|---|---|",
    ]
    for s in record["cases"]:
        truth = ", ".join(s["truth"]) or s["kind"]
        named = "; ".join(" or ".join(members) for members in s["named"])
        weak = " (weak)" if s["weak"] else ""
        verdict = s["verdict"] or s["failure"]
        lines.append(
            f"| {s['name']} | {truth}{weak} | {verdict} | {named} | {s['outcome']} | "
            f"{s['seconds']:.0f} |"
        )
    return "\n".join(lines) + "\n"


def _has(record: dict[str, Any], tier: str) -> bool:
    return any(name.split(",")[0] == tier for name in record["tiers"])


def _span(interval: Sequence[float]) -> str:
    low, high = interval
    return f"({100 * low:.0f}-{100 * high:.0f} %)"
