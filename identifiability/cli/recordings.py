"""``identifiability recordings``: real recordings, their sources, and what is found in them."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from identifiability.cli.exits import PARTIAL
from identifiability.cli.options import with_examples
from identifiability.errors import InputError

if TYPE_CHECKING:
    from identifiability.benchmark.real import RealRecording


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "recordings",
        help="real recordings that the package knows, and what it finds in them",
        description="List the real recordings that are known, with source, licence and checksum; "
        "with --folder check the files that are there; with --out investigate each of them, by "
        "default settings, and write recordings.md. What is finished is not done again; of those "
        "that are not asked for, what was found before stays.",
        **with_examples(
            "recordings",
            "recordings --folder downloads",
            "recordings --folder downloads --only ankle silverbox --out results",
        ),
    )
    parser.add_argument("--folder", type=Path, metavar="DIR", help="where the files are")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="some of them (all)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for what is found")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    from identifiability.benchmark.real import REAL, finished, known, rigs, summary
    from identifiability.files import output_folder, write_json, write_text
    from identifiability.report.recordings import recordings_list, recordings_page

    chosen = [known(name) for name in options.only] if options.only else list(REAL.values())
    if options.folder is None:
        if options.out is not None:
            raise InputError("found --out without --folder, expected the folder of the files")
        print(recordings_list())
        return 0
    if not options.folder.is_dir():
        raise InputError(f"found no folder {options.folder}, expected that of the files")
    states = {one.name: one.state(options.folder) for one in REAL.values()}
    if options.out is None:
        print(recordings_list(states))
        return 0
    found, by_rig = _before(options.out / "recordings.json", {one.name for one in chosen})
    out, failed = output_folder(options.out), False
    pictures = output_folder(out / "recordings")
    for one in chosen:
        if states[one.name] != "found":
            print(f"{one.name}: {states[one.name]}; {one.source}", file=sys.stderr)
            continue
        folder = pictures / one.name
        record = finished(folder)
        if record is None:
            why = _investigate(one, options.folder, folder)
            record = finished(folder)
            if record is None:
                found.append({"name": one.name, "failure": why})
                failed = True
                continue
        found.append(summary(one, record))
        shutil.copy(folder / "figures" / "overlay.png", pictures / f"{one.name}.png")
    order = list(REAL)
    found.sort(key=lambda record: order.index(record["name"]))
    at_hand = [one.name for one in chosen if states[one.name] == "found"]
    for rig, several in rigs(at_hand).items():
        together = _across(several, options.folder, pictures)
        if isinstance(together, str):
            print(f"{rig}: {together}", file=sys.stderr)
            failed = True
        else:
            by_rig[rig] = together
    write_json(out / "recordings.json", {"recordings": found, "rigs": by_rig})
    write_text(out / "recordings.md", recordings_page(found, by_rig))
    print(f"written: {out}/recordings.md, recordings.json")
    return PARTIAL if failed else 0


def _before(path: Path, chosen: set[str]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """What was found before in recordings that are not chosen, and of rigs, by which code each."""
    from identifiability.benchmark.real import REAL

    if not path.is_file():
        return [], {}
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
        others = before["recordings"]
        others = [one for one in others if one["name"] in REAL and one["name"] not in chosen]
        return others, dict(before.get("rigs", {}))
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(
            f"cannot read what was found before in '{path}' ({error}); remove it, and ask for all"
        ) from None


def _across(several: list[RealRecording], folder: Path, pictures: Path) -> dict[str, Any] | str:
    """Several records of one rig, by default settings; or why there is nothing to say."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder
    from identifiability.investigation.across.agreement import across
    from identifiability.investigation.across.weighed import weigh_across
    from identifiability.investigation.fits.kept import OnDisk
    from identifiability.investigation.session import Investigation
    from identifiability.joint.effects import EFFECTS
    from identifiability.joint.model import KBI
    from identifiability.plots.across import across_figure
    from identifiability.plots.style import save
    from identifiability.report.across import across_record

    fits = output_folder(pictures / "across") / "fits"
    try:
        trials = {one.name: one.read(folder) for one in several}
        with Clock(several[0].rig) as progress:
            studies = {
                name: Investigation([trial], kept=OnDisk(fits), progress=progress)
                for name, trial in trials.items()
            }
            weighed = weigh_across(studies, progress=progress)
            model = KBI().plus(EFFECTS[key]() for key in weighed[0].effects)
            found = across(studies, model, progress=progress)
    except InputError as error:
        return str(error)
    save(across_figure(found), pictures / f"{several[0].name}_rig.png")
    shutil.rmtree(fits.parent, ignore_errors=True)
    files = " ".join(one.file for one in several)
    command = f"identifiability across {files} {several[0].options}"
    return across_record(found, weighed, command=command)


def _investigate(one: RealRecording, folder: Path, out: Path) -> str:
    """Investigate one recording by default settings; returns why it could not be, if so."""
    from identifiability.cli.clock import Clock
    from identifiability.files import output_folder
    from identifiability.investigation.fits.kept import OnDisk
    from identifiability.investigation.investigate import investigate
    from identifiability.report.investigation import write_investigation

    fits = output_folder(out) / "fits"
    try:
        trial = one.read(folder)
        with Clock(one.name) as progress:
            found = investigate([trial], with_widths=False, kept=OnDisk(fits), progress=progress)
    except InputError as error:
        return str(error)
    write_investigation(found, out, command=one.command)
    shutil.rmtree(fits, ignore_errors=True)
    return ""
