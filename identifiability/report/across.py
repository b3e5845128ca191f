"""Page of several records of one joint: parameters by record, agreement, and predictions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from identifiability.files import plain
from identifiability.investigation.across.agreement import Across
from identifiability.investigation.across.weighed import SetAcross
from identifiability.investigation.wording.across import across_sentences
from identifiability.investigation.wording.verdict import percent
from identifiability.joint.parameters import plus_minus
from identifiability.provenance import stamp
from identifiability.report.markdown import number, table, words

_SETS = 8  # that are listed


def across_text(found: Across, weighed: Sequence[SetAcross] = ()) -> str:
    """What a terminal shows."""
    names = [record.name for record in found.records]
    lines = [*across_sentences(found), ""]
    for row in weighed[:_SETS]:
        lines.append(f"  {_set(row):<60}{percent(row.probability):>18}")
    lines += [""] if weighed else []
    lines.append(f"{'parameter':<34}" + "".join(f"{n:>24.22}" for n in names) + f"{'all':>24}")
    for one in found.parameters:
        cells = [plus_minus(r.values[one.name], r.sds.get(one.name)) for r in found.records]
        last = plus_minus(one.value, one.sd) if one.shared else "may differ"
        head = f"{words(one.name)} [{one.unit}]"
        mark = " !" if one.shared and one.verdict == "differ" else ""
        lines.append(f"{head:<34}" + "".join(f"{c:>24}" for c in cells) + f"{last + mark:>24}")
    return "\n".join(lines)


def across_page(found: Across, weighed: Sequence[SetAcross] = (), *, command: str) -> str:
    """The page, in Markdown."""
    names = [record.name for record in found.records]
    rows = [
        [
            f"{words(one.name)} [{one.unit}]",
            *(plus_minus(r.values[one.name], r.sds.get(one.name)) for r in found.records),
            plus_minus(one.value, one.sd) if one.shared else "may differ",
            f"{number(one.p, 2)}" if one.n > 1 else "",
            one.verdict if one.shared else "",
        ]
        for one in found.parameters
    ]
    predicted = [
        [of.name, *(_vaf(of.vaf[by]) for by in names), number(of.log_evidence)]
        for of in found.records
    ]
    model = " + ".join(["K, B, I", *map(words, found.model.effect_keys)])
    return "\n".join(
        [
            "# One joint, several records",
            "",
            f"`{command}`",
            "",
            *across_sentences(found),
            "",
            *_weighed(weighed, names),
            f"Model: {model}, fitted to each record alone with the noise of each, then to all "
            "together with what should be the same shared; ± is one standard deviation. p is the "
            "chance that sharing a parameter costs so much likelihood, if it were the same.",
            "",
            table(["parameter", *names, "all records", "p", ""], rows),
            "",
            f"Over all that should be the same: chi-square {number(found.chi_square)} with "
            f"{found.degrees} degrees of freedom, p = {number(found.p, 2)}.",
            "",
            "## Each record predicted by the fits of the others",
            "",
            "Variance accounted for [%], K and B carried over too; at last the log evidence of the "
            "model's effects in the record itself, above K, B and I alone [nats].",
            "",
            table(["record", *(f"by {n}" for n in names), "evidence"], predicted),
            "",
            "![Parameters by record](across.svg)",
            "",
        ]
    )


def across_record(
    found: Across, weighed: Sequence[SetAcross] = (), *, command: str
) -> dict[str, Any]:
    """The same as plain data."""
    return {
        "schema": 1,
        **stamp(
            "identifiability.investigation.across.agreement",
            "identifiability.investigation.across.weighed",
        ),
        "command": command,
        "effects": list(found.model.effect_keys),
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
        "posterior": [plain(one) for one in weighed],
    }


def _vaf(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) and value > -1e3 else "diverges"


def _set(one: SetAcross) -> str:
    return ", ".join(map(words, one.effects)) or "nothing"


def _weighed(weighed: Sequence[SetAcross], names: Sequence[str]) -> list[str]:
    """What may be missing, by the evidence of all records."""
    if not weighed:
        return []
    rows = [
        [_set(one), percent(one.probability), *(_nats(one.by_record[n]) for n in names)]
        for one in weighed[:_SETS]
    ]
    return [
        "What may be missing, by all records together; of each its log evidence above K, B and I "
        "alone [nats]. The sets are those that came near in any record; that something unknown is "
        "missing in all is not weighed.",
        "",
        table(["missing", "probability", *names], rows),
        "",
    ]


def _nats(value: float) -> str:
    return number(value) if math.isfinite(value) else "no fit"
