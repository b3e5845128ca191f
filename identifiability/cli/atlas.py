"""``identifiability atlas``: quadratic widths against posteriors, over a grid of joints."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "atlas",
        help="where quadratic widths hold, over a grid of musculoskeletal models",
        description="Compare quadratic (Hessian) widths of K, B and I with sampled posteriors over "
        "a grid of musculoskeletal models, perturbations, durations and noise. An interrupted run "
        "goes on where it was when the same command is typed again.",
    )
    parser.add_argument(
        "config",
        nargs="?",
        type=Path,
        metavar="CONFIG.toml",
        help='lists K_CE, B_CE, ratio, T, perturbations, readings; grid = "paper" for the whole '
        "paper; corner = [[K_CE, B_CE, K_SE, I], ...]; seed, dE, rate, correlation_time. Without "
        "it: a coarse grid that spans the paper's",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results")
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes (default: one per processor)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.cli.main import PARTIAL
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.plots.atlas import maps
    from identifiability.plots.style import save
    from identifiability.study.atlas import read_plan, run_atlas
    from identifiability.study.atlas_page import page
    from identifiability.study.atlas_record import record
    from identifiability.study.store import to_dataset, write_atlas

    if options.workers is not None and options.workers < 1:
        raise InputError(f"found {options.workers} workers, expected 1 or more")
    plan = read_plan(options.config)
    out = output_folder(options.out)
    how = {"workers": options.workers}

    outcomes = run_atlas(plan, out / "atlas.cells", **how)
    data = to_dataset(plan, outcomes)
    write_atlas(data, out / "atlas.nc")
    corners, corner_outcomes = _corners(plan, out, how)
    figures = []
    for found in maps(data):
        path = save(found.draw(), out / "atlas" / f"{found.stem}.png")
        figures.append({"file": path.relative_to(out).as_posix(), "caption": found.caption})
    command = ["identifiability", "atlas", *([str(options.config)] if options.config else [])]
    summary = record(
        data,
        command=shlex.join([*command, "--out", str(options.out)]),
        figures=figures,
        corners=corners,
    )
    write_json(out / "atlas.json", summary)
    write_text(out / "atlas.md", page(summary))

    for group in summary["verdicts"]:
        counts = ", ".join(f"{verdict} {n}" for verdict, n in group["counts"].items())
        print(f"{group['reading']}, T = {1000 * group['T']:g} ms, {group['of']} cells: {counts}")
    print(f"written: {out / 'atlas.md'}, {out / 'atlas.json'}, {out / 'atlas.nc'}, {out / 'atlas'}")
    return PARTIAL if _complain({**outcomes, **corner_outcomes}, out / "atlas.cells") else 0


def _corners(
    plan: Any, out: Path, how: Mapping[str, Any]
) -> tuple[list[dict[str, str]], Mapping[str, Any]]:
    """Draw the corner plots in worker processes, where they can fail without harm."""
    from identifiability.files import replacing
    from identifiability.plots.atlas import CORNER_SCHEMA, corner_plot
    from identifiability.study.sweep import sweep

    cells = {corner.stem: corner for corner in plan.corners()}
    outcomes = sweep(
        corner_plot,
        cells,
        folder=out / "atlas.cells",
        label="corner plots",
        schema=CORNER_SCHEMA,
        progress=bool(cells),
        **how,
    )
    drawn = []
    for stem, outcome in outcomes.items():
        if outcome.arrays is None:
            continue
        path = out / "atlas" / f"{stem}.png"
        with replacing(path) as temporary:
            temporary.write_bytes(outcome.arrays["png"].tobytes())
        drawn.append(
            {
                "file": path.relative_to(out).as_posix(),
                "caption": cells[stem].caption,
                "verdict": str(outcome.arrays["verdict"]),
                "reason": str(outcome.arrays["reason"]),
            }
        )
    return drawn, outcomes


def _complain(outcomes: Mapping[str, Any], folder: Path) -> bool:
    """Say in a sentence what has failed, if anything has."""
    failed = [outcome for outcome in outcomes.values() if outcome.status != "done"]
    if failed:
        first = failed[0]
        print(
            f"identifiability: {len(failed)} of {len(outcomes)} tasks have no result (the first, "
            f"{first.name}: {first.cause}); {folder / 'log.jsonl'} says more, and the same command "
            "tries them again",
            file=sys.stderr,
        )
    return bool(failed)
