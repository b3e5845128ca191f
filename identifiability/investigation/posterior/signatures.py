"""Effects whose signature is in what a model leaves, as its own noise weighs it.

The signature is the change of K, B and I's response by a small effect, at the shapes that a fit
would start from and at the one it had alone. Of it only the part counts that the model's own
parameters cannot absorb.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.joint.effects import Effect
from identifiability.joint.model import KBI, Model


def strongest(
    evaluator: Evaluator,
    found: Evaluated,
    effects: Mapping[str, type[Effect]],
    alone: Mapping[str, Mapping[str, float]],
    most: int,
) -> list[str]:
    """Effects of the strongest signatures, in the order of the library.

    Parameters
    ----------
    evaluator : Evaluator
    found : Evaluated
        The model.
    effects : mapping of str to type of Effect
        Those that may be added to it.
    alone : mapping of str to mapping
        Values of the parameters that effects had beside K, B and I, where they were fitted.
    most : int
        Number of effects to keep.
    """
    if len(effects) <= most:
        return list(effects)
    joint = {name: found.values[name] for name in ("K", "B", "I")}
    plain = _residual(evaluator, KBI(), joint)
    scores = {}
    for key, effect in effects.items():
        model = KBI() + effect()
        shapes = starting_values(model, joint)
        if key in alone:
            shapes.append({**alone[key], **joint})
        changes = [_residual(evaluator, model, shape) - plain for shape in shapes]
        scores[key] = max(_score(evaluator, found, change) for change in changes)
    ranked = sorted(scores, key=lambda key: -scores[key])[:most]
    return [key for key in effects if key in ranked]


def _residual(evaluator: Evaluator, model: Model, values: Mapping[str, float]) -> np.ndarray:
    """By observation and sample, those of the probes included."""
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    return problem.residuals(problem.free_vector(values))


def _score(evaluator: Evaluator, found: Evaluated, change: np.ndarray) -> float:
    """Decrease of the sum of squares by a change of the right size; 0 where it is not finite."""
    band = evaluator.band
    rows = change.reshape(max(len(band.observations), band.room[0]), -1, 1)
    if not np.all(np.isfinite(rows)):
        return 0.0
    white = found.weights.whitened(band.stretches(rows))[:, 0]
    white = white - found.directions @ np.linalg.solve(found.precision, found.directions.T @ white)
    size = float(white @ white)
    return float(white @ found.white) ** 2 / size if size > 0 else 0.0
