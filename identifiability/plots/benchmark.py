"""Confusion matrix of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from identifiability.benchmark.score import NAMING, Score
from identifiability.joint.effects import EFFECTS
from identifiability.palette import BLACK
from identifiability.plots.style import styled

_NOTHING = {
    "nothing_missing": "nothing missing",
    "unrepeatable": "unrepeatable",
    "unknown_static": "unknown",
    "unknown_memory": "unknown",
    "measurement": "the measurement",
    "": "no verdict",
}

_SURPLUS = "nothing more"


def confusion_figure(scores: Sequence[Score]) -> Figure:
    """What was hidden against what was named first for it; cells hold numbers of effects.

    A hidden effect that is in one of the verdict's sets counts as named, even if another of the set
    comes first. What was named besides stands for the other hidden effects in turn, or for nothing.
    """
    pairs = [pair for s in scores for pair in _pairs(s)]
    known = list(EFFECTS)
    hidden = dict.fromkeys(p[0] for p in pairs)
    rows = [k for k in known if k in hidden] + [k for k in hidden if k not in known]
    rows.sort(key=lambda k: k == _SURPLUS)
    ends = ["not named", *dict.fromkeys(_NOTHING.values())]
    columns = [k for k in (*known, *ends) if any(p[1] == k for p in pairs)]
    counts = np.zeros((len(rows), len(columns)), int)
    for truth, named in pairs:
        counts[rows.index(truth), columns.index(named)] += 1
    with styled():
        figure = Figure(figsize=(0.5 * len(columns) + 3.6, 0.42 * len(rows) + 3.2))
        axes = figure.subplots()
        shown = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        axes.imshow(shown, cmap="Blues", vmin=0, vmax=1.4, aspect="auto")
        for (i, j), n in np.ndenumerate(counts):
            if n:
                axes.text(j, i, str(n), ha="center", va="center", color=BLACK, fontsize=10)
        names = [c.replace("_", " ") for c in columns]
        axes.set_xticks(range(len(columns)), names, rotation=50, ha="right")
        axes.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows])
        axes.set_xlabel("named (the hidden effect, if it is in the verdict's set)")
        axes.set_ylabel("hidden")
    return figure


def _pairs(score: Score) -> list[tuple[str, str]]:
    """Hidden effect and name given to it, for all that is hidden or named in a case."""
    left = [list(members) for members in score.named] if score.verdict in NAMING else []
    pairs, missed = [], []
    for truth in score.truth or (score.kind,):
        mine = next((m for m in left if truth in m), None)
        if mine is None:
            missed.append(truth)
        else:
            left.remove(mine)
            pairs.append((truth, truth))
    for truth in missed:
        named = left.pop(0)[0] if left else _NOTHING.get(score.verdict, "not named")
        pairs.append((truth, named))
    return pairs + [(_SURPLUS, members[0]) for members in left]
