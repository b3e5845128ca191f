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
        "effect at many sampling rates, and compare with far finer steps. investigation: simulate "
        "joints with hidden effects by an independent simulator, investigate each, and count what "
        "was found. An interrupted run goes on where it was when the same command is typed again; "
        "cases that the record in the folder has, by the same code, are not judged again.",
    )
    parser.add_argument(
        "what",
        choices=("investigation", "calibration", "coverage", "solver"),
        help="what is judged",
    )
    parser.add_argument(
        "--cases", type=int, default=520, metavar="N", help="calibration: in all, about (520)"
    )
    parser.add_argument(
        "--recordings", type=int, default=500, metavar="N", help="coverage: of each kind (500)"
    )
    parser.add_argument(
        "--tier",
        nargs="+",
        choices=("singles", "pairs", "unknown", "controls", "nulls", "quick"),
        help="tiers of cases (all but quick)",
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th case (1)")
    parser.add_argument(
        "--seed",
        nargs="+",
        type=int,
        default=[1],
        help="of the cases (1); several stand side by side",
    )
    add_out_option(parser)
    add_workers_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    runs = {
        "solver": _run_solver,
        "coverage": _run_coverage,
        "calibration": _run_calibration,
        "investigation": _run_investigation,
    }
    return runs[options.what](options)


def _run_calibration(options: argparse.Namespace) -> int:
    check_workers(options)
    if options.cases < 1:
        raise InputError(f"found --cases {options.cases}, expected 1 or more")
    seed = _only_seed(options)
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


def _only_seed(options: argparse.Namespace) -> int:
    (seed, *others) = options.seed
    check_seed(seed)
    if others:
        raise InputError(f"found several seeds for {options.what}, expected one")
    return int(seed)


def _run_coverage(options: argparse.Namespace) -> int:
    check_workers(options)
    if options.recordings < 2:
        raise InputError(f"found --recordings {options.recordings}, expected 2 or more")
    seed = _only_seed(options)
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


def _run_investigation(options: argparse.Namespace) -> int:
    check_workers(options)
    for seed in options.seed:
        check_seed(seed)
    if options.every < 1:
        raise InputError(f"found --every {options.every}, expected 1 or more")
    from identifiability.benchmark.cases import hidden_cases
    from identifiability.benchmark.record import benchmark_record, recorded_scores
    from identifiability.benchmark.run import WHOLE, run_benchmark
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.plots.benchmark import confusion_figure
    from identifiability.plots.style import save
    from identifiability.report.benchmark import page

    tiers = tuple(options.tier or WHOLE)
    seeds = tuple(dict.fromkeys(options.seed))
    out = output_folder(options.out)
    cells = out / "investigation.cells"
    scores, outcomes = run_benchmark(
        tiers,
        cells,
        seeds=seeds,
        every=options.every,
        workers=options.workers,
        known=recorded_scores(out / "investigation.json"),
    )
    tried = sum(len(hidden_cases(tier, seed)) for tier in tiers for seed in seeds)
    record = benchmark_record(scores, tried=tried)
    write_json(out / "investigation.json", record)
    everything = [score for of_seed in scores.values() for score in of_seed]
    save(confusion_figure(everything), out / "investigation" / "confusion.png")
    write_text(out / "investigation.md", page(record))
    for of_seed in record["runs"]:
        for name, t in of_seed["tiers"].items():
            low, high = t["right_interval"]
            print(
                f"seed {of_seed['seed']}, {name}: {t['right']} of {t['n']} right "
                f"({100 * low:.0f} to {100 * high:.0f} %), {t['wrong']} wrong"
            )
    print(f"\nwritten: {out}/investigation.md, investigation.json, investigation/confusion.png")
    return PARTIAL if complain(outcomes, cells) else 0
