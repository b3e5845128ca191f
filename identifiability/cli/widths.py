"""``identifiability widths``: one musculoskeletal setting, every width, a corner plot."""

from __future__ import annotations

import argparse
from typing import Any

from identifiability.cli.options import add_out_option, add_seed_option, check_seed, with_examples
from identifiability.errors import InputError


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "widths",
        help="widths of K, B and I for one musculoskeletal setting: quadratic against posterior",
        description="Fit KBI to the response of a musculoskeletal model of known parameters, "
        "and compare the quadratic (Hessian) widths of K, B and I with slices, profiles and the "
        "posterior sampled by MCMC, under noise matched to the paper's dE.",
        **with_examples(
            "widths --msm 32 3.2 100 0.1 --out one",
            "widths --msm 32 3.2 100 0.1 --window 0.2 --noise energy --out longer",
        ),
    )
    parser.add_argument(
        "--msm",
        nargs=4,
        type=float,
        required=True,
        metavar=("K_CE", "B_CE", "K_SE", "I"),
        help="parameters of the musculoskeletal model [Nm/rad, Nms/rad, Nm/rad, kg m2]",
    )
    parser.add_argument(
        "--perturbation", default="impulse", metavar="NAME", help="default: impulse"
    )
    parser.add_argument(
        "--window", type=float, default=0.05, metavar="T", help="seconds that are fitted (0.05)"
    )
    parser.add_argument(
        "--noise", default="contour", metavar="READING", help="contour (default) or energy"
    )
    parser.add_argument("--dE", type=float, default=1e-3, help="error the noise is matched to")
    parser.add_argument(
        "--correlation-time",
        type=float,
        default=0.0,
        metavar="S",
        help="of AR(1) noise [s]; 0: white",
    )
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="sampling rate")
    parser.add_argument(
        "--no-bounds", action="store_true", help="let K and B be negative: no physical prior"
    )
    parser.add_argument(
        "--realisation",
        type=int,
        metavar="SEED",
        help="add a noise realisation to the response (by default it is the expected one)",
    )
    add_seed_option(parser, "the sampler")
    add_out_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.files import output_folder
    from identifiability.inference.problem import Prior
    from identifiability.inference.widths import widths
    from identifiability.measurement.perturbations import PERTURBATIONS
    from identifiability.report.widths import widths_text, write_widths
    from identifiability.study.setting import Setting, measured_problem

    if options.perturbation not in PERTURBATIONS:
        raise InputError(
            f"found perturbation '{options.perturbation}', expected one of {list(PERTURBATIONS)}"
        )
    setting = Setting(*options.msm)
    problem = measured_problem(
        setting,
        PERTURBATIONS[options.perturbation](),
        options.window,
        reading=options.noise,
        dE=options.dE,
        correlation_time=options.correlation_time,
        rate=options.rate,
        seed=options.realisation,
    )
    if options.no_bounds:
        problem = problem.with_prior(Prior.unbounded(problem.model))
    check_seed(options.seed)
    out = output_folder(options.out)
    result = widths(problem, starts=setting.starts(), seed=options.seed)
    conditions = {
        "setting": vars(setting),
        "perturbation": options.perturbation,
        "window": options.window,
        "noise": {
            "reading": options.noise,
            "dE": options.dE,
            "correlation_time": options.correlation_time,
            "realisation": options.realisation,
        },
        "rate": options.rate,
        "bounds": not options.no_bounds,
    }
    title = (
        f"MSM {' '.join(f'{v:g}' for v in options.msm)}, {options.perturbation}, "
        f"T = {1000 * options.window:g} ms, {options.noise}"
    )
    write_widths(problem, result, out, title, conditions)
    print(widths_text(result))
    print(f"\n{result.verdict}: {result.reason}")
    print(f"sampler: {result.posterior.step}, because {result.posterior.reason}")
    print(f"written: {out / 'widths.json'}, {out / 'posterior.nc'}, {out / 'corner.png'}")
    return 0
