"""Fits kept on disk, so that an investigation that was stopped goes on where it was.

A fit is one file, named after all that it depends on: data, weights, bounds, model, starts and the
code that fits. The search draws nothing, so it asks for the same fits when it is run again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from identifiability.files import read_arrays, write_arrays
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate, Residual
from identifiability.joint.model import Model
from identifiability.joint.scheme import Scheme
from identifiability.provenance import code_fingerprint, fingerprint


def kept_fits(folder: Path) -> list[Path]:
    """Files of the fits in a folder that this code made, and so would read."""
    return sorted(folder.glob(f"{_code()}-*.npz"))


def _code() -> str:
    """Beginning of the names of this code's fits."""
    return code_fingerprint(__name__)[:12]


@dataclass(frozen=True, eq=False)
class KeepingWorkbench(Workbench):
    """A workbench that does no fit twice, in this run or in one before.

    An effect of one's own is known by its class's name: after changing its equation, empty the
    folder.

    Attributes
    ----------
    folder : Path
        Where the fits are kept, one file each; a fit that failed is not.
    """

    folder: Path = field(kw_only=True)

    @cached_property
    def _identity(self) -> str:
        split = self.split
        return fingerprint(split.fitted, split.held_out, self.bounds)

    def fit(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        thorough: bool = True,
    ) -> Candidate:
        """Fit a model, or read the fit if it is there; see `Workbench.fit`."""
        asked = fingerprint(self._identity, repr(model), starts, refined, thorough)
        path = self.folder / f"{_code()}-{asked}.npz"
        arrays = read_arrays(path)
        if arrays is not None:
            return _from_arrays(model, arrays)
        found = super().fit(model, starts, refined=refined, thorough=thorough)
        if not found.failure:
            write_arrays(path, _to_arrays(found))
        return found


def _to_arrays(candidate: Candidate) -> dict[str, np.ndarray]:
    plain = {
        "values": candidate.values,
        "free": candidate.free,
        "at_bound": candidate.at_bound,
        "n_agreeing": int(candidate.n_agreeing),
        "n_starts": candidate.n_starts,
        "reached": candidate.reached,
        "refined": candidate.refined,
        "thorough": candidate.thorough,
        "seconds": candidate.seconds,
        "scheme": None if candidate.scheme is None else asdict(candidate.scheme),
        "solver_error": candidate.solver_error,
    }
    arrays = {"candidate": np.array(json.dumps(plain))}
    for name in ("fitted", "held_out"):
        part: Residual = getattr(candidate, name)
        arrays[f"{name}_samples"] = np.concatenate([np.empty(0), *part.by_trial])
        arrays[f"{name}_sizes"] = np.array([left.size for left in part.by_trial], int)
        arrays[f"{name}_errors"] = part.errors
        arrays[f"{name}_weighted"] = np.array(part.weighted)
    return arrays


def _from_arrays(model: Model, arrays: Mapping[str, np.ndarray]) -> Candidate:
    plain: dict[str, Any] = json.loads(str(arrays["candidate"]))
    for name in ("free", "at_bound", "reached", "refined"):
        plain[name] = tuple(plain[name])
    if plain["scheme"] is not None:
        plain["scheme"] = Scheme(**plain["scheme"])
    fitted, held_out = (_residual(name, arrays) for name in ("fitted", "held_out"))
    return Candidate(model, fitted=fitted, held_out=held_out, **plain)


def _residual(name: str, arrays: Mapping[str, np.ndarray]) -> Residual:
    ends = np.cumsum(arrays[f"{name}_sizes"])
    by_trial = np.split(arrays[f"{name}_samples"], ends)[:-1]
    return Residual(tuple(by_trial), arrays[f"{name}_errors"], float(arrays[f"{name}_weighted"]))
