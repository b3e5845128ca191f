"""``identifiability benchmark``: investigation and solver judged where the truth is known."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from identifiability.cli.exits import PARTIAL, complain
from identifiability.cli.options import (
    add_out_option,
    add_workers_option,
    check_seed,
    check_workers,
)
from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "benchmark",
        help="judge the investigation, the widths or the solver where the truth is known",
        description="calibration: simulate joints with hidden effects, torque or angle imposed, in "
        "any noise, weigh what may be missing, and count whether probabilities are what they say. "
        "coverage: fit K, B and I to simulated recordings with noise of every kind, "
        "and count how often their intervals hold the truth. solver: integrate every non-linear "
        "effect at many sampling rates, and compare with far finer steps. An interrupted run goes "
        "on where it was when the same command is typed again.",
    )
    parser.add_argument(
        "what",
        choices=("calibration", "coverage", "solver"),
        help="what is judged",
    )
    parser.add_argument(
        "--cases", type=int, default=520, metavar="N", help="calibration: in all, about (520)"
    )
    parser.add_argument(
        "--recordings", type=int, default=500, metavar="N", help="coverage: of each kind (500)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the cases (1)")
    add_out_option(parser)
    add_workers_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    runs = {
        "solver": _run_solver,
        "coverage": _run_coverage,
        "calibration": _run_calibration,
    }
    return runs[options.what](options)


def _run_calibration(options: argparse.Namespace) -> int:
    check_workers(options)
    if options.cases < 1:
        raise InputError(f"found --cases {options.cases}, expected 1 or more")
    check_seed(options.seed)
    seed = options.seed
    from identifiability.benchmark.calibration import measure, record
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.calibration import calibration_page

    out = output_folder(options.out)
    cells = out / "calibration.cells"
    scores, outcomes = measure(options.cases, seed=seed, folder=cells, workers=options.workers)
    found = record(scores, n=options.cases, seed=seed)
    write_json(out / "calibration.json", found)
    write_text(out / "calibration.md", calibration_page(found))
    for t in found["tiers"]:
        print(
            f"{t['tier']}, {t['imposed']} imposed: {t['right']} of {t['n'] - t['weak']} right, "
            f"{t['wrong']} wrong"
        )
    print(f"\nwritten: {out}/calibration.md, calibration.json")
    return PARTIAL if complain(outcomes, cells) else 0


def _run_coverage(options: argparse.Namespace) -> int:
    check_workers(options)
    if options.recordings < 2:
        raise InputError(f"found --recordings {options.recordings}, expected 2 or more")
    check_seed(options.seed)
    seed = options.seed
    from identifiability.benchmark.coverage import measure, record
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.coverage import coverage_page

    out = output_folder(options.out)
    cells = out / "coverage.cells"
    rows, outcomes = measure(options.recordings, seed=seed, folder=cells, workers=options.workers)
    found = record(rows, n=options.recordings, seed=seed)
    write_json(out / "coverage.json", found)
    write_text(out / "coverage.md", coverage_page(found))
    for row in rows:
        print(
            f"{row.kind}, {row.imposed} imposed, {row.name}: {row.covered} of {row.n} "
            f"({100 * row.interval[0]:.0f} to {100 * row.interval[1]:.0f} %)"
        )
    print(f"\nwritten: {out}/coverage.md, coverage.json")
    return PARTIAL if complain(outcomes, cells) else 0


def _run_solver(options: argparse.Namespace) -> int:
    from identifiability.benchmark.solver import measure, questions, record
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.solver import solver_page

    out = output_folder(options.out)
    asked = list(questions())
    rows = []
    for i, question in enumerate(asked):
        print(f"[{i + 1}/{len(asked)}] {' '.join(map(str, question))}", file=sys.stderr, flush=True)
        rows.append(measure(*question))
    found = record(rows)
    write_json(out / "solver.json", found)
    write_text(out / "solver.md", solver_page(found))
    print(f"{sum(row.passes for row in rows)} of {len(rows)} rows below {found['allowed']:g}")
    print(f"\nwritten: {out}/solver.md, solver.json")
    return 0 if all(row.passes for row in rows) else PARTIAL
