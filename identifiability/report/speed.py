"""Page of the benchmark of speed: samplers side by side, and what a cell of the atlas costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from identifiability.benchmark.speed import BASE, OWN, Scaling
from identifiability.provenance import made_by

_APART = 3.0  # Monte Carlo errors from the quadrature
_MARK_MEDIAN, _MARK_LEAST, _MARK_CELL, _MARK_BARE = 200.0, 20.0, 0.1, 3.0
_MARK_TWO, _MARK_MEMORY, _MARK_GRID = 1.7, 2048.0, 10.0


def speed_page(record: dict[str, Any]) -> str:
    """Page in Markdown from the plain record of ``benchmark.speed``."""
    rows = record["rows"]
    names = list(rows[0]["samplers"])
    versions = ", ".join(f"{name} {v}" for name, v in record["libraries"].items())
    lines = [
        "# Speed: effective draws a second, and what a cell costs",
        "",
        f"Made by `identifiability benchmark speed --seed {record['seed']} --out results`",
        f"({made_by(record)}), one thing after another in one process. {len(rows)} cells of the",
        "atlas that span the paper's grid: three stiffnesses, dampings and durations of the",
        "muscle, with tendons, perturbations and readings of the noise in turn. All samplers",
        "have the same likelihood: machine code, for as many points at once as they ask for;",
        "NumPyro has the same equations by JAX, what it compiles is not counted, and it is asked",
        "for few of the cells. All but",
        "nested sampling, which starts from the prior, start at the optimum. Seconds are of a",
        "processor; of the effective draws the parameter with fewest counts.",
        "",
        "## Samplers",
        "",
        *_summary(rows),
        "",
        "| sampler | effective draws a second | this package, times as many | converged "
        f"| a width off by {_APART:g} of its errors | largest error of a width |",
        "|---|---|---|---|---|---|",
    ]
    for name in names:
        timed = [r for r in rows if name in r["samplers"]]
        every = [r["samplers"][name] for r in timed]
        apart = sum(one["apart"] > _APART for one in every)
        lines.append(
            f"| {name} | {_range([_rate(one) for one in every], _whole)} "
            f"| {_range(_ratios(timed, name), _whole) if name != OWN else '1'} "
            f"| {sum(one['converged'] for one in every)} of {len(every)} | {apart} of {len(every)} "
            f"| {100 * max(one['off'] for one in every):.1f} % |"
        )
    lines += [
        "",
        "Each figure is the median of the cells, with the least and the most. *Converged*: by the",
        "limits that this package's own draws have to meet (R-hat below 1.01 and 400 effective",
        "draws, across chains; nested sampling ends by itself). Widths are compared with those of",
        f"a finer quadrature. Libraries: {versions or 'none besides'}.",
        "",
        "## A cell of the atlas",
        "",
        f"Fit, three readings of the Hessian, profiles, posterior with {record['enough']:.0f}",
        "effective draws or more, quadrature and verdict; the quickest of three, with nothing left",
        "to compile.",
        "",
        "| part | seconds of a processor | share |",
        "|---|---|---|",
    ]
    whole = float(np.median([r["stages"]["whole"] for r in rows]))
    for part in rows[0]["stages"]:
        every = [r["stages"][part] for r in rows]
        share = f"{100 * float(np.median(every)) / whole:.0f} %"
        lines.append(f"| {part} | {_range(every, _thousandths)} | {share} |")
    lines += ["", *_scaled(Scaling(**record["scaling"]))]
    lines += ["", "## Every cell", "", *_every(rows)]
    return "\n".join(lines) + "\n"


def _summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What came out, beside what was aimed at."""
    ratios = _ratios(rows, BASE)
    whole = [r["stages"]["whole"] for r in rows]
    over = [r["samplers"][OWN]["seconds"] / (r["own_evaluations"] * r["bare"]) for r in rows]
    return [
        f"- Against {BASE}: **{np.median(ratios):.0f} times** as many effective draws a second in",
        f"  the median, {min(ratios):.0f} times at least (aim: {_MARK_MEDIAN:.0f} and"
        f" {_MARK_LEAST:.0f}).",
        f"- A cell of the atlas takes **{np.median(whole):.3f} s** of a processor in the median,",
        f"  {max(whole):.3f} s at most (aim: {_MARK_CELL:g}).",
        f"- Sampling takes {np.median(over):.1f} times as long as the likelihoods that it asks for",
        f"  would alone (aim: {_MARK_BARE:g}); the rest is the proposal, emcee's own steps, and",
        "  the diagnostics of the draws.",
    ]


def _scaled(found: Scaling) -> list[str]:
    """What many cells take."""
    grid = 13_500
    return [
        f"{found.few} cells take one worker {found.few_by_one:.1f} s, {found.many} take"
        f" {found.many_by_one:.1f} s and two workers {found.many_by_two:.1f} s: {found.start:.1f} s"
        f" to start, and {found.each:.3f} s for each cell more. Two workers do {found.by_two:.2f}",
        f"times as much as one (aim: {_MARK_TWO:g}), and one takes {found.memory:.0f} MiB (aim:"
        f" below {_MARK_MEMORY:.0f}). The {grid:,} cells of the paper's grid in one reading of the"
        f" noise would take two workers {_minutes(found, grid):.0f} minutes (aim:"
        f" {_MARK_GRID:.0f}).",
    ]


def _minutes(found: Scaling, n: int) -> float:
    return (found.start + n * found.each / found.by_two) / 60


def _every(rows: Sequence[dict[str, Any]]) -> list[str]:
    lines = [
        "| cell | likelihood [µs] | effective draws a second | times emcee's | a cell [s] |",
        "|---|---|---|---|---|",
    ]
    for r, ratio in zip(rows, _ratios(rows, BASE), strict=True):
        lines.append(
            f"| {r['name']} | {1e6 * r['bare']:.2f} | {_whole(_rate(r['samplers'][OWN]))} "
            f"| {ratio:.0f} | {r['stages']['whole']:.3f} |"
        )
    return lines


def _rate(one: dict[str, Any]) -> float:
    return float(one["ess"] / one["seconds"])


def _ratios(rows: Sequence[dict[str, Any]], name: str) -> list[float]:
    """By cell, effective draws a second of this package's sampler over another's."""
    return [_rate(r["samplers"][OWN]) / _rate(r["samplers"][name]) for r in rows]


def _range(values: Sequence[float], said: Callable[[float], str]) -> str:
    return f"{said(float(np.median(values)))} ({said(min(values))} to {said(max(values))})"


def _whole(value: float) -> str:
    return f"{value:,.0f}"


def _thousandths(value: float) -> str:
    return f"{value:.3f}"
