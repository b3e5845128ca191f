"""A model fitted to one record alone, with the noise of that record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior.evidence import Evaluated
from identifiability.investigation.posterior.noises import Weighed, raw_residuals
from identifiability.investigation.session import Investigation, evaluations_of
from identifiability.joint.model import KBI, Model


@dataclass(frozen=True, eq=False)
class FittedAlone:
    """A model with the noise of one record.

    Attributes
    ----------
    found : Evaluated
    weighed : Weighed
        Its whitened residuals, in that noise.
    log_evidence : float
        Above that of K, B and I.
    """

    found: Evaluated
    weighed: Weighed
    log_evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.weighed.names

    @property
    def _shift(self) -> np.ndarray:
        """What the operating point that was taken off adds to each parameter."""
        levels = [ready.treatment.angle for ready in self.weighed.band.prepared]
        parameters = self.weighed.model.parameters
        moves = [parameters[name].with_level for name in self.names]
        return np.array(moves, float) * float(np.mean(levels))

    def recorded(self, x: np.ndarray) -> np.ndarray:
        """Parameters by the record's own angles, of those from its operating point."""
        return np.asarray(x - self._shift)

    def residuals(self, recorded: np.ndarray) -> np.ndarray:
        """Whitened residuals of parameters by the record's own angles."""
        return self.weighed.residuals(recorded + self._shift)

    def jacobian(self, recorded: np.ndarray) -> np.ndarray:
        """Derivatives of `residuals`."""
        return self.weighed.jacobian(recorded + self._shift)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of parameters by the record's own angles."""
        return self.recorded(self.weighed.lower), self.recorded(self.weighed.upper)

    def vaf(self, recorded: np.ndarray) -> float:
        """Variance accounted for [%] by parameters by the record's own angles."""
        band = self.weighed.band
        x = np.clip(recorded + self._shift, self.weighed.lower, self.weighed.upper)
        left = np.concatenate(raw_residuals(self.weighed.problem, band, x)[0])[:, 0]
        return float(100 * (1 - np.mean(left**2) / band.scale**2))

    @property
    def sds(self) -> dict[str, float]:
        """Standard deviations by this record alone; what is at a bound has none."""
        inside = [i for i, name in enumerate(self.names) if self.found.sds[name] > 0]
        sds = standard_deviations(self.weighed.jacobian(self.found.x)[:, inside])
        return {self.names[i]: float(sd) for i, sd in zip(inside, sds, strict=True)}

    @property
    def squares(self) -> float:
        """Sum of squares at its own best values."""
        residuals = self.weighed.residuals(self.found.x)
        return float(residuals @ residuals)


def fitted_alone(
    study: Investigation, model: Model, refined: Sequence[str], seed: int
) -> FittedAlone:
    """Fit a model to a record, its effects from all their starts.

    Parameters
    ----------
    study : Investigation
        Of the record.
    model : Model
    refined : sequence of str
        Keys of effects whose refining parameters are free too.
    seed : int

    Raises
    ------
    InputError
        Where it cannot be fitted.
    """
    kept, base = evaluations_of(study, seed), study.baseline
    if base.failure:
        raise InputError(base.failure)
    plain = kept.evaluate(KBI(), [base.values])
    found = plain
    if model.effect_keys:
        starts = starting_values(model, plain.values, wide=True)
        found = kept.evaluate(model, starts, nested=plain)
        if forms := model.refinable(refined):
            found = kept.evaluate(model, [found.values], refined=forms, nested=found)
    weighed = Weighed(found.problem, kept.evaluator.band, found.weights)
    return FittedAlone(found, weighed, found.log_evidence - plain.log_evidence)


def standard_deviations(jacobian: np.ndarray) -> np.ndarray:
    """Standard deviations by the curvature of a sum of squares."""
    scale = np.maximum(np.sqrt(np.sum(jacobian**2, axis=0)), 1e-300)
    # By singular values: squares of a ridge's would be lost.
    _, values, turns = np.linalg.svd(jacobian / scale, full_matrices=False)
    spread = turns.T / np.maximum(values, 1e-12)
    return np.asarray(np.sqrt(np.sum(spread**2, axis=1)) / scale)
