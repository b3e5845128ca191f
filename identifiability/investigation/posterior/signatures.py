"""Effects whose signature is in what a model leaves, as its noise weighs it.

The signature is the change of the model's response by a small effect more, at the shapes that a fit
would start from and at the one it had beside K, B and I. Of it only the part counts that the
model's own parameters cannot absorb. It is sought in the model's own noise and in white noise:
noise of long memory may have taken the place of what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from identifiability.inference.problem import Problem
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.band import Band
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.noises import Weights
from identifiability.joint.effects import Effect
from identifiability.joint.model import Model
from identifiability.joint.programs import THREADS

_NEGLIGIBLE = 1e-8  # of directions that repeat each other


def strongest(
    evaluator: Evaluator,
    found: Evaluated,
    effects: Mapping[str, type[Effect]],
    alone: Mapping[str, Mapping[str, float]],
    most: int,
    plainly: bool = False,
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
        Number of effects to keep by each noise; together up to half as many more.
    plainly : bool
        Whether by white noise alone.
    """
    if len(effects) <= most:
        return list(effects)
    if evaluator.coarse is not None:
        # A part of a long record shows as well whose signature is the strongest.
        found, evaluator = evaluator.coarse.as_it_is(found), evaluator.coarse
    models = {key: found.model + effect() for key, effect in effects.items()}
    problems = {key: _problem(evaluator, model, found) for key, model in models.items()}
    shapes = {key: starting_values(model, found.values) for key, model in models.items()}
    for key in alone.keys() & shapes:
        shapes[key].append({**alone[key], **found.values})
    # In the same steps: what their length changes is no signature.
    own = _problem(evaluator, found.model, found)
    plain = [own.with_scheme(s) for s in {p.integration: None for p in problems.values()}]
    tasks = [(problem, found.values) for problem in plain]
    tasks += [(problems[key], values) for key, mine in shapes.items() for values in mine]
    with ThreadPoolExecutor(THREADS) as pool:
        residuals = pool.map(lambda task: _residual(evaluator.band, *task), tasks)
    before = {problem.integration: next(residuals) for problem in plain}
    changes = {
        key: [next(residuals) - before[problems[key].integration] for _ in mine]
        for key, mine in shapes.items()
    }
    kept: set[str] = set()
    noises = [(evaluator.white, most)]
    if not plainly:
        noises = [(found.weights, most), (evaluator.white, most // 2)]
    for weights, n in noises:
        left = _Left(evaluator, found, weights)
        scores = {key: max(map(left.removed, mine)) for key, mine in changes.items()}
        kept |= set(sorted(scores, key=lambda key: -scores[key])[:n])
    return [key for key in effects if key in kept]


def _problem(evaluator: Evaluator, model: Model, found: Evaluated) -> Problem:
    """A model in steps at least as short as another's, with as much of it in richer form."""
    problem = evaluator.band.problem(model, refined=found.refined)
    finer = found.scheme.is_finer_than(problem.integration)
    return problem.with_scheme(found.scheme) if finer else problem


def _residual(band: Band, problem: Problem, values: Mapping[str, float]) -> np.ndarray:
    """What a model leaves of all that is compared, one stretch after the other."""
    return np.concatenate(band.residuals(problem, problem.free_vector(values)))[:, 0]


class _Left:
    """What a model leaves, as one noise weighs it, beyond what its parameters could absorb."""

    def __init__(self, evaluator: Evaluator, found: Evaluated, weights: Weights) -> None:
        self.band, self.weights = evaluator.band, weights
        white = weights.whitened(found.raw)
        directions = white[:, 1:] @ found.turns
        size = np.maximum(np.linalg.norm(directions, axis=0), 1e-300)
        # An orthonormal basis of what is not next to nothing.
        basis, lengths, _ = np.linalg.svd(directions / size, full_matrices=False)
        self.basis = basis[:, lengths > _NEGLIGIBLE]
        self.residual = self._rest(white[:, 0])

    def _rest(self, white: np.ndarray) -> np.ndarray:
        return white - self.basis @ (self.basis.T @ white)

    def removed(self, change: np.ndarray) -> float:
        """Share of the squares that a change of the right size removes; 0 if it is not finite."""
        if not np.all(np.isfinite(change)):
            return 0.0
        # Of size 1: the square of one that diverges may be beyond all numbers.
        largest = float(np.max(np.abs(change)))
        if not largest:
            return 0.0
        ends = np.cumsum([samples.size for samples in self.band.samples])[:-1]
        by_stretch = np.split((change / largest)[:, None], ends)
        white = self._rest(self.weights.whitened(by_stretch)[:, 0])
        size = float(white @ white)
        return float(white @ self.residual) ** 2 / size if size > 0 else 0.0
