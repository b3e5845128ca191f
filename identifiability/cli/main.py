"""The command line: one subcommand a file, errors in one sentence."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from identifiability.cli.exits import INTERRUPTED, USAGE
from identifiability.cli.options import Version, add_list_effects_option, with_examples
from identifiability.errors import InputError


def parser() -> argparse.ArgumentParser:
    """Build the parser with all subcommands."""
    from identifiability.cli import (
        across,
        atlas,
        benchmark,
        demo,
        effects,
        fit,
        investigate,
        paper,
        recordings,
        sensitivity,
        widths,
    )

    top = argparse.ArgumentParser(
        prog="identifiability",
        description="Can the stiffness, damping and inertia fitted to a joint be believed?",
        **with_examples(
            "demo",
            "fit trial1.csv trial2.csv --out fitted",
            "investigate trials/ --out found",
            "investigate --help",
        ),
    )
    top.add_argument("--version", action=Version, nargs=0, help="print the version, and end")
    add_list_effects_option(top)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in (
        demo,
        fit,
        investigate,
        across,
        widths,
        paper,
        atlas,
        sensitivity,
        effects,
        recordings,
        benchmark,
    ):
        module.add_parser(commands)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code (0 done, 2 bad input, 3 some cells failed)."""
    try:
        options = parser().parse_args(arguments)
        from identifiability.files import compile_cache

        # Compiled programs are kept between runs.
        os.environ.update(compile_cache())
        return int(options.run(options) or 0)
    except InputError as error:
        print(f"identifiability: {error}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        print("identifiability: interrupted; what was finished is kept", file=sys.stderr)
        return INTERRUPTED
