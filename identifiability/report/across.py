"""Page of several records of one joint: parameters by record, agreement, and predictions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.files import plain
from identifiability.investigation.across.agreement import Across
from identifiability.investigation.across.weighed import SetAcross
from identifiability.investigation.wording.across import across_sentences
from identifiability.investigation.wording.numbers import NATS
from identifiability.investigation.wording.verdict import percent
from identifiability.joint.parameters import plus_minus
from identifiability.provenance import stamp
from identifiability.report.markdown import number, table, words

_SETS = 8  # that are listed


def across_record(
    found: Across, weighed: Sequence[SetAcross] = (), *, command: str
) -> dict[str, Any]:
    """All that was found, as plain data."""
    return {
        "schema": 1,
        **stamp(
            "identifiability.investigation.across.agreement",
            "identifiability.investigation.across.weighed",
        ),
        "command": command,
        "sentences": list(across_sentences(found)),
        "effects": list(found.model.effect_keys),
        "posterior": [plain(one) for one in weighed],
        "records": [
            {
                "name": r.name,
                "values": r.values,
                "sds": r.sds,
                "log_evidence": r.log_evidence,
                "vaf": plain(r.vaf),
            }
            for r in found.records
        ],
        "parameters": [{**plain(one), "verdict": one.verdict} for one in found.parameters],
        "chi_square": found.chi_square,
        "degrees": found.degrees,
        "p": found.p,
        "failures": found.failures,
    }


def across_text(record: Mapping[str, Any]) -> str:
    """What a terminal shows."""
    lines = [*record["sentences"], ""]
    for one in record["posterior"][:_SETS]:
        lines.append(f"  {_set(one):<60}{percent(one['probability']):>18}")
    lines += [""] if record["posterior"] else []
    names = [r["name"] for r in record["records"]]
    lines.append(f"{'parameter':<34}" + "".join(f"{n:>24.22}" for n in names) + f"{'all':>24}")
    for one in record["parameters"]:
        head, *cells, last, _, verdict = _row(one, record["records"])
        mark = " !" if verdict == "differ" else ""
        lines.append(f"{head:<34}" + "".join(f"{c:>24}" for c in cells) + f"{last + mark:>24}")
    return "\n".join(lines)


def across_page(record: Mapping[str, Any], picture: str) -> str:
    """The page, in Markdown, with the path of its figure."""
    parts = ["# One joint, several records", f"`{record['command']}`"]
    return "\n\n".join([*parts, *across_sections(record, picture)]) + "\n"


def across_sections(record: Mapping[str, Any], picture: str) -> list[str]:
    """What is found, as parts of a page."""
    records = record["records"]
    names = [one["name"] for one in records]
    predicted = [
        [one["name"], *(_vaf(one["vaf"][n]) for n in names), _nats(one["log_evidence"])]
        for one in records
    ]
    model = ", ".join(["K, B, I", *map(words, record["effects"])])
    return [
        " ".join(record["sentences"]),
        *_weighed(record["posterior"], names),
        f"Model: {model}; fitted to each record alone with the noise of each, then to all together "
        "with what should be the same shared. ± is one standard deviation; p is the chance that "
        "sharing a parameter costs so much likelihood, if it were the same.",
        table(
            ["parameter", *names, "all records", "p", ""],
            [_row(one, records) for one in record["parameters"]],
        ),
        f"Over all that should be the same: chi-square {number(record['chi_square'])} with "
        f"{record['degrees']} degrees of freedom, p = {number(record['p'], 2)}.",
        "Each record predicted by the fits of all, K and B carried over too: variance accounted "
        "for [%]; at last the log evidence of the effects in the record itself, above K, B and I "
        f"alone [nats]. {NATS}",
        table(["record", *(f"by {n}" for n in names), "evidence"], predicted),
        f"![Parameters by record]({picture})",
    ]


def _row(one: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> list[str]:
    shared = one["shared"]
    return [
        f"{words(one['name'])} [{one['unit']}]",
        *(plus_minus(r["values"][one["name"]], r["sds"].get(one["name"])) for r in records),
        plus_minus(one["value"], one["sd"]) if shared else "may differ",
        number(one["p"], 2) if shared and one["n"] > 1 else "",
        one["verdict"] if shared else "",
    ]


def _weighed(weighed: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[str]:
    """What may be missing, by the evidence of all records."""
    if not weighed:
        return []
    rows = [
        [_set(one), percent(one["probability"]), *(_nats(one["by_record"][n]) for n in names)]
        for one in weighed[:_SETS]
    ]
    return [
        "What may be missing, by all records together; of each its log evidence above K, B and I "
        f"alone [nats]. {NATS} The sets are those that came near in any record; that something "
        "unknown is missing in all is not weighed.",
        table(["missing", "probability", *names], rows),
    ]


def _set(one: Mapping[str, Any]) -> str:
    return ", ".join(map(words, one["effects"])) or "nothing"


def _vaf(value: float | None) -> str:
    return f"{value:.2f}" if value is not None and value > -1e3 else "diverges"


def _nats(value: float | None) -> str:
    return "no fit" if value is None or not math.isfinite(value) else number(value)
