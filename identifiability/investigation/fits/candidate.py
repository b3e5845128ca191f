"""A model fitted to the trials, and what it leaves of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.joint.model import Model
from identifiability.joint.scheme import Scheme


@dataclass(frozen=True, eq=False)
class Residual:
    """What a model leaves of one part of the evidence.

    Attributes
    ----------
    by_trial : tuple of array
        Measured minus predicted response at the compared samples, freed of an unknown offset.
    errors : array, shape (n_trials,)
        E (Eq. 3) of each trial.
    weighted : float
        Sum of the squared residuals, each in units of its trial's weight.
    """

    by_trial: tuple[np.ndarray, ...]
    errors: np.ndarray
    weighted: float

    @property
    def error(self) -> float:
        """E pooled over trials: the mean, so that each weighs by its own energy."""
        return float(np.mean(self.errors))

    @property
    def n_samples(self) -> int:
        """Number of compared samples."""
        return sum(r.size for r in self.by_trial)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model fitted to the evidence.

    Attributes
    ----------
    model : Model
    values : mapping of str to float
        Parameters.
    free : tuple of str
        Those that were fitted; the others refine an effect and keep their plain value.
    fitted, held_out : Residual
    at_bound : tuple of str
    n_agreeing, n_starts : int
        Number of starts that reached the best cost, and of all.
    refined : tuple of str
        Keys of the effects whose refining parameters were fitted too.
    seconds : float
    scheme : Scheme or None
        How its responses were integrated, in this fit and in all that is said of it.
    solver_error : float or None
        Change of the response, as an error E, when the step is halved: at most a tenth of the noise
        (see `Rules.solver_share`). 0 where the response is exact, ``None`` where nothing was
        fitted.
    failure : str
        Why there is no fit; then the residuals are empty and the errors infinite.
    """

    model: Model
    values: Mapping[str, float]
    free: tuple[str, ...]
    fitted: Residual
    held_out: Residual
    at_bound: tuple[str, ...] = ()
    n_agreeing: int = 0
    n_starts: int = 0
    refined: tuple[str, ...] = ()
    seconds: float = 0.0
    failure: str = ""
    scheme: Scheme | None = None
    solver_error: float | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the model's effects."""
        return self.model.effect_keys


NOTHING = Residual((), np.array([np.inf]), float("inf"))


def unfitted(
    model: Model,
    values: Mapping[str, float],
    refined: Sequence[str] = (),
    scheme: Scheme | None = None,
) -> Candidate:
    """A model that is not fitted yet, with values to start from."""
    return Candidate(model, values, (), NOTHING, NOTHING, refined=tuple(refined), scheme=scheme)
