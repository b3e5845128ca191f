"""Fits that are done once: kept in memory, or on disk so that a study that was stopped goes on.

A fit is known by all that it depends on: data, weights, bounds, model, starts and, on disk, the
code that fits. The search draws nothing, so it asks for the same fits when it is run again.
"""

from __future__ import annotations

import hashlib
import json
import marshal
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from identifiability.files import read_arrays, write_arrays
from identifiability.investigation.fits.candidate import Candidate, Residual
from identifiability.joint.model import Model
from identifiability.joint.scheme import Scheme
from identifiability.provenance import code_fingerprint, fingerprint


class Kept(Protocol):
    """Where fits are kept."""

    def find(self, question: str, model: Model) -> Candidate | None:
        """Return the fit that answers a question, if there is one."""

    def keep(self, question: str, found: Candidate) -> None:
        """Keep a fit."""


@dataclass(frozen=True, eq=False)
class InMemory:
    """Fits of this process."""

    fits: dict[str, Candidate] = field(default_factory=dict)

    def find(self, question: str, model: Model) -> Candidate | None:
        """Return the fit that answers a question, if there is one."""
        return self.fits.get(question)

    def keep(self, question: str, found: Candidate) -> None:
        """Keep a fit."""
        self.fits[question] = found


@dataclass(frozen=True)
class OnDisk:
    """Fits of this process and those before it, one file each.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    def find(self, question: str, model: Model) -> Candidate | None:
        """Read the fit that answers a question, if there is one that can be read."""
        arrays = read_arrays(self._path(question))
        return None if arrays is None else _from_arrays(model, arrays)

    def keep(self, question: str, found: Candidate) -> None:
        """Write a fit."""
        write_arrays(self._path(question), _to_arrays(found))

    @property
    def files(self) -> list[Path]:
        """Files of the fits that this code made, and so would read."""
        return sorted(self.folder.glob(f"{_code()}-*.npz"))

    def _path(self, question: str) -> Path:
        return self.folder / f"{_code()}-{question}.npz"


def _code() -> str:
    """Beginning of the names of this code's fits."""
    return code_fingerprint("identifiability.investigation.fits.bench")[:12]


def question(identity: str, model: Model, *how: Any) -> str:
    """Hash of all that a fit depends on, but for the package's own code.

    Parameters
    ----------
    identity : str
        Of the trials and the bounds.
    model : Model
    *how
        Starts and all else that was asked for, such as of `Workbench.fit`.
    """
    return fingerprint(identity, repr(model), _own_code(model), *how)


def _own_code(model: Model) -> list[str]:
    """Compiled methods of effects that are not the package's, whose sources `_code` has not."""
    return [
        f"{effect.key}.{name} {hashlib.sha256(marshal.dumps(method.__code__)).hexdigest()}"
        for effect in model.effects
        for kind in type(effect).__mro__
        if not kind.__module__.startswith("identifiability.")
        for name, method in vars(kind).items()
        if hasattr(method, "__code__")
    ] + [repr(parameter) for parameter in model.parameters.values()]


def _to_arrays(candidate: Candidate) -> dict[str, np.ndarray]:
    plain = {
        "values": candidate.values,
        "free": candidate.free,
        "at_bound": candidate.at_bound,
        "n_agreeing": int(candidate.n_agreeing),
        "n_starts": candidate.n_starts,
        "refined": candidate.refined,
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
    for name in ("free", "at_bound", "refined"):
        plain[name] = tuple(plain[name])
    if plain["scheme"] is not None:
        plain["scheme"] = Scheme(**plain["scheme"])
    fitted, held_out = (_residual(name, arrays) for name in ("fitted", "held_out"))
    return Candidate(model, fitted=fitted, held_out=held_out, **plain)


def _residual(name: str, arrays: Mapping[str, np.ndarray]) -> Residual:
    ends = np.cumsum(arrays[f"{name}_sizes"])
    by_trial = np.split(arrays[f"{name}_samples"], ends)[:-1]
    return Residual(tuple(by_trial), arrays[f"{name}_errors"], float(arrays[f"{name}_weighted"]))
