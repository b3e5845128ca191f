"""Options that several subcommands share, and what they say."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from identifiability.errors import InputError

if TYPE_CHECKING:
    from identifiability.measurement.filtering import Lowpass
    from identifiability.measurement.trials import Trial


_EXAMPLES = "examples:"


class _Formatter(argparse.HelpFormatter):
    """Fills every text but examples, which stay as they were written."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith(_EXAMPLES) else super()._fill_text(text, width, indent)


def with_examples(*lines: str) -> dict[str, Any]:
    """Arguments of a parser whose help ends with examples."""
    examples = "\n".join([_EXAMPLES, *(f"  identifiability {line}" for line in lines)])
    return {"epilog": examples, "formatter_class": _Formatter}


class Version(argparse.Action):
    """Prints the version of the package, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *unused: Any) -> None:
        """Print it."""
        from identifiability.provenance import package_version

        print(parser.prog, package_version())
        parser.exit()


class ListEffects(argparse.Action):
    """Prints the effects that are known, and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *unused: Any) -> None:
        """Print them."""
        print_effects()
        parser.exit()


def add_list_effects_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that prints the effects that are known."""
    parser.add_argument(
        "--list-effects",
        action=ListEffects,
        nargs=0,
        help="print the effects that are known, and end",
    )


def print_effects() -> None:
    """Print the effects that are known, with their places."""
    from identifiability.joint.effects import EFFECTS

    width = max(map(len, EFFECTS))
    for key, effect in EFFECTS.items():
        print(f"{key:{width}}  {effect.place:8} {effect.title}")


def add_out_option(parser: argparse.ArgumentParser) -> None:
    """Add the folder for results."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results")


def add_seed_option(parser: argparse.ArgumentParser, of: str) -> None:
    """Add the seed of what is drawn."""
    parser.add_argument("--seed", type=int, default=1, help=f"of {of} (1)")


def check_seed(seed: int) -> None:
    """Refuse a seed below zero."""
    if seed < 0:
        raise InputError(f"found the seed {seed}, expected 0 or more")


def add_bounds_option(parser: argparse.ArgumentParser) -> None:
    """Add the bounds that `parse_bounds` reads."""
    parser.add_argument(
        "--bounds",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="other bounds than the physical ones, for example I=1e-5:0.01",
    )


def add_file_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how files of trials are read."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="text, .mat, .h5, .sto or .mot, _motion.tsv, .c3d, .tdms, or folders of them",
    )
    parser.add_argument(
        "--columns",
        nargs="+",
        metavar="WHAT=COLUMN:UNIT",
        help="where the columns' headers do not name quantity and unit: for example "
        "time=time:s angle=position:deg torque=torque:Nm, or by index angle=0:rad torque=1:Nm",
    )
    parser.add_argument(
        "--variable",
        metavar="NAME",
        help="variable of a .mat file, group of an .h5 or .tdms file",
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="where there is no time column")
    parser.add_argument(
        "--resample",
        type=float,
        metavar="HZ",
        help="interpolate to so many samples a second, where the clock is uneven, or thin to them",
    )
    parser.add_argument(
        "--cut",
        nargs="?",
        type=float,
        const=0.1,
        metavar="LEAD",
        help="cut each recording into trials, one for each perturbation, from LEAD s (0.1) before "
        "it; the report shows the cuts",
    )
    parser.add_argument(
        "--cut-apart",
        type=float,
        default=0.2,
        metavar="S",
        help="perturbations that start closer than this are one, such as both edges of a pulse "
        "(0.2)",
    )
    parser.add_argument(
        "--restoring",
        action="store_true",
        help="the torque recorded is the joint's reaction, not the torque applied to it",
    )
    parser.add_argument(
        "--driven",
        choices=("torque", "angle"),
        default="torque",
        help="what was imposed (torque); the other is the response",
    )


