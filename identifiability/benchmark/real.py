"""Real recordings that the package knows: where they are from, and what their joints are known for.

None of them is shipped. A user fetches the files; a checksum says whether they are the same.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from identifiability.errors import InputError
from identifiability.measurement.readers.columns import parse_columns
from identifiability.measurement.readers.trial_file import read_trial
from identifiability.measurement.trials import Trial
from identifiability.provenance import code_fingerprint

_INVESTIGATION = "identifiability.investigation.investigate"

State = Literal["found", "missing", "different"]


@dataclass(frozen=True)
class RealRecording:
    """One recording of a real joint, or of a machine that moves like one.

    Attributes
    ----------
    name, title : str
    file : str
        Name under which it is looked for.
    sha256 : str
    source, licence : str
        Where it is from, and what may be done with it.
    known_for : str
        What its joint is known to have, by those who built or measured it.
    columns : tuple of str
        Where quantity and unit are, as `parse_columns` reads them.
    driven : {"torque", "angle"}
    variable, rate, restoring
        As of `read_trial`.
    rig : str
        What it was recorded on, where there are several records of that.
    """

    name: str
    title: str
    file: str
    sha256: str
    source: str
    licence: str
    known_for: str
    columns: tuple[str, ...] = ()
    driven: Literal["torque", "angle"] = "angle"
    variable: str | None = None
    rate: float | None = None
    restoring: bool = False
    rig: str = ""

    @property
    def command(self) -> str:
        """The command that investigates it."""
        return f"identifiability investigate {self.file} {self.options}"

    @property
    def options(self) -> str:
        """The options by which it is read."""
        parts = ["--driven", self.driven]
        parts += ["--variable", self.variable] if self.variable else []
        parts += ["--rate", f"{self.rate:g}"] if self.rate else []
        parts += ["--columns", *self.columns] if self.columns else []
        return " ".join([*parts, "--restoring"] if self.restoring else parts)

    def read(self, folder: Path) -> Trial:
        """Read the file."""
        return read_trial(
            folder / self.file,
            columns=parse_columns(list(self.columns)) if self.columns else None,
            variable=self.variable,
            rate=self.rate,
            restoring=self.restoring,
            driven=self.driven,
        )

    def state(self, folder: Path) -> State:
        """Whether the file is at hand, and the one that is known here."""
        path = folder / self.file
        if not path.is_file():
            return "missing"
        same = hashlib.sha256(path.read_bytes()).hexdigest() == self.sha256
        return "found" if same else "different"


_PENDULUM = ("time=time:s", "angle=position:rad", "torque=torque:Nm")
_SIMPLE = "DFKI, torque_limited_simple_pendulum, results/control_method_{}/data_measured.csv"

REAL = {
    one.name: one
    for one in (
        RealRecording(
            "pendulum_collocation",
            "A motor-driven pendulum that swings up",
            "dfki_pendulum_direct_collocation.csv",
            "c3f990980169815b93ab37078780e13803327dcb6fc9e019f2d261b988cdaf8f",
            _SIMPLE.format("direct_collocation"),
            "BSD-3-Clause, DFKI 2021",
            "its weight, dry friction, and a time shift between the channels",
            _PENDULUM,
            driven="torque",
            rig="The motor-driven pendulum",
        ),
        RealRecording(
            "pendulum_ddp",
            "The same pendulum, another swing-up",
            "dfki_pendulum_ddp.csv",
            "14748fd189abae7b6392a016f2f0494b54bb2a8c014bc435a84b58dbecb2da35",
            _SIMPLE.format("ddp"),
            "BSD-3-Clause, DFKI 2021",
            "its weight, dry friction, and a time shift between the channels",
            _PENDULUM,
            driven="torque",
            rig="The motor-driven pendulum",
        ),
        RealRecording(
            "double_pendulum",
            "The shoulder of a double pendulum whose elbow hardly moves",
            "dfki_double_pendulum_elbow_locked.csv",
            "45c7ed0eb4811ee0b11650b6ae344222bfcf4f7a313c7da611442149ee91e70c",
            "DFKI, double_pendulum, data/experiment_records/design_C.1/sys_id/20230629/"
            "20230629-143906",
            "BSD-3-Clause, DFKI 2022",
            "dry friction",
            ("time=time:s", "angle=pos_meas1:rad", "torque=tau_meas1:Nm"),
            driven="torque",
        ),
        RealRecording(
            "ankle",
            "A human ankle in tonic contraction, moved by a position servo",
            "reklab_ankle_z.mat",
            "ca9d219c44318492e09d85ddfcdb72f68cb5580de52e34638455f826072542ab",
            "McGill REKLAB, reklab_public, stiffnessID/z.mat",
            "of a GPL-2 repository; a healthy, consenting subject, approved by McGill's board",
            "a stretch reflex of one direction, some 50 ms late",
            ("angle=0:rad", "torque=1:Nm"),
            variable="z",
            rate=1000.0,
            restoring=True,
        ),
        RealRecording(
            "damper",
            "A banded rotary friction damper, moved to and fro (displacement [in] and force [kip])",
            "arts_damper_0.5Hz_30lb_1in.csv",
            "4e2b6f8e9522f8d3f544c5f6765438b66cf8b2bb84841f40c703ee6526a1dfa7",
            "ARTS-Lab, Dataset-Friction-Damper-with-Backlash, dataset-2, 0.5 Hz, 30 lb, 1 in "
            "(Coble, Huggins, Cao, Ricles & Downey 2022); JSON written as CSV",
            "CC BY-SA 4.0",
            "dry friction with elastic slip, and backlash",
            ("time=time_s:s", "angle=displacement_in:rad", "torque=force_kip:Nm"),
        ),
        RealRecording(
            "silverbox",
            "An electronic mass-spring-damper (volts)",
            "silverbox_SNLS80mV.csv",
            "ae62d5a91230c10f76e6dd02c8a4fac3c9d4d8a95fbf50e87cb0c4885003e0f1",
            "Wigren & Schoukens 2013, Proc. European Control Conference: 2933-2938; "
            "biaslab, nsi-silverbox",
            "MIT (the copy)",
            "a cubic spring",
            ("torque=V1:Nm", "angle=V2:rad"),
            driven="torque",
            rate=610.35,
        ),
    )
}
"""Every recording that is known, by name."""


def finished(folder: Path) -> dict[str, Any] | None:
    """The record of an investigation in a folder, if the present code made it."""
    path = folder / "investigation.json"
    if not path.is_file():
        return None
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    made_by = record.get("code_of", "").split()
    return record if record.get("code") == code_fingerprint(*made_by or [_INVESTIGATION]) else None


def summary(one: RealRecording, record: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says of one investigation."""
    verdict = record["verdict"]
    return {
        "name": one.name,
        "verdict": {key: verdict[key] for key in ("kind", "equivalence_sets", "sentence")},
        "because": verdict["because"],
        "posterior": [row for row in record["posterior"] or [] if row["probability"] >= 0.005],
        "models": record["models"],
        "failures": record["failures"],
        "held_out": record["held_out"],
        "noise_floor": record["baseline"]["noise_floor"],
        "seconds": sum(record["timings"].values()),
        "code": record["code"],
        "package": record["package"],
    }


def rigs(names: Collection[str]) -> dict[str, list[RealRecording]]:
    """Rigs of which several of some recordings are, with these."""
    found: dict[str, list[RealRecording]] = {}
    for one in REAL.values():
        if one.rig and one.name in names:
            found.setdefault(one.rig, []).append(one)
    return {rig: several for rig, several in found.items() if len(several) > 1}


def known(name: str) -> RealRecording:
    """The recording of a name.

    Raises
    ------
    InputError
        Where there is none.
    """
    if name not in REAL:
        raise InputError(f"found the recording {name}, expected one of {', '.join(REAL)}")
    return REAL[name]
