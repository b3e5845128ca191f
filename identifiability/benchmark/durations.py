"""How long an investigation takes, where its time goes, and how long it says nothing.

Joints with a delayed reflex, recorded by the simulator that shares no equations with the library,
are investigated by the command as a user types it, in a process of its own: with an empty compile
cache, then again with what that run left there. A fit of K, B and I to the same files, in the same
run, is the unit by which machines can be compared.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.benchmark.blind import Imposed
from identifiability.benchmark.joints import Joint, draw_joint
from identifiability.benchmark.motion import Motion, reaction
from identifiability.provenance import code_fingerprint, stamp
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import processors, sweep

_CODE = ("identifiability.cli.investigate", "identifiability.cli.fit")
_EFFECT = "stretch_reflex"
_RTOL = 1e-6  # of the simulation
_NOISE = (1e-2, 1e-3)  # of the response, and of what is imposed, over their standard deviations
_QUIET = 0.1  # s at rest
_HOLDS, _GAPS = (0.08, 0.25), (0.08, 0.35)  # s
_PACE = 60.0  # 1/s
_LEVEL, _REACH = 0.25, 0.2  # of the torque over the stiffness; of the angle [rad]
_DIGITS = "%.9g"


@dataclass(frozen=True)
class Size:
    """Recordings to be investigated.

    Attributes
    ----------
    name : str
    trials, samples : int
        Number of trials, and of samples in each.
    rate : float
        Samples per second.
    imposed : {"torque", "angle"}
    mark_empty, mark_full : float or None
        Seconds that it shall take on two processors, with an empty compile cache and a full one.
    """

    name: str
    trials: int
    samples: int
    rate: float
    imposed: Imposed
    mark_empty: float | None = None
    mark_full: float | None = None


_BOTH: tuple[Imposed, Imposed] = ("torque", "angle")
SIZES = (
    *(Size("six trials", 6, 500, 500.0, imposed, 40.0, 25.0) for imposed in _BOTH),
    *(Size("sixteen trials", 16, 900, 1000.0, imposed, None, 90.0) for imposed in _BOTH),
    *(Size("a long record", 1, 25_000, 1000.0, imposed) for imposed in _BOTH),
    *(Size("a minute", 1, 60_000, 1000.0, imposed) for imposed in _BOTH),
)
"""What is timed. Marks are for trials that a session in a laboratory gives."""

MOST_SILENT = 10.0
"""Seconds for which a command may say nothing."""


@dataclass(frozen=True)
class Timed:
    """One command.

    Attributes
    ----------
    seconds : float
        From when it was typed until it was done, report and figures included.
    silence : float
        Longest time [s] in which it said nothing once it had begun to speak.
    before : str
        What it had said last before that.
    timings : dict of str to float
        Seconds by part, as the record has them.
    found : tuple of str
        Kind of the verdict of an investigation, and the effects that it names.
    """

    seconds: float
    silence: float
    before: str
    timings: Mapping[str, float]
    found: Sequence[str]


@dataclass(frozen=True)
class Row:
    """One size of recordings: a fit, and an investigation with an empty and with a full cache."""

    size: Size
    fit: Timed
    empty: Timed
    full: Timed

    @property
    def fits(self) -> float:
        """What the investigation takes over what the fit takes, both with a full cache."""
        return self.full.seconds / self.fit.seconds


def measure(
    sizes: Sequence[Size], *, seed: int, folder: Path | None = None, progress: bool = True
) -> tuple[list[Row], list[Outcome]]:
    """Time the command on recordings of several sizes, one after another.

    Parameters
    ----------
    sizes : sequence of Size
    seed : int
    folder, progress
        See `sweep`.
    """
    code = code_fingerprint(*_CODE)  # of the commands, which this module does not import
    outcomes = sweep(
        _timed,
        {f"{size.name}, {size.imposed} imposed": (size, seed, code) for size in sizes},
        folder=folder,
        label="durations",
        workers=1,
        executor=lambda: ThreadPoolExecutor(1),
        progress=progress,
    )
    found = [o.arrays for o in outcomes.values() if o.arrays is not None]
    return [row_from(json.loads(str(a["row"]))) for a in found], list(outcomes.values())


def _timed(task: tuple[Size, int, str]) -> Arrays:
    """One size, as a sweep keeps it: JSON in an array of one text."""
    size, seed, _ = task
    return {"row": np.array(json.dumps(asdict(measured(size, seed))))}


def row_from(plain: Mapping[str, Any]) -> Row:
    """Row from its plain record."""
    commands = {name: Timed(**plain[name]) for name in ("fit", "empty", "full")}
    return Row(Size(**plain["size"]), **commands)


def measured(size: Size, seed: int) -> Row:
    """Simulate recordings of a size and investigate them by the command.

    Parameters
    ----------
    size : Size
    seed : int

    Raises
    ------
    RuntimeError
        Where the command fails: its last words.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "trials").mkdir()
        for i, columns in enumerate(recordings(size, seed)):
            np.savetxt(
                folder / "trials" / f"trial_{i + 1:02d}.csv",
                columns,
                delimiter=",",
                header="time_s,torque_Nm,angle_rad",
                comments="",
                fmt=_DIGITS,
            )

        def run(command: str, out: str) -> Timed:
            return timed(
                [command, "trials", "--driven", size.imposed, "--out", out], folder, folder / "xdg"
            )

        empty = run("investigate", "first")
        full = run("investigate", "again")
        run("fit", "fitted")
        return Row(size, run("fit", "refitted"), empty, full)


