"""Page of the effects that are known: equation, typical values, sources, look-alikes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping

from identifiability.joint.effects import Effect
from identifiability.report.markdown import table, words

_PLACES = {
    "joint": "acts on the joint, beside everything else that spans it",
    "muscle": "acts in the muscle, beside K and B, and like them in series with a tendon",
    "series": "stands between the muscle and the joint",
    "coupling": "stands between what is driven and measured and the limb, of which K, B and all "
    "other effects are",
    "sensor": "is in the recorder, not in the joint",
}


def effects_page(
    effects: Mapping[str, type[Effect]], descriptions: Mapping[str, type[Effect]]
) -> str:
    """Page in Markdown.

    Parameters
    ----------
    effects : mapping of str to type of Effect
        Those that may be named.
    descriptions : mapping of str to type of Effect
        Those that describe what has no one mechanism, and count as unknown.
    """
    parts = [
        "# The effects that are known",
        "Made by `identifiability effects --out docs` from the classes themselves. An effect of "
        "your own is one\nmore such class ([example](../notebooks/06_your_own_effect.ipynb)).",
        "![where each effect stands](joint.svg)",
        "*Where each effect stands: K and B are the muscle's, I the limb's; torque and angle are "
        "those of the apparatus.*",
        "![what each effect does to a pulse and a step](effects.svg)",
        "*One joint (K 30 Nm/rad, B 1 Nms/rad, I 0.1 kg m²), without and with every effect at its "
        "typical values. Beside its\nlook-alikes, in both experiments, each of them is in "
        "[a notebook](../notebooks/08_gallery_of_effects.ipynb).*",
    ]
    for kind in effects.values():
        parts += _section(kind, effects)
    parts += [
        "# Descriptions of something unknown",
        "They fit what several mechanisms do alike. Where one of them is most probable the verdict "
        "says that\nsomething unknown is missing, and which of them it is like.",
    ]
    for kind in descriptions.values():
        parts += _section(kind, {**effects, **descriptions})
    return "\n\n".join(parts) + "\n"


def _section(kind: type[Effect], known: Mapping[str, type[Effect]]) -> list[str]:
    rows = [
        [
            words(p.name),
            f"${p.symbol}$",
            "" if p.unit == "1" else p.unit,
            f"{p.nominal:g}",
            f"{p.lower:g} to {p.upper:g}",
            p.description,
        ]
        for p in kind.parameters
    ]
    parts = [
        f"## {words(kind.key).capitalize()}: {kind.title}",
        f"`{kind.key}`; it {_PLACES[kind.place]}.",
        _markdown(inspect.getdoc(kind) or ""),
        table(["parameter", "symbol", "unit", "typical", "bounds", "what it is"], rows),
    ]
    notes = []
    if same := [words(key) for key in kind.equivalent if key in known]:
        notes.append(f"Torque and angle can never tell it from: {', '.join(same)}.")
    alike = [words(k) for k in kind.confused_with if k in known and k not in kind.equivalent]
    if alike:
        notes.append(f"Looks alike in short records: {', '.join(alike)}.")
    notes += [f"Source: {reference}." for reference in kind.references]
    return [*parts, "\n".join(f"- {note}" for note in notes)] if notes else parts


def _equation(found: re.Match[str]) -> str:
    lines = " ".join(found[1].split())
    return f"$$\\begin{{aligned}}{lines}\\end{{aligned}}$$" if "&" in lines else f"$${lines}$$"


def _markdown(text: str) -> str:
    """A docstring's text, its equations as Markdown writes them."""
    text = text.split("\n\nParameters\n---")[0].split("\n\nAttributes\n---")[0]
    text = re.sub(r"\.\. math::\s*(.+?)(?=\n\n|\Z)", _equation, text, flags=re.DOTALL)
    text = re.sub(r":math:`([^`]+)`", r"$\1$", text)
    return text.replace("``", "`")
