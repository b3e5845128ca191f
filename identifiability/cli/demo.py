"""``identifiability demo``: a study, a fit and what it misses, on shipped trials."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from identifiability.cli.options import with_examples


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "demo",
        help="a small study, a fit to shipped (simulated) trials, and what the fit misses",
        description="Run a small study, fit stiffness, damping and inertia to the simulated "
        "trials that come with the package, look for what they miss, and say what was found.",
        **with_examples(
            "demo",
            "demo --out my-first-look",
        ),
    )
    parser.add_argument(
        "--out", type=Path, default=Path("identifiability-demo"), metavar="DIR", help="folder"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder
    from identifiability.inference.recordings import fit_recordings
    from identifiability.inference.widths import widths
    from identifiability.investigation.investigate import investigate
    from identifiability.measurement.example import B_CE, INERTIA, K_CE, K_SE, example_trials
    from identifiability.measurement.perturbations import WINDOWS, Impulse
    from identifiability.report.demo import demo_text, write_demo
    from identifiability.report.fit import write_fit
    from identifiability.report.investigation import write_investigation
    from identifiability.report.widths import write_widths
    from identifiability.study.setting import Setting, measured_problem

    out = output_folder(options.out)
    setting = Setting(K_CE, B_CE, K_SE, INERTIA)
    results = []
    trials = example_trials()
    with Clock("the paper's setting") as said:
        for i, window in enumerate(WINDOWS):
            name = f"{1000 * window:g}"
            said(f"window of {name} ms", i + 1, len(WINDOWS))
            problem = measured_problem(setting, Impulse(), window)
            results.append(widths(problem, starts=setting.starts(), seed=1))
            write_widths(problem, results[-1], out / f"T{name}", f"T = {name} ms")
    with Clock("the shipped trials") as progress:
        recording = fit_recordings(trials, window_lengths=WINDOWS, seed=1, progress=progress)
    write_fit(recording, out / "trials")
    with Clock("what they miss") as said:
        findings = investigate(trials, seed=1, progress=said)
        said("the report", 0, 1)
        write_investigation(findings, out / "investigation", command="identifiability demo")
    write_demo(recording, findings, out)

    print(demo_text(list(zip(WINDOWS, results, strict=True)), recording, findings))
    print(
        f"\nwritten: {out}/summary.svg, T50, T100, T200 and trials, with corner plots and figures,"
        f"\n{out}/trials/report.html and {out}/investigation/report.html"
    )
    return 0
