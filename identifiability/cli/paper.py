"""``identifiability paper``: Kistemaker & Rozendaal (2011), computed again."""

from __future__ import annotations

import argparse
import shutil
import sys
from typing import Any

from identifiability.cli.exits import PARTIAL
from identifiability.cli.options import (
    add_out_option,
    with_examples,
)
from identifiability.cli.workers import add_workers_option, workers_of


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "paper",
        help="compute Kistemaker & Rozendaal (2011) again: numbers, figures, a page beside theirs",
        description="Fit KBI to the responses of the musculoskeletal model over the grid of "
        "Kistemaker & Rozendaal (2011), redraw their figures, and write a page with the published "
        "numbers beside ours: paper.json, paper.nc, paper.md and the folder paper/ with figures.",
        **with_examples(
            "paper --quick --out look",
            "paper --out results",
        ),
    )
    add_out_option(parser)
    parser.add_argument(
        "--quick", action="store_true", help="a coarser grid, K_SE = 5 K_CE alone: under a minute"
    )
    add_workers_option(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    crew = workers_of(options)

    import numpy as np

    from identifiability.files import output_folder, replacing, write_json, write_text
    from identifiability.plots import paper as draw
    from identifiability.plots.style import save
    from identifiability.report.paper import page
    from identifiability.study import paper as study
    from identifiability.study.paper_record import RATIO, nearest_example, record

    out = output_folder(options.out)
    K, B = study.coarse() if options.quick else (study.K_CE, study.B_CE)
    ratios = (RATIO,) if options.quick else study.RATIOS
    beyond = [
        row for row in study.rows(K, (study.WIDER_B_CE,), (RATIO,)) if row.perturbation == "impulse"
    ]
    unfinished = out / "paper.cells"
    results, failed = study.compute_rows(
        [*study.rows(K, B, ratios), *beyond],
        folder=unfinished,
        workers=crew.workers,
        executor=crew.executor,
    )
    if failed:
        print(
            f"identifiability: {len(failed)} rows have no result (the first, {failed[0].name}: "
            f"{failed[0].cause}), so no page is written; the same command tries them again",
            file=sys.stderr,
        )
        return PARTIAL
    wider = {row: results.pop(row) for row in beyond}
    data = study.to_dataset(results, K, B, ratios)

    panels = [study.panel_fit(panel) for panel in study.PANELS]
    stiffness = np.arange(0.0, 126.0, 2.0)
    profiles = [study.valley(panel, stiffness) for panel in study.PANELS[:2]]
    example = study.surface(*nearest_example(data))
    found = record(
        data,
        panels,
        profile=profiles[1],
        slips=study.timing_slip(study.PANELS[1]),
        example=example,
        wider=wider,
        quick=options.quick,
    )

    figures = {
        "figure2": draw.figure2(panels),
        "figure3": draw.figure3(data),
        "figure4": draw.figure4(data),
        "figure5": draw.figure5(data),
        "figure6": draw.figure6(example, study.DE),
        "figure7": draw.figure7(panels),
        "figure8": draw.figure8(data),
        "figure9": draw.figure9(data),
        "perturbations": draw.perturbations(data),
        "valley": draw.valley(list(zip(panels[:2], profiles, strict=True)), study.DE),
    }
    for ratio in ratios:
        if ratio != RATIO:
            figures[f"grids_ratio{ratio:g}"] = draw.grids(data, ratio)
    for name, figure in figures.items():
        save(figure, out / "paper" / f"{name}.png")
    with replacing(out / "paper.nc") as temporary:
        data.to_netcdf(temporary, engine="h5netcdf")
    write_json(out / "paper.json", found)
    write_text(out / "paper.md", page(found))
    shutil.rmtree(unfinished)
    print(f"written: {out / 'paper.md'}, {out / 'paper.json'}, {out / 'paper.nc'}")
    return 0
