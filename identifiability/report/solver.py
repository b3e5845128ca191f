"""Page of the solver's benchmark: error of the steps against effect and noise."""

from __future__ import annotations

from typing import Any


def solver_page(record: dict[str, Any]) -> str:
    """Page in Markdown from the plain record of ``benchmark.solver``."""
    rows, noises = record["rows"], record["noises"]
    failed = [r for r in rows if not r["passes"]]
    worst = max(rows, key=lambda r: r["error"])
    said = (
        f"All {len(rows)} rows are below it."
        if not failed
        else f"{len(failed)} of {len(rows)} rows are not below it: they are marked."
    )
    lines = [
        "# Integration: error of the steps against effect and noise",
        "",
        "Made by `identifiability benchmark solver --out results`. Every effect of the",
        "registry that is not linear, and every instrument with a memory, at nominal and at fast",
        "parameters, is computed in the steps that a fit takes (an instrument sees the response",
        "once a millisecond at least), and in at least sixteen times as many. All numbers are",
        "errors E (Eq. 3). *Half the step* is the error as the package knows it, by half the step;",
        "*error* is by the fine ones; *effect* is that of the joint without the effect. Noise",
        f"typically leaves an E of {' or '.join(f'{n:g}' for n in noises)}; a tenth of the smaller",
        f"({record['allowed']:g}) is allowed. {said} The largest error is {worst['error']:.1e}"
        f" ({worst['effect'].replace('_', ' ')}, {worst['speed']}, {worst['rate']} Hz,"
        f" imposed {worst['imposed']}).",
        "",
        "| effect | parameters | Hz | imposed | at first | taken | half the step | error | effect "
        "| error / noise of 1e-4 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        mark = "" if r["passes"] else " **too large**"
        lines.append(
            f"| {r['effect'].replace('_', ' ')} | {r['speed']} | {r['rate']} | {r['imposed']} "
            f"| {r['apriori']} | {r['scheme']} | {r['halved']:.1e} | {r['error']:.1e}{mark} "
            f"| {r['size']:.1e} | {r['error'] / min(noises):.1e} |"
        )
    lines += ["", "Fast parameters, where they differ from the nominal ones:", ""]
    for key, values in record["fast"].items():
        told = ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in values.items())
        lines.append(f"- {key.replace('_', ' ')}: {told}")
    return "\n".join(lines) + "\n"
