"""Page of real recordings: what was found in each, and what it is known for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identifiability.benchmark.real import REAL, RealRecording
from identifiability.investigation.wording.verdict import (
    TITLES,
    model_in_words,
    percent,
    plain,
    set_in_words,
)
from identifiability.joint.parameters import plus_minus
from identifiability.provenance import made_by
from identifiability.report.across import across_sections
from identifiability.report.markdown import table

_ASIDE = ("instead", "nearest")  # models that are no step on the way to what is claimed


def recordings_list(states: Mapping[str, str] | None = None) -> str:
    """What is known, where it is from, and whether it is at hand, as text."""
    lines = []
    for one in REAL.values():
        state = f" [{states[one.name]}]" if states else ""
        lines += [
            f"{one.name}{state}: {one.title}",
            f"  file     {one.file}, SHA-256 {one.sha256}",
            f"  source   {one.source}",
            f"  licence  {one.licence}",
            f"  command  {one.command}",
            "",
        ]
    return "\n".join(lines).rstrip()


def recordings_page(
    found: Sequence[Mapping[str, Any]], by_rig: Mapping[str, Mapping[str, Any]] | None = None
) -> str:
    """Page in Markdown from the plain records of `benchmark.real.summary`, and of each rig."""
    by_name = {record["name"]: record for record in found}
    rows = [
        _row(one, by_name[one.name]) if one.name in by_name else [one.title, "not run", "", "", ""]
        for one in REAL.values()
    ]
    parts = [
        "# Real recordings",
        "Made by `identifiability recordings --folder FOLDER --out results`, by default settings. "
        "The files are\nnot shipped: `identifiability recordings` says where they are from, and "
        "checks them. E and VAF are of the\npart of each record that was not fitted.",
        table(
            ["recording", "known for", "verdict", "most probable", "VAF held out"],
            rows,
        ),
    ]
    for one in REAL.values():
        if one.name in by_name:
            parts += _section(one, by_name[one.name])
    for rig, record in (by_rig or {}).items():
        first = record["records"][0]["name"]
        parts += [f"## {rig}: several records of it", f"    {record['command']}"]
        parts += across_sections(record, f"recordings/{first}_rig.png")
        parts += [f"Made by {made_by(record)}."]
    return "\n\n".join(parts) + "\n"


def _row(one: RealRecording, record: Mapping[str, Any]) -> list[str]:
    if "failure" in record:
        return [one.title, one.known_for, f"failed: {record['failure']}", "", ""]
    vaf = [_vaf(model) for model in record["models"] if model["role"] not in _ASIDE]
    nearest = [_vaf(model) for model in record["models"] if model["role"] == "nearest"]
    most = record["posterior"][0] if record["posterior"] else None
    probable = (
        "" if most is None else f"{set_in_words(most['effects'])}, {percent(most['probability'])}"
    )
    return [
        one.title,
        one.known_for,
        TITLES[record["verdict"]["kind"]],
        probable,
        " → ".join(dict.fromkeys((vaf[0], vaf[-1])))
        + " %"
        + "".join(f" (nearest known {one} %)" for one in nearest),
    ]


def _section(one: RealRecording, record: Mapping[str, Any]) -> list[str]:
    parts = [
        f"## {one.title}",
        f"{one.source}; {one.licence}. SHA-256 `{one.sha256}`. Known for {one.known_for}.",
        f"    {one.command}",
    ]
    if "failure" in record:
        return [*parts, f"It could not be investigated: {record['failure']}."]
    parts += [
        f"**{TITLES[record['verdict']['kind']]}.** {record['verdict']['sentence']}",
        "\n".join(
            [
                *(f"- {reason}" for reason in record["because"]),
                *(
                    f"- Not done: {part} ({why})."
                    for part, why in record.get("failures", {}).items()
                ),
            ]
        ),
        table(
            ["model", "K", "B", "I", "its own", "E fitted", "E held out", "VAF held out [%]"],
            [_model(model) for model in record["models"]],
        ),
        f"Held out: {record['held_out']}. It took {record['seconds']:.0f} s; {made_by(record)}.",
        f"![responses](recordings/{one.name}.png)",
    ]
    return parts


def _model(model: Mapping[str, Any]) -> list[str]:
    values, sds, added = model["parameters"], model["sd"], model["added"]
    names = {
        "baseline": "K, B, I",
        "instead": f"{plain(added)} in its place",
        "nearest": f"nearest known: {model_in_words(model['effects'])}",
    }
    nearest = model["role"] == "nearest"
    own = ", ".join(
        f"{plain(name if nearest else name.split('.')[1])} {plus_minus(value, sds.get(name))}"
        for name, value in values.items()
        if (nearest and "." in name) or (added and name.startswith(f"{added}."))
    )
    return [
        names.get(model["role"], f"+ {plain(added)}"),
        *(plus_minus(values[name], sds.get(name)) for name in ("K", "B", "I")),
        own,
        f"{model['error_fit']:.3g}",
        "" if model["error_held_out"] is None else f"{model['error_held_out']:.3g}",
        _vaf(model),
    ]


def _vaf(model: Mapping[str, Any]) -> str:
    error = model["error_held_out"]
    return "" if error is None else f"{100 * (1 - error):.1f}"
