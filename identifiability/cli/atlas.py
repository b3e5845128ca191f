"""``identifiability atlas``: quadratic widths against posteriors, over a grid of joints."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from identifiability.cli.exits import PARTIAL, complain
from identifiability.cli.options import (
    add_out_option,
    with_examples,
)
from identifiability.cli.workers import add_workers_option, workers_of


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "atlas",
        help="where quadratic widths hold, over a grid of musculoskeletal models",
        description="Compare quadratic (Hessian) widths of K, B and I with sampled posteriors over "
        "a grid of musculoskeletal models, perturbations, durations and noise. An interrupted run "
        "goes on where it was when the same command is typed again.",
        **with_examples(
            "atlas --out coarse",
            "atlas paper --out results",
        ),
    )
    parser.add_argument(
        "config",
        nargs="?",
        type=Path,
        metavar="CONFIG.toml",
        help='lists K_CE, B_CE, ratio, T, perturbations, readings; grid = "paper" for the whole '
        "paper; corner = [[K_CE, B_CE, K_SE, I], ...]; seed, draws, dE, rate, correlation_time. "
        "Without it: a coarse grid that spans the paper's; the word paper: the whole of it",
    )
    add_out_option(parser)
    parser.add_argument(
        "--replace",
        action="store_true",
        help="the atlas in that folder, if it is another one: by default it is kept, and the "
        "command says what differs",
    )
    parser.add_argument(
        "--retry-failed",
        action="store_true",
        help="cells that failed as well; those that crashed or took too long always are",
    )
    add_workers_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    crew = workers_of(options)

    from identifiability.files import output_folder, write_json, write_text
    from identifiability.plots.atlas import KINDS, SHOWN, draw_corners, drawings
    from identifiability.plots.style import save
    from identifiability.report.atlas import page
    from identifiability.study.atlas import read_plan, run_atlas
    from identifiability.study.atlas_record import record
    from identifiability.study.store import to_dataset, write_atlas
    from identifiability.study.stored import require_same

    plan = read_plan(options.config)
    out = output_folder(options.out)
    if not options.replace:
        require_same(out / "atlas.nc", plan)
    cells = out / "atlas.cells"
    how = {**crew._asdict(), "retry_failed": options.retry_failed}
    outcomes = run_atlas(plan, cells, **how)
    data = to_dataset(plan, outcomes)
    write_atlas(data, out / "atlas.nc")
    drawn, corners = draw_corners(plan, cells, folder=out / "atlas", **how)
    figures = []
    for found in drawings(data):
        figure = found.draw()
        for kind in KINDS:
            save(figure, out / "atlas" / f"{found.stem}.{kind}")
        file = f"atlas/{found.stem}.{SHOWN}"
        figures.append({"file": file, "kind": found.kind, "caption": found.caption})
    command = ["identifiability", "atlas", *([str(options.config)] if options.config else [])]
    summary = record(
        data,
        command=shlex.join([*command, "--out", str(options.out)]),
        figures=figures,
        corners=[{**c, "file": f"atlas/{c['file']}"} for c in drawn],
    )
    write_json(out / "atlas.json", summary)
    write_text(out / "atlas.md", page(summary))

    for group in summary["verdicts"]:
        counts = ", ".join(f"{verdict} {n}" for verdict, n in group["counts"].items())
        print(f"{group['reading']}, T = {1000 * group['T']:g} ms, {group['of']} cells: {counts}")
    print(f"written: {out / 'atlas.md'}, {out / 'atlas.json'}, {out / 'atlas.nc'}, {out / 'atlas'}")
    every = [*outcomes.values(), *corners.values()]
    again = "the same command with --retry-failed"
    return PARTIAL if complain(every, cells, again=again) else 0
