"""``identifiability benchmark``: the package judged where the truth is known, and timed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from identifiability.cli.exits import PARTIAL, complain
from identifiability.cli.options import (
    add_out_option,
    check_seed,
    with_examples,
)
from identifiability.cli.workers import add_workers_option, workers_of
from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "benchmark",
        help="judge the package where the truth is known, or time it",
        description="calibration: simulate joints with hidden effects, torque or angle imposed, in "
        "any noise, weigh what may be missing, and count whether probabilities are what they say. "
        "coverage: fit K, B and I to simulated recordings with noise of every kind, "
        "and count how often their intervals hold the truth. nulls: the same of the calibration's "
        "joints that miss nothing, as an investigation fits them. solver: integrate every "
        "non-linear effect at many sampling rates, and compare with far finer steps. "
        "responses: time them, "
        "with their derivatives, by machine code and by JAX. speed: effective draws a second of "
        "this package's sampler and of others that are installed, and what a cell of the atlas "
        "costs. durations: investigate six and sixteen "
        "trials and long records, and say how long it takes and where the time goes. "
        "An interrupted run goes on where it was when the same command is typed again.",
        **with_examples(
            "benchmark solver --out results",
            "benchmark calibration --cases 14 --seed 227 229 --out results",
            "benchmark nulls --cases 180 --seed 227 --out results",
        ),
    )
    parser.add_argument(
        "what",
        choices=(
            "calibration",
            "coverage",
            "durations",
            "nulls",
            "responses",
            "solver",
            "speed",
        ),
        help="what is judged, or timed",
    )
    parser.add_argument(
        "--cases",
        type=int,
        default=520,
        metavar="N",
        help="calibration, nulls: in all, about (520)",
    )
    parser.add_argument(
        "--recordings", type=int, default=500, metavar="N", help="coverage: of each kind (500)"
    )
    parser.add_argument(
        "--seed",
        type=int,
        nargs="+",
        default=[1],
        metavar="N",
        help="of the cases (1); calibration: several, of each so many cases",
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
        "nulls": _run_nulls,
        "responses": _run_responses,
        "durations": _run_durations,
        "speed": _run_speed,
    }
    return runs[options.what](options)


def _publish(out: Path, name: str, found: dict[str, Any], page: str, said: Sequence[str]) -> None:
    """Write a benchmark's record and page, then print what it found."""
    from identifiability.files import write_json, write_text

    write_json(out / f"{name}.json", found)
    write_text(out / f"{name}.md", page)
    print(*said, sep="\n")
    print(f"\nwritten: {out}/{name}.md, {name}.json")


def _run_calibration(options: argparse.Namespace) -> int:
    crew = workers_of(options)
    if options.cases < 1:
        raise InputError(f"found --cases {options.cases}, expected 1 or more")
    for seed in options.seed:
        check_seed(seed)
    if len(set(options.seed)) < len(options.seed):
        raise InputError(f"found --seed {options.seed}, expected every seed once")
    from identifiability.benchmark.calibration import BlindScore, measure
    from identifiability.benchmark.seeds import together
    from identifiability.files import output_folder
    from identifiability.report.calibration import calibration_page
    from identifiability.sweep.outcome import Outcome

    out = output_folder(options.out)
    cells = out / "calibration.cells"
    by_seed: dict[int, list[BlindScore]] = {}
    outcomes: list[Outcome] = []
    for seed in options.seed:
        by_seed[seed], done = measure(
            options.cases, seed=seed, folder=cells, workers=crew.workers, executor=crew.executor
        )
        outcomes += done
    found = together(by_seed, n=options.cases)
    said = [
        f"{t['tier']}, {t['imposed']} imposed: {t['right']} of {t['n'] - t['weak']} right, "
        f"{t['wrong']} wrong"
        for t in found["tiers"]
    ]
    _publish(out, "calibration", found, calibration_page(found), said)
    return PARTIAL if complain(outcomes, cells) else 0


def _one_seed(options: argparse.Namespace) -> int:
    if len(options.seed) > 1:
        raise InputError(f"found {len(options.seed)} seeds, expected one for {options.what}")
    (seed,) = options.seed
    check_seed(seed)
    return int(seed)


def _run_coverage(options: argparse.Namespace) -> int:
    crew = workers_of(options)
    if options.recordings < 2:
        raise InputError(f"found --recordings {options.recordings}, expected 2 or more")
    seed = _one_seed(options)
    from identifiability.benchmark.coverage import measure, record
    from identifiability.files import output_folder
    from identifiability.report.coverage import coverage_page

    out = output_folder(options.out)
    cells = out / "coverage.cells"
    rows, outcomes = measure(
        options.recordings, seed=seed, folder=cells, workers=crew.workers, executor=crew.executor
    )
    found = record(rows, n=options.recordings, seed=seed)
    said = [
        f"{row.kind}, {row.imposed} imposed, {row.name}: {row.covered} of {row.n} "
        f"({100 * row.interval[0]:.0f} to {100 * row.interval[1]:.0f} %)"
        for row in rows
    ]
    _publish(out, "coverage", found, coverage_page(found), said)
    return PARTIAL if complain(outcomes, cells) else 0


