"""``identifiability fit``: K, B and I of recorded trials, with every width."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from identifiability.cli.options import (
    add_bounds_option,
    add_file_options,
    add_lowpass_option,
    add_out_option,
    add_seed_option,
    add_torque_file_options,
    check_seed,
    parse_bounds,
    parse_lowpass,
    read_trials,
    with_examples,
)
from identifiability.errors import InputError

if TYPE_CHECKING:
    from identifiability.measurement.trials import Trial


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "fit",
        help="K, B and I of recorded trials, with every width",
        description="Fit stiffness, damping and inertia to recorded trials, with the noise of both "
        "channels, and report every width, the error E and the VAF, the fit's dependence on the "
        "window, and its VAF on data that were not fitted.",
        **with_examples(
            "fit trial1.csv trial2.csv --out fitted",
            "fit servo.mat --variable z --rate 1000 --columns angle=0:rad torque=1:Nm "
            "--driven angle --restoring --out ankle",
        ),
    )
    add_file_options(parser)
    add_torque_file_options(parser)
    parser.add_argument(
        "--window",
        nargs="+",
        type=float,
        metavar="T",
        help="windows after each perturbation [s] to be fitted too (0.05 0.1 0.2, where they fit)",
    )
    add_lowpass_option(parser)
    add_bounds_option(parser)
    add_seed_option(parser, "starts and sampler")
    add_out_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder
    from identifiability.inference.problem import Prior
    from identifiability.inference.recordings import fit_recordings
    from identifiability.joint.model import KBI
    from identifiability.report.fit import fit_text, write_fit

    check_seed(options.seed)
    lowpass = parse_lowpass(options.lowpass)
    prior = Prior.recorded(KBI(), **parse_bounds(options.bounds))
    trials = read_trials(options)
    lengths = options.window or _usual_windows(trials)
    for length in lengths:
        if not length > 0:
            raise InputError(f"found a window of {length:g} s, expected one above 0")
    out = output_folder(options.out)
    with Clock() as progress:
        result = fit_recordings(
            trials,
            window_lengths=lengths,
            prior=prior,
            lowpass_hz=lowpass,
            seed=options.seed,
            progress=progress,
        )
    written = write_fit(result, out)
    print(fit_text(result))
    print(f"\nwritten: {out}/" + ", ".join(written))
    return 0


def _usual_windows(trials: list[Trial]) -> list[float]:
    """The paper's windows, as far as every trial has room for them after a perturbation."""
    from identifiability.measurement.perturbations import WINDOWS
    from identifiability.measurement.trials import onsets

    room = []
    for trial in trials:
        starts = onsets(trial)
        gaps = [*(starts[1:] - starts[:-1]), trial.n_samples - 1 - starts[-1]]
        room.append(max(gaps) * trial.dt)
    return [length for length in WINDOWS if length < min(room)]
