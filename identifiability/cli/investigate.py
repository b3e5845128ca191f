"""``identifiability investigate``: which physical effect a joint model misses."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

from identifiability.cli.options import (
    add_bounds_option,
    add_file_options,
    add_list_effects_option,
    add_lowpass_option,
    add_out_option,
    add_seed_option,
    add_torque_file_options,
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
        "investigate",
        help="which physical effect a joint model misses in recorded trials",
        description="Compare stiffness, damping and inertia with recorded trials, see where they "
        "fail, learn which physical effect is missing, add it, and judge it on trials that were "
        "not fitted. Or learn that nothing is missing, that two effects cannot be told apart, that "
        "it is the sensor, or that it is none of the effects known. An interrupted run goes on "
        "where it was when the same command is typed again.",
        **with_examples(
            "investigate trials/*.csv --hold-out other.csv --out found",
            "investigate trials/*.csv --limits torque=20 angle=0.3 duration=1 --out found",
            "investigate --list-effects",
        ),
    )
    add_file_options(parser)
    add_torque_file_options(parser)
    parser.add_argument(
        "--hold-out",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="a trial that no model is fitted to (may be repeated; chosen by itself if none is)",
    )
    add_list_effects_option(parser)
    add_lowpass_option(parser)
    add_bounds_option(parser)
    parser.add_argument("--most", type=int, metavar="N", help="most effects to add (4)")
    parser.add_argument(
        "--limits",
        nargs="+",
        default=[],
        metavar="WHAT=VALUE",
        help="what the next experiment may do, for example torque=20 angle=0.3 duration=1",
    )
    parser.add_argument("--no-widths", action="store_true", help="skip the parameters' widths")
    add_seed_option(parser, "starts and sampler")
    add_out_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder
    from identifiability.investigation.fits.kept import OnDisk
    from identifiability.investigation.investigate import investigate
    from identifiability.investigation.rules import Rules
    from identifiability.measurement.readers.formats import readable_files
    from identifiability.report.investigation import investigation_text, write_investigation

    check_seed(options.seed)
    if options.most is not None and not 0 <= options.most <= Rules().most_effects:
        raise InputError(
            f"found --most {options.most}, expected 0 to {Rules().most_effects} effects"
        )
    lowpass = parse_lowpass(options.lowpass)
    bounds = parse_bounds(options.bounds)
    files = readable_files(options.files)
    held_files = readable_files(options.hold_out)
    kept = [f for f in files if f.resolve() not in {h.resolve() for h in held_files}]
    if not kept:
        raise InputError("every file is held out; leave at least one to be fitted")
    trials, held_out = read_trials(options, kept), read_trials(options, held_files)
    limits = _limits(options.limits, [*trials, *held_out])
    out = output_folder(options.out)
    fits = out / "fits"
    if n_fits := len(OnDisk(fits).files):
        print(f"{n_fits} fits of a run that was stopped are not done again", file=sys.stderr)
    with Clock() as progress:
        findings = investigate(
            trials,
            held_out,
            bounds=bounds,
            lowpass_hz=lowpass,
            limits=limits,
            most=options.most,
            with_widths=not options.no_widths,
            seed=options.seed,
            kept=OnDisk(fits),
            progress=progress,
        )
    written = write_investigation(findings, out, command=command_line())
    shutil.rmtree(fits, ignore_errors=True)
    print(investigation_text(findings))
    print(f"\nwritten: {out}/" + ", ".join(written))
    return 0


def _limits(texts: list[str], trials: list[Any]) -> Any:
    from identifiability.investigation.next_experiment import Limits

    if not texts:
        return None
    limits = {
        "torque": max(float(abs(t.torque).max()) for t in trials),
        "angle": max(float(abs(t.angle).max()) for t in trials),
        "duration": max(t.duration for t in trials),
    }
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if name not in limits or not number > 0:
            raise InputError(
                f"found --limits {text}, expected torque=NM, angle=RAD or duration=S above 0"
            )
        limits[name] = number
    return Limits(**limits)
