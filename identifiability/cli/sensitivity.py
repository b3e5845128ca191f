"""``identifiability sensitivity``: what it hangs on whether spread follows the Hessian."""

from __future__ import annotations

import argparse
from typing import Any

from identifiability.cli.exits import PARTIAL, complain
from identifiability.cli.options import add_out_option, add_seed_option, check_seed, with_examples
from identifiability.cli.workers import add_workers_option, workers_of


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "sensitivity",
        help="what it hangs on whether posterior spread follows the Hessian",
        description="Compute cells that span the atlas again with one thing changed: sampling "
        "rate, correlation of the noise, bounds, inertia known, logarithms, one draw of the noise. "
        "An interrupted run goes on where it was when the same command is typed again.",
        **with_examples("sensitivity --out results"),
    )
    add_seed_option(parser, "samplers and noise")
    add_out_option(parser)
    add_workers_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    crew = workers_of(options)
    check_seed(options.seed)

    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.sensitivity import answers, sensitivity_page
    from identifiability.study.sensitivity import record, run_sensitivity

    out = output_folder(options.out)
    cells = out / "sensitivity.cells"
    outcomes = run_sensitivity(
        cells, seed=options.seed, workers=crew.workers, executor=crew.executor
    )
    found = record(outcomes, seed=options.seed)
    write_json(out / "sensitivity.json", found)
    write_text(out / "sensitivity.md", sensitivity_page(found))
    print(*(sentence.replace("**", "") for sentence in answers(found)), sep="\n")
    print(f"written: {out / 'sensitivity.md'}, {out / 'sensitivity.json'}")
    return PARTIAL if complain([*outcomes.values()], cells) else 0
