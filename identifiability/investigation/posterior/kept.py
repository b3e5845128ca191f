"""Models that were weighed are kept on disk, so that a weighing that was stopped goes on.

Of a model its parameters are kept, its steps and the orders among which its noise was sought. All
else follows from these and the data, as it did at first.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from identifiability.files import read_arrays, write_arrays
from identifiability.inference.likelihood.estimate import Contender, Order
from identifiability.investigation.fits.kept import question
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.noises import Weights, raw_residuals
from identifiability.joint.model import Model
from identifiability.joint.scheme import MOST_SUBSTEPS, Scheme
from identifiability.provenance import code_fingerprint


@dataclass(frozen=True)
class Evaluations:
    """Evaluates models, each once.

    Attributes
    ----------
    evaluator : Evaluator
    folder : Path or None
        Where they are kept; nowhere by default.
    identity : str
        Of the trials and all else that the evaluator was made of.
    """

    evaluator: Evaluator
    folder: Path | None = None
    identity: str = ""

    def evaluate(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
        noise: Weights | None = None,
        least: float = -np.inf,
        resolved: bool = True,
        steps: int = MOST_SUBSTEPS,
        nested: Evaluated | None = None,
        begun: Evaluated | None = None,
        every_noise: bool = False,
    ) -> Evaluated:
        """Evaluate a model, or take it up as it was found: see `Evaluator.evaluate`."""
        within = None if nested is None else (nested.values, nested.log_likelihood)
        how = starts, refined, scheme, least, resolved, steps, within, every_noise, begun is None
        path = self._path(model, noise, *how)
        found = _taken_up(path, self.evaluator, model, refined)
        if found is None:
            found = self.evaluator.evaluate(
                model,
                starts,
                refined=refined,
                scheme=scheme,
                noise=noise,
                least=least,
                resolved=resolved,
                steps=steps,
                nested=nested,
                begun=begun,
                every_noise=every_noise,
            )
            _keep(found, path)
        return found

    def resolved(
        self, found: Evaluated, least: float = -np.inf, steps: int = MOST_SUBSTEPS
    ) -> Evaluated:
        """Fit a model on in shorter steps, or take that up: see `Evaluator.resolved`."""
        how = found.values, found.refined, found.scheme, least, steps
        path = self._path(found.model, found.weights, "resolved", *how)
        best = _taken_up(path, self.evaluator, found.model, found.refined)
        if best is None:
            best = self.evaluator.resolved(found, least, steps)
            _keep(best, path)
        return best

    def roughly(
        self,
        model: Model,
        starts: Sequence[Mapping[str, float]],
        *,
        refined: Sequence[str] = (),
        noise: Weights | None = None,
        every_noise: bool = False,
    ) -> Evaluated | None:
        """Begin to fit a model, or take that up as it was found: see `Evaluator.roughly`."""
        fewer = self.evaluator.coarse
        if fewer is None:
            return None
        path = self._path(model, noise, starts, refined, every_noise, "roughly")
        found = _taken_up(path, fewer, model, refined)
        if found is None:
            found = self.evaluator.roughly(
                model, starts, refined=refined, noise=noise, every_noise=every_noise
            )
            _keep(found, path)
        return found

    def _path(self, model: Model, noise: Weights | None, *how: object) -> Path | None:
        if self.folder is None:
            return None
        start = None if noise is None else (noise.estimate.levels, noise.contenders)
        return self.folder / f"{_code()}-{question(self.identity, model, start, *how)}.npz"


def _taken_up(
    path: Path | None, evaluator: Evaluator, model: Model, refined: Sequence[str]
) -> Evaluated | None:
    """A model as it was kept; None where it was not."""
    stored = read_arrays(path) if path is not None else None
    if stored is None:
        return None
    plain = json.loads(str(stored["evaluated"]))
    problem = evaluator.band.problem(
        model,
        refined=refined,
        scheme=Scheme(**plain["scheme"]),
        probes=evaluator.reference.probes_of(model),
    )
    sought = [Contender(Order(*order), np.array(v, float)) for order, v in plain["sought"]]
    raw = raw_residuals(problem, evaluator.band, stored["x"])[0]
    weights = evaluator.reference.weights(raw, sought)
    return evaluator.evaluated(problem, stored["x"], weights, refined, sought)


def _keep(found: Evaluated | None, path: Path | None) -> None:
    if path is None or found is None:
        return
    plain = {
        "scheme": asdict(found.scheme),
        "sought": [
            [[o.p, o.q, bool(o.carried)], np.asarray(values, float).tolist()]
            for o, values in found.sought
        ],
    }
    write_arrays(path, {"evaluated": np.array(json.dumps(plain)), "x": found.x})


def _code() -> str:
    """Beginning of the names of what this code found."""
    return code_fingerprint("identifiability.investigation.posterior.search")[:12]
