"""``identifiability across``: whether several records are of one joint."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from identifiability.cli.options import (
    add_bounds_option,
    add_file_options,
    add_list_effects_option,
    add_lowpass_option,
    add_out_option,
    add_seed_option,
    check_seed,
    command_line,
    parse_bounds,
    parse_lowpass,
    read_trials,
    with_examples,
)
from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "across",
        help="whether several records of one joint agree in what should be the same",
        description="Fit one model to several records of a joint, each a file or a folder of "
        "trials; compare what should be the same in all of them (inertia, friction, gravity, "
        "...), combine it, and predict every record by the fits of the others. Without --effects "
        "every record is investigated, and the sets that came near in any are weighed by all.",
        **with_examples(
            "across rest/ loaded/ --effects gravity coulomb_friction --out rig",
            "across low.csv middle.csv high.csv --may-differ K B --out ankle",
        ),
    )
    add_file_options(parser)
    parser.add_argument("--effects", nargs="+", metavar="NAME", help="effects of the model")
    parser.add_argument(
        "--may-differ",
        nargs="*",
        default=["K", "B"],
        metavar="NAME",
        help="parameters that may differ between records (K B)",
    )
    add_list_effects_option(parser)
    add_lowpass_option(parser)
    add_bounds_option(parser)
    add_seed_option(parser, "probes of the noise")
    add_out_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.investigation.across.agreement import across
    from identifiability.investigation.across.weighed import SetAcross, weigh_across
    from identifiability.investigation.session import Investigation
    from identifiability.joint.effects import EFFECTS
    from identifiability.joint.model import KBI
    from identifiability.measurement.readers.formats import readable_files
    from identifiability.plots.across import across_figure
    from identifiability.plots.style import save
    from identifiability.report.across import across_page, across_record, across_text

    check_seed(options.seed)
    if unknown := sorted(set(options.effects or ()) - set(EFFECTS)):
        raise InputError(
            f"{', '.join(unknown)} is no effect that is known: the effects are {', '.join(EFFECTS)}"
        )
    names = _names(options.files)
    lowpass, bounds = parse_lowpass(options.lowpass), parse_bounds(options.bounds)
    trials = [read_trials(options, readable_files([path])) for path in options.files]
    out = output_folder(options.out)
    weighed: tuple[SetAcross, ...] = ()
    keys = options.effects
    with Clock() as progress:
        records = {
            name: Investigation(some, bounds=bounds, lowpass_hz=lowpass, progress=progress)
            for name, some in zip(names, trials, strict=True)
        }
        if keys is None:
            # What a record misses may say otherwise how its torque ran between the samples.
            records = {name: study.likeliest(seed=options.seed) for name, study in records.items()}
            weighed = weigh_across(records, seed=options.seed, progress=progress)
            keys = weighed[0].effects
        model = KBI().plus(EFFECTS[key]() for key in keys)
        found = across(
            records, model, may_differ=options.may_differ, seed=options.seed, progress=progress
        )
    record = across_record(found, weighed, command=command_line())
    write_json(out / "across.json", record)
    save(across_figure(found), out / "across.svg")
    write_text(out / "across.md", across_page(record, "across.svg"))
    print(across_text(record))
    print(f"\nwritten: {out}/across.json, across.md, across.svg")
    return 0


def _names(paths: list[Path]) -> list[str]:
    """Names of records, all different."""
    if len(paths) < 2:
        raise InputError(f"found {len(paths)} record, expected two or more of one joint")
    names = [path.stem if path.is_file() else path.name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    if len(set(names)) < len(names):
        raise InputError("one record is named twice: name each file or folder once")
    return names
