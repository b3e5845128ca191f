"""Page of the responses' benchmark: machine code beside JAX."""

from __future__ import annotations

from typing import Any


def responses_page(record: dict[str, Any]) -> str:
    """Page in Markdown from the plain record of ``benchmark.responses``."""
    rows = record["rows"]
    worst = max(r["difference"] for r in rows)
    lines = [
        "# Responses: machine code beside JAX",
        "",
        "Made by `identifiability benchmark responses --out results`. The response of one trial",
        f"of {record['samples']} samples at {record['rate']} Hz and its derivatives by all",
        "parameters, at one parameter vector, in the steps that a fit takes. Both ways run one",
        "after the other in one process, the quickest of several calls counts. *Once* is what the",
        "model costs before its first evaluation: JAX keeps that on disk for recordings of one",
        "length, machine code is made anew and serves all lengths and both causalities.",
        "",
        f"Over all {len(rows)} rows machine code costs {record['once']:.1f} s once, JAX"
        f" {record['once_jax']:.0f} s. An evaluation by JAX takes {record['median_each']:.1f} times"
        f" as long (median; at least {record['least_each']:.1f}). The largest difference of the two"
        f" is {worst:.0e} of the largest value.",
        "",
        "| effects | imposed | steps | derivatives | once [ms] | JAX [ms] | each [ms] | JAX [ms] "
        "| ratio |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        names = ", ".join(key.replace("_", " ") for key in r["effects"]) or "none"
        lines.append(
            f"| {names} | {r['imposed']} | {r['scheme']} | {r['n_parameters']} "
            f"| {1e3 * r['once']:.0f} | {1e3 * r['once_jax']:.0f} | {1e3 * r['each']:.2f} "
            f"| {1e3 * r['each_jax']:.2f} | {r['each_jax'] / r['each']:.1f} |"
        )
    return "\n".join(lines) + "\n"