def add_torque_file_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where the torque is, where files have the angle alone."""
    parser.add_argument(
        "--torque-from",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="files with the torque, one for each FILE, which then has the angle alone; at other "
        "rates or not, both with time or a rate",
    )
    parser.add_argument(
        "--torque-columns", nargs="+", metavar="WHAT=COLUMN:UNIT", help="as --columns, of these"
    )
    parser.add_argument("--torque-variable", metavar="NAME", help="as --variable, of these")
    parser.add_argument("--torque-rate", type=float, metavar="HZ", help="as --rate, of these")
    parser.add_argument(
        "--torque-late",
        type=float,
        default=0.0,
        metavar="S",
        help="seconds that the torque's clock shows less than the angle's at one moment (0); it is "
        "not guessed, since a joint that lags looks alike",
    )


def add_lowpass_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that `parse_lowpass` reads."""
    parser.add_argument(
        "--lowpass",
        default="auto",
        metavar="HZ",
        help="zero-phase low-pass of both channels where the angle is imposed (50 Hz, or lower "
        "where the angle above is but noise), or 'none'; in a fit for the error E alone",
    )


def command_line() -> str:
    """The command as it was typed."""
    return " ".join(["identifiability", *sys.argv[1:]])


def read_trials(options: argparse.Namespace, files: Sequence[Path] | None = None) -> list[Trial]:
    """Read the trials that the file options name, or those in other files, read alike."""
    from identifiability.measurement.cutting import cut_at_onsets
    from identifiability.measurement.readers.formats import readable_files

    paths = readable_files(options.files) if files is None else files
    trials = (
        _of_two_files(options, paths)
        if getattr(options, "torque_from", None)
        else _of_one(options, paths)
    )
    if options.cut is None:
        return trials
    return [
        part
        for trial in trials
        for part in cut_at_onsets(trial, lead=options.cut, separation=options.cut_apart)
    ]


def _of_one(options: argparse.Namespace, paths: Sequence[Path]) -> list[Trial]:
    from identifiability.measurement.readers.columns import parse_columns
    from identifiability.measurement.readers.trial_file import read_trial

    for name in ("columns", "variable", "rate", "late"):
        if getattr(options, f"torque_{name}", None):
            raise InputError(
                f"found --torque-{name} without --torque-from, expected both: name the files that "
                "have the torque"
            )
    columns = parse_columns(options.columns) if options.columns else None
    return [
        read_trial(
            path,
            columns=columns,
            variable=options.variable,
            rate=options.rate,
            resample=options.resample,
            restoring=options.restoring,
            driven=options.driven,
        )
        for path in paths
    ]


def _of_two_files(options: argparse.Namespace, paths: Sequence[Path]) -> list[Trial]:
    from identifiability.measurement.readers.columns import parse_columns
    from identifiability.measurement.readers.two_files import ChannelFile, read_two_files

    if options.resample is not None:
        raise InputError("found --resample with --torque-from, expected one of them")
    if getattr(options, "hold_out", None):
        raise InputError(
            "found --hold-out with --torque-from, expected one of them: some trials are held out "
            "by themselves"
        )
    if not paths:
        return []  # nothing is held out
    if len(options.torque_from) != len(paths):
        raise InputError(
            f"found {len(options.torque_from)} files of torque for {len(paths)} of angle, expected "
            "one for each"
        )
    columns = [
        parse_columns(texts) if texts else None
        for texts in (options.columns, options.torque_columns)
    ]
    return [
        read_two_files(
            ChannelFile(angle, columns[0], options.variable, options.rate),
            ChannelFile(torque, columns[1], options.torque_variable, options.torque_rate),
            late=options.torque_late,
            restoring=options.restoring,
            driven=options.driven,
        )
        for angle, torque in zip(paths, options.torque_from, strict=True)
    ]


def parse_lowpass(text: str) -> Lowpass:
    """Cut-off frequency [Hz] of an option, "auto", or ``None`` for no filter."""
    if text == "auto":
        return "auto"
    if text == "none":
        return None
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not value > 0:
        raise InputError(f"found --lowpass {text}, expected a frequency in Hz, 'auto' or 'none'")
    return value


def parse_bounds(texts: list[str]) -> dict[str, tuple[float, float]]:
    """Bounds by parameter name, from ``NAME=LOW:HIGH``."""
    bounds = {}
    for text in texts:
        try:
            name, _, ends = text.partition("=")
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise InputError(
                f"found --bounds {text}, expected NAME=LOW:HIGH such as I=1e-5:0.01"
            ) from None
        bounds[name] = (low, high)
    return bounds
