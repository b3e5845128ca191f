"""``identifiability fit``: K, B and I of recorded trials, with every width."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from identifiability.errors import InputError

if TYPE_CHECKING:
    from identifiability.inference.recordings import Goodness, RecordingFit
    from identifiability.measurement.filtering import Lowpass
    from identifiability.measurement.trials import Trial


def add_file_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how files of trials are read."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="text or MATLAB .mat, or folders of them",
    )
    parser.add_argument(
        "--columns",
        nargs="+",
        metavar="WHAT=COLUMN:UNIT",
        help="where the columns' headers do not name quantity and unit: for example "
        "time=time:s angle=position:deg torque=torque:Nm, or by index angle=0:rad torque=1:Nm",
    )
    parser.add_argument("--variable", metavar="NAME", help="variable of a .mat file")
    parser.add_argument("--rate", type=float, metavar="HZ", help="where there is no time column")
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
        "where the angle above is but noise), or 'none'",
    )


def read_trials(options: argparse.Namespace, files: Sequence[Path] | None = None) -> list[Trial]:
    """Read the trials that the file options name, or those in other files, read alike."""
    from identifiability.measurement.readers import parse_columns, read_trial, readable_files

    columns = parse_columns(options.columns) if options.columns else None
    return [
        read_trial(
            path,
            columns=columns,
            variable=options.variable,
            rate=options.rate,
            restoring=options.restoring,
            driven=options.driven,
        )
        for path in (readable_files(options.files) if files is None else files)
    ]


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "fit",
        help="K, B and I of recorded trials, with every width",
        description="Fit stiffness, damping and inertia to recorded trials and report every width, "
        "the error E and the VAF, the fit's dependence on the window, and its VAF on data that "
        "were not fitted.",
    )
    add_file_options(parser)
    parser.add_argument(
        "--window",
        nargs="+",
        type=float,
        metavar="T",
        help="windows after each perturbation [s] to be fitted too (0.05 0.1 0.2, where they fit)",
    )
    add_lowpass_option(parser)
    parser.add_argument(
        "--bounds",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="other bounds than the physical ones, for example I=1e-5:0.01",
    )
    parser.add_argument("--seed", type=int, default=1, help="of starts and sampler (1)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for results")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.files import output_folder
    from identifiability.inference.problem import Prior
    from identifiability.inference.recordings import fit_recordings
    from identifiability.joint.model import KBI

    if options.seed < 0:
        raise InputError(f"found the seed {options.seed}, expected 0 or more")
    lowpass = parse_lowpass(options.lowpass)
    prior = Prior.physical(KBI(), **parse_bounds(options.bounds))
    trials = read_trials(options)
    lengths = options.window or _usual_windows(trials)
    for length in lengths:
        if not length > 0:
            raise InputError(f"found a window of {length:g} s, expected one above 0")
    out = output_folder(options.out)
    result = fit_recordings(
        trials,
        window_lengths=lengths,
        prior=prior,
        lowpass_hz=lowpass,
        seed=options.seed,
        progress=_announce,
    )
    save_results(result, out)
    print(summary(result))
    print(
        f"\nwritten: {out}/fit.json, overlay.png, corner.png, posterior.nc"
        + (", windows.png" if result.windows else "")
    )
    return 0


def save_results(result: RecordingFit, out: Path) -> None:
    """Write record, posterior and figures into a folder."""
    from identifiability.files import write_json
    from identifiability.inference.archive import write_netcdf
    from identifiability.plots.corner import corner_figure
    from identifiability.plots.recording import overlay_figure, windows_figure
    from identifiability.plots.style import save

    title = result.prepared[0].trial.name
    if len(result.prepared) > 1:
        title += f" and {len(result.prepared) - 1} more"
    save(overlay_figure(result), out / "overlay.png")
    save(corner_figure(result.widths, result.problem.model, title=title), out / "corner.png")
    if result.windows:
        save(windows_figure(result), out / "windows.png")
    write_netcdf(result.problem, result.widths, out / "posterior.nc")
    write_json(out / "fit.json", record(result))


def record(result: RecordingFit) -> dict[str, Any]:
    """Plain record of a fit, for JSON."""
    from identifiability.provenance import package_version

    held = result.held_out
    return {
        "schema": 1,
        "package": package_version(),
        "model": repr(result.problem.model),
        "driven": result.prepared[0].trial.driven,
        "trials": [
            {
                **p.record(),
                "noise_sd": noise.sd * fraction**0.5,
                "independent_fraction": fraction,
            }
            for p, noise, fraction in zip(
                result.prepared, result.noises, result.independent_fractions, strict=True
            )
        ],
        "E": result.goodness.error,
        "vaf": result.goodness.vaf,
        **result.widths.to_dict(),
        "windows": [
            {
                "T": w.window,
                "n_windows": w.n_windows,
                "E": w.goodness.error,
                "vaf": w.goodness.vaf,
                "verdict": w.widths.verdict,
                "parameters": w.widths.to_dict()["parameters"],
            }
            for w in result.windows
        ],
        "held_out": None
        if held is None
        else {
            "fitted": held.fitted,
            "held_out": held.held_out,
            "rule": held.rule,
            "parameters": {n: held.fit[n] for n in held.fit.names},
            "E_fitted": held.goodness_fitted.error,
            "vaf_fitted": held.goodness_fitted.vaf,
            "E_held_out": held.goodness_held_out.error,
            "vaf_held_out": held.goodness_held_out.vaf,
        },
        "warnings": list(result.warnings),
    }


def summary(result: RecordingFit) -> str:
    """What the fit found, as text."""
    from identifiability.cli.widths import table

    def quality(goodness: Goodness) -> str:
        return f"E = {goodness.error:.3g}, VAF = {goodness.vaf:.2f} %"

    lines = [table(result.widths), "", f"{quality(result.goodness)} on all that was fitted"]
    share = min(result.independent_fractions)
    if share < 0.5:
        lines.append(
            f"the residual is correlated: only {100 * share:.2g} % of the samples count as "
            "independent, and the widths are computed for these"
        )
    for row in result.widths.rows:
        lines.append(f"{row.name}: {row.verdict}, {row.reason}")
    for w in result.windows:
        values = ", ".join(
            f"{r.name} {r.optimum:.4g} ± {r.posterior_sd:.2g}" for r in w.widths.rows
        )
        lines.append(
            f"T = {1000 * w.window:g} ms ({w.n_windows} windows): {values}; "
            f"VAF {w.goodness.vaf:.2f} %"
        )
    if result.held_out is not None:
        held = result.held_out
        lines.append(f"fitted to {held.fitted}: {quality(held.goodness_fitted)} there, and")
        lines.append(f"{quality(held.goodness_held_out)} on {held.held_out}, which was not fitted")
    lines += [f"note: {warning}" for warning in result.warnings]
    return "\n".join(lines)


def _announce(what: str, done: int, total: int) -> None:
    import sys

    print(f"[{done}/{total}] {what}", file=sys.stderr, flush=True)


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


def _usual_windows(trials: list[Trial]) -> list[float]:
    """The paper's windows, as far as every trial has room for them after a perturbation."""
    from identifiability.measurement.trials import onsets

    room = []
    for trial in trials:
        starts = onsets(trial)
        gaps = [*(starts[1:] - starts[:-1]), trial.n_samples - 1 - starts[-1]]
        room.append(max(gaps) * trial.dt)
    return [length for length in (0.05, 0.1, 0.2) if length < min(room)]
