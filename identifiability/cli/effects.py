"""``identifiability effects``: the effects that are known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from identifiability.cli.options import print_effects, with_examples


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "effects",
        help="the effects that are known: equations, typical values, sources, look-alikes",
        description="List the effects that an investigation knows; with --out write the page of "
        "them, effects.md, and its figures.",
        **with_examples("effects", "effects --out docs"),
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the page")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.files import output_folder, write_text
    from identifiability.joint.effects import DESCRIPTIONS, EFFECTS

    if options.out is None:
        print_effects()
        return 0
    from identifiability.plots.effects import gallery_figure
    from identifiability.plots.joint_scheme import joint_scheme_figure
    from identifiability.plots.style import save
    from identifiability.report.effects import effects_page

    out = output_folder(options.out)
    save(joint_scheme_figure(EFFECTS), out / "joint.svg")
    save(gallery_figure(EFFECTS), out / "effects.svg")
    write_text(out / "effects.md", effects_page(EFFECTS, DESCRIPTIONS))
    print(f"written: {out}/effects.md, joint.svg, effects.svg")
    return 0
