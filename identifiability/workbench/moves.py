"""A session in a folder: its trials, how it was set up, and what was done."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.errors import InputError
from identifiability.files import read_arrays, write_arrays, write_json
from identifiability.measurement.trials import Trial

FITS = "fits"
"""Folder of the fits, in that of the session."""
_SESSION, _TRIALS = "session.json", "trials.npz"
_ARRAYS = ("time", "torque", "angle")

Move = tuple[str, ...]
"""What was done, and with which effect."""


@dataclass(frozen=True)
class Stored:
    """What a folder holds.

    Attributes
    ----------
    trials, held_out : sequence of Trial
    how : dict
        What the session was set up with, as JSON knows it.
    moves : sequence of tuple of str
    """

    trials: Sequence[Trial]
    held_out: Sequence[Trial]
    how: Mapping[str, Any]
    moves: Sequence[Move]


def write_trials(folder: Path, trials: Sequence[Trial], held_out: Sequence[Trial]) -> None:
    """Write the trials of a session."""
    arrays: dict[str, np.ndarray] = {}
    told = []
    for i, trial in enumerate((*trials, *held_out)):
        arrays |= {f"{name}_{i}": getattr(trial, name) for name in _ARRAYS}
        own = {f.name: getattr(trial, f.name) for f in fields(trial) if f.name not in _ARRAYS}
        told.append(own | {"held_out": i >= len(trials)})
    write_arrays(folder / _TRIALS, arrays | {"trials": np.array(json.dumps(told))})


def write_moves(folder: Path, how: Mapping[str, Any], moves: Sequence[Move]) -> None:
    """Write what was done in a session."""
    write_json(folder / _SESSION, {"how": dict(how), "moves": [list(m) for m in moves]})


def holds_session(folder: Path) -> bool:
    """Whether a folder holds a session."""
    return (folder / _SESSION).exists()


def read_session(folder: Path) -> Stored:
    """Read a session.

    Raises
    ------
    InputError
        If the folder holds none, or one that cannot be read.
    """
    arrays = read_arrays(folder / _TRIALS)
    try:
        session = json.loads((folder / _SESSION).read_text(encoding="utf-8"))
        how, moves = session["how"], [tuple(map(str, move)) for move in session["moves"]]
    except (OSError, ValueError, KeyError, TypeError):
        arrays = None
    if arrays is None or "trials" not in arrays:
        raise InputError(
            f"{folder} holds no session that can be read: give a folder that Session.save, or "
            "Session(..., folder=...), has written"
        )
    parts: dict[bool, list[Trial]] = {False: [], True: []}
    for i, told in enumerate(json.loads(str(arrays["trials"]))):
        held_out = told.pop("held_out")
        columns: dict[str, Any] = {name: arrays[f"{name}_{i}"] for name in _ARRAYS}
        parts[held_out].append(Trial(**columns, **told))
    return Stored(parts[False], parts[True], how, moves)