def recordings(size: Size, seed: int) -> list[np.ndarray]:
    """Trials of a joint with a reflex: time [s], torque [Nm] and angle [rad], shape (n, 3) each."""
    root = np.random.SeedSequence(seed)
    for_joint, for_trials, for_noise = (np.random.default_rng(s) for s in root.spawn(3))
    joint = draw_joint([_EFFECT], for_joint)
    respond = _pushed if size.imposed == "torque" else _moved
    out = []
    for _ in range(size.trials):
        time, imposed, response = respond(joint, for_trials, size)
        louder, quieter = _NOISE
        response = response + louder * response.std() * for_noise.standard_normal(time.size)
        imposed = imposed + quieter * imposed.std() * for_noise.standard_normal(time.size)
        pair = (imposed, response) if size.imposed == "torque" else (response, imposed)
        out.append(np.column_stack([time, *pair]))
    return out


def _pushed(
    joint: Joint, random: np.random.Generator, size: Size
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, torque and angle: torques that are held for random times."""
    time, torque = np.arange(size.samples) / size.rate, np.zeros(size.samples)
    quiet = round(_QUIET * size.rate)
    hold = max(1, round(random.uniform(*_HOLDS) * size.rate))
    levels = random.uniform(-_LEVEL, _LEVEL, -(-size.samples // hold))
    torque[quiet:] = joint.anatomy.stiffness * np.repeat(levels, hold)[: size.samples - quiet]
    return time, torque, joint.respond(torque, 1 / size.rate, _RTOL)


def _moved(
    joint: Joint, random: np.random.Generator, size: Size
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, angle and torque: a servo's smooth steps at random times."""
    time = np.arange(size.samples) / size.rate
    gaps = random.uniform(*_GAPS, round(time[-1] / _GAPS[0]) + 1)
    onsets = _QUIET + np.cumsum(gaps) - gaps[0]
    onsets = onsets[onsets < time[-1] - _QUIET]
    heights = np.diff(random.uniform(-_REACH, _REACH, onsets.size), prepend=0.0)
    motion = Motion(onsets, heights, _PACE)
    return time, motion.at(time)[0], reaction(joint, motion, time)


def timed(arguments: Sequence[str], folder: Path, cache: Path) -> Timed:
    """Run a command of the package in a process of its own, and listen to it.

    Parameters
    ----------
    arguments : sequence of str
        The last is the folder for results.
    folder : Path
        Where it is typed.
    cache : Path
        Of what is compiled.

    Raises
    ------
    RuntimeError
        Where it fails: its last words.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment |= {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "identifiability", *arguments]
    began = time.perf_counter()
    said = [(began, "")]
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            said.append((time.perf_counter(), line.strip()))
    ended = time.perf_counter()
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {said[-1][1]}")
    moments = [*said, (ended, "")][1:]
    silences = [(after - before, text) for (before, text), (after, _) in pairwise(moments)]
    longest, before_it = max(silences, default=(ended - began, ""))
    found = folder / arguments[-1] / f"{arguments[0].replace('investigate', 'investigation')}.json"
    record = json.loads(found.read_text(encoding="utf-8"))
    verdict = record.get("verdict", {"kind": "", "effects": []})
    return Timed(
        ended - began,
        longest,
        before_it.partition("] ")[2],
        record.get("timings", {}),
        (verdict["kind"], *verdict["effects"]),
    )


def record(rows: Sequence[Row], *, seed: int) -> dict[str, Any]:
    """Plain record, for JSON."""
    return {
        "schema": 1,
        **stamp(__name__, *_CODE),
        "seed": seed,
        "processors": processors(),
        "most_silent": MOST_SILENT,
        "rows": [asdict(row) | {"fits": row.fits} for row in rows],
    }
