"""What a model's parameters may be before the data: proper priors, free of units.

K, B and I may be anything that makes up to four times the measured response, alike in all models;
an effect most likely makes a response no larger than what was measured; its shape is anything
between the physical bounds, by ratios where these span more than one decade; of what joints have
little of, more is less likely. A stiffness that vanishes as it grows counts by its compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from identifiability.inference.problem import Problem

_DECADE = 10.0  # ratio of bounds from which a shape's prior is uniform by ratios
_NOTHING = 1e-12  # of the response, that a parameter adds over all its room
_JOINT_RANGE = 4.0  # responses to K, B or I, over the measured one, that the prior spans


@dataclass(frozen=True)
class Prior:
    """Prior of one free parameter, in the coordinate in which the evidence is taken.

    Attributes
    ----------
    form : {"uniform", "ratio", "size", "compliance", "typical"}
        Uniform in the parameter or in its logarithm; normal in its distance from where the effect
        vanishes, which of a stiffness is its compliance; or normal in its logarithm.
    width : float
        Of a uniform one the range, of a normal one the standard deviation.
    null : float
        Value at which the effect vanishes; of a typical one, the median.
    one_sided : bool
        Whether a normal one has only one side.
    """

    form: Literal["uniform", "ratio", "size", "compliance", "typical"]
    width: float
    null: float = 0.0
    one_sided: bool = False

    @property
    def sd(self) -> float:
        """Standard deviation of a normal density of the same height: it too integrates to 1."""
        return self.width / np.sqrt(2 * np.pi) if self.form in ("uniform", "ratio") else self.width

    def turn(self, value: float) -> float:
        """Derivative of the parameter with respect to the coordinate."""
        turns = {"ratio": value, "typical": value, "compliance": -(value**2)}
        return turns.get(self.form, 1.0)

    def distance(self, value: float) -> float:
        """Of the coordinate from where the effect vanishes; 0 for what makes none vanish."""
        if self.form == "compliance":
            return 1 / value
        if self.form == "typical":
            return float(np.log(max(value, 1e-300) / self.null))
        return value - self.null if self.form == "size" else 0.0

    def pull(self, value: float) -> float:
        """Derivative of the logarithm of the density, by the coordinate."""
        return 0.0 if self.form in ("uniform", "ratio") else -self.distance(value) / self.width**2

    def log_density(self, value: float) -> float:
        """Logarithm of the density by the coordinate."""
        if self.form in ("uniform", "ratio"):
            return -float(np.log(self.width))
        normal = -0.5 * (self.distance(value) / self.width) ** 2
        return float(normal - np.log(self.width * np.sqrt(2 * np.pi) / (1 + self.one_sided)))


def joint_widths_of(raw: Sequence[np.ndarray], scale: float) -> np.ndarray:
    """Ranges of K, B and I, shape (3,), from what `raw_residuals` gives of this model alone."""
    return _JOINT_RANGE * scale / np.maximum(_sizes(raw), 1e-300)


def _sizes(raw: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean square of what a unit of each free parameter adds to the response."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(raw)[:, 1:] ** 2, axis=0)))


def _width(scale: float, size: float, room: float) -> float:
    """Of a size's prior; all its room where a unit of it adds nothing there."""
    room = min(room, 1 / _NOTHING)
    return scale / size if size > _NOTHING * scale / room else room


def priors_of(
    problem: Problem,
    x: np.ndarray,
    raw: Sequence[np.ndarray],
    scale: float,
    joint_widths: np.ndarray,
) -> list[Prior]:
    """Priors of the free parameters at a point, by what a unit of each adds to the response.

    Parameters
    ----------
    problem : Problem
    x : array, shape (n_free,)
    raw : sequence of array
        By stretch, the residual there and its derivatives.
    scale : float
        Of the response [rad or Nm].
    joint_widths : array, shape (3,)
        Ranges of K, B and I.
    """
    out = []
    values = dict(zip(problem.model.parameter_names, problem.complete(x), strict=True))
    typical = {n: t for e in problem.model.effects for n, t in e.typical(values).items()}
    for name, value, low, high, size in zip(
        problem.names, x, problem.lower, problem.upper, _sizes(raw), strict=True
    ):
        parameter = problem.model.parameters[name]
        null = parameter.null
        if name in ("K", "B", "I"):
            width = float(joint_widths[("K", "B", "I").index(name)])
            out.append(Prior("uniform", width))
        elif name in typical:
            median, spread = typical[name]
            out.append(Prior("typical", spread, median))
        elif parameter.spread is not None:
            out.append(Prior("size", parameter.spread, parameter.lower, one_sided=True))
        elif null is None and low > 0 and high > _DECADE * low:
            out.append(Prior("ratio", float(np.log(high / low))))
        elif null is None:
            out.append(Prior("uniform", float(high - low)))
        elif np.isfinite(null):
            width = _width(scale, float(size), high - low)
            out.append(Prior("size", width, null, null in (low, high)))
        else:
            width = _width(scale, float(size * value**2), 1 / max(low, _NOTHING))
            out.append(Prior("compliance", width, one_sided=True))
    return out