def _run_nulls(options: argparse.Namespace) -> int:
    crew = workers_of(options)
    if options.cases < 2:
        raise InputError(f"found --cases {options.cases}, expected 2 or more")
    seed = _one_seed(options)
    from identifiability.benchmark.nulls import measure, record
    from identifiability.files import output_folder
    from identifiability.report.nulls import nulls_page

    out = output_folder(options.out)
    cells = out / "nulls.cells"
    rows, outcomes = measure(
        options.cases, seed=seed, folder=cells, workers=crew.workers, executor=crew.executor
    )
    found = record(rows, n=options.cases, seed=seed)
    said = [
        f"{row.imposed} imposed, {row.noise}, torque {row.way}: {row.covered} of {row.n} "
        f"intervals hold the truth, {row.far} far off"
        for row in rows
    ]
    _publish(out, "nulls", found, nulls_page(found), said)
    return PARTIAL if complain(outcomes, cells) else 0


def _run_solver(options: argparse.Namespace) -> int:
    from identifiability.benchmark.solver import measure, questions, record
    from identifiability.files import output_folder
    from identifiability.report.solver import solver_page

    out = output_folder(options.out)
    asked = list(questions())
    rows = []
    for i, question in enumerate(asked):
        print(f"[{i + 1}/{len(asked)}] {' '.join(map(str, question))}", file=sys.stderr, flush=True)
        rows.append(measure(*question))
    found = record(rows)
    said = [f"{sum(row.passes for row in rows)} of {len(rows)} rows below {found['allowed']:g}"]
    _publish(out, "solver", found, solver_page(found), said)
    return 0 if all(row.passes for row in rows) else PARTIAL


def _run_responses(options: argparse.Namespace) -> int:
    from identifiability.benchmark.responses import measure, questions, record
    from identifiability.files import output_folder
    from identifiability.report.responses import responses_page

    out = output_folder(options.out)
    asked = list(questions())
    rows = []
    for i, (effects, imposed) in enumerate(asked):
        name = " ".join((*effects, imposed))
        print(f"[{i + 1}/{len(asked)}] {name}", file=sys.stderr, flush=True)
        rows.append(measure(effects, imposed))
    found = record(rows)
    said = [
        f"JAX takes {found['median_each']:.1f} times as long for each evaluation (median of "
        f"{len(rows)} rows), and {found['once_jax']:.0f} s for all models once, machine code "
        f"{found['once']:.1f} s"
    ]
    _publish(out, "responses", found, responses_page(found), said)
    return 0


def _run_durations(options: argparse.Namespace) -> int:
    seed = _one_seed(options)
    from identifiability.benchmark.durations import SIZES, measure, record
    from identifiability.files import output_folder
    from identifiability.report.durations import durations_page

    out = output_folder(options.out)
    cells = out / "durations.cells"
    rows, outcomes = measure(SIZES, seed=seed, folder=cells)
    found = record(rows, seed=seed)
    said = [
        f"{row.size.name}, {row.size.imposed} imposed: {row.empty.seconds:.0f} s with an empty "
        f"cache, {row.full.seconds:.0f} s with a full one, silent for {row.full.silence:.0f} s"
        for row in rows
    ]
    _publish(out, "durations", found, durations_page(found), said)
    return PARTIAL if complain(outcomes, cells) else 0


def _run_speed(options: argparse.Namespace) -> int:
    seed = _one_seed(options)
    from identifiability.benchmark.speed import BASE, FEW, cells, many, measure, record, scaling
    from identifiability.files import output_folder
    from identifiability.report.speed import speed_page

    out = output_folder(options.out)
    kept = out / "speed.cells"
    rows, outcomes = measure(cells(seed), folder=kept)
    if not rows:
        return complain(outcomes, kept) or PARTIAL
    found = record(rows, scaling(many(seed), FEW), seed=seed)
    ratios = sorted(one.times(BASE) for one in rows)
    said = [
        f"against {BASE}: {ratios[len(ratios) // 2]:.0f} times as many effective draws a second "
        f"in the median of {len(rows)} cells, {ratios[0]:.0f} times at least"
    ]
    _publish(out, "benchmarks", found, speed_page(found), said)
    return PARTIAL if complain(outcomes, kept) else 0
