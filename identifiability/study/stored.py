"""Whether an atlas that is stored is the one that a command would make."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import xarray as xr

from identifiability.errors import InputError
from identifiability.joint.model import KBI
from identifiability.provenance import remark
from identifiability.study.atlas import Plan

_MOST_NAMED = 3


def require_same(path: Path, plan: Plan) -> None:
    """Refuse to go on where another atlas would be replaced.

    Parameters
    ----------
    path : Path
        Of the stored atlas; nothing need be there.
    plan : Plan
        Of the atlas to be made.

    Raises
    ------
    InputError
        With what differs: the plan, the order of the parameters, or the code.
    """
    if not path.exists():
        return
    found = _differences(path, plan)
    if found:
        more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
        raise InputError(
            f"found another atlas in {path}: {'; '.join(found[:_MOST_NAMED])}{more}. Give another "
            "folder by --out, or --replace it"
        )


def _differences(path: Path, plan: Plan) -> list[str]:
    try:
        with xr.open_dataset(path, engine="h5netcdf") as data:
            attributes, parameters = dict(data.attrs), list(map(str, data["parameter"].values))
        kept = json.loads(attributes["plan"])
    except (OSError, KeyError, ValueError):
        return ["it cannot be read"]
    ours = json.loads(json.dumps(asdict(plan)))
    found = [
        f"{key} is {_short(kept.get(key))} there and {_short(ours.get(key))} here"
        for key in dict.fromkeys([*ours, *kept])
        if kept.get(key) != ours.get(key)
    ]
    expected = list(KBI().parameters)
    if parameters != expected:
        found.append(f"its parameters are {', '.join(parameters)} and not {', '.join(expected)}")
    if made := remark(attributes):
        found.append(f"it was {made}")
    return found


def _short(value: Any) -> str:
    """A value of a plan; of many only how many they are, and the ends."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return str(value)
    if len(value) > _MOST_NAMED:
        return f"{value[0]} to {value[-1]} ({len(value)} values)"
    return ", ".join(map(str, value)) or "none"
