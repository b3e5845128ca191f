"""``identifiability benchmark``: investigation and solver judged where the truth is known."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "benchmark",
        help="judge the investigation on joints whose hidden effects are known, or the solver",
        description="solver: integrate every non-linear effect at many sampling rates, and compare "
        "with far finer steps. investigation: simulate joints with hidden effects by an "
        "independent simulator, investigate each, and count what was found. An interrupted "
        "run goes on where it was when the same command is typed again.",
    )
    parser.add_argument("what", choices=("investigation", "solver"), help="what is judged")
    parser.add_argument(
        "--tier",
        nargs="+",
        choices=("singles", "pairs", "unknown", "controls", "nulls", "quick"),
        help="tiers of cases (all but quick)",
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th case (1)")
    parser.add_argument("--seed", type=int, default=1, help="of the cases (1)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    return _run_solver(options) if options.what == "solver" else _run_investigation(options)


def _run_solver(options: argparse.Namespace) -> int:
    from identifiability.benchmark.solver import measure, questions, record
    from identifiability.cli.main import PARTIAL
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.solver import solver_page

    out = output_folder(options.out)
    asked = list(questions())
    rows = []
    for i, question in enumerate(asked):
        _announce(" ".join(map(str, question)), i, len(asked), float("nan"))
        rows.append(measure(*question))
    found = record(rows)
    write_json(out / "solver.json", found)
    write_text(out / "solver.md", solver_page(found))
    print(f"{sum(row.passes for row in rows)} of {len(rows)} rows below {found['allowed']:g}")
    print(f"\nwritten: {out}/solver.md, solver.json")
    return 0 if all(row.passes for row in rows) else PARTIAL


def _run_investigation(options: argparse.Namespace) -> int:
    from identifiability.benchmark.cases import hidden_cases
    from identifiability.benchmark.page import page, summary
    from identifiability.benchmark.run import WHOLE, run_benchmark
    from identifiability.cli.main import PARTIAL
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.plots.benchmark import confusion_figure
    from identifiability.plots.style import save

    if options.seed < 0 or options.every < 1:
        raise InputError("the seed must be 0 or more, and --every 1 or more")
    tiers = tuple(options.tier or WHOLE)
    out = output_folder(options.out)
    scores = run_benchmark(
        tiers,
        out / "investigation.cells",
        seed=options.seed,
        every=options.every,
        progress=_announce,
    )
    tried = sum(len(hidden_cases(tier, options.seed)) for tier in tiers)
    record = summary(scores, seed=options.seed, tried=tried)
    write_json(out / "investigation.json", record)
    save(confusion_figure(scores), out / "investigation" / "confusion.png")
    write_text(out / "investigation.md", page(record))
    for name, t in record["tiers"].items():
        low, high = t["right_interval"]
        print(
            f"{name}: {t['right']} of {t['n']} right ({100 * low:.0f} to {100 * high:.0f} %), "
            f"{t['wrong']} wrong"
        )
    print(f"\nwritten: {out}/investigation.md, investigation.json, investigation/confusion.png")
    return PARTIAL if any(s.outcome == "failed" for s in scores) else 0


def _announce(what: str, done: int, total: int, left: float) -> None:
    rest = "" if left != left else f", about {left / 60:.0f} min left"
    print(f"[{done + 1}/{total}{rest}] {what}", file=sys.stderr, flush=True)
