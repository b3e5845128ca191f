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


def print_effects() -> None:
    """Print the effects that are known, with their places."""
    from identifiability.joint.effects import EFFECTS

    width = max(map(len, EFFECTS))
    for key, effect in EFFECTS.items():
        print(f"{key:{width}}  {effect.place:7} {effect.title}")


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
    from identifiability.measurement.readers.columns import parse_columns
    from identifiability.measurement.readers.formats import readable_files
    from identifiability.measurement.readers.trial_file import read_trial

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
        for path in (readable_files(options.files) if files is None else files)
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
