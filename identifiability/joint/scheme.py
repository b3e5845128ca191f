"""How a model is integrated: exactly, or in steps that follow from it and the sampling interval."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jax.typing import ArrayLike

from identifiability.errors import InputError
from identifiability.joint.model import Imposed, Model

_SECOND, _FOURTH = 0.1, 0.75
"""Radians or e-folds of the fastest change in one step, at which dry friction, the least smooth of
the effects, is integrated to E = 1e-5 by the second-order scheme and to 1e-6 by the fourth."""
_SECOND_STABLE, _FOURTH_STABLE = 2.0, 2.75
"""E-folds of what settles in one step, from which on Runge-Kutta steps are not stable."""
_MOST_SECOND = 4  # steps of second order, from which on fewer of fourth order are quicker

SHARE, LEAST, MOST = 0.1, 1e-7, 1e-5
"""Error E of the integration over the E that a fit cannot do without (the noise's, or its own),
from which on its steps are made finer; and bounds of that error, whatever the fit leaves."""

MOST_SUBSTEPS = 128
"""Steps per sampling interval beyond which a model counts as too fast for its samples."""


@dataclass(frozen=True)
class Scheme:
    """Steps in which the response of a model is computed.

    Attributes
    ----------
    substeps : int
        Exponential Runge-Kutta steps per sampling interval; 0 for the exact response of a linear
        model.
    order : {4, 2}
        Power of the step with which the error falls.
    """

    substeps: int
    order: Literal[2, 4] = 4

    def __post_init__(self) -> None:
        if self.substeps < 0 or self.order not in (2, 4):
            raise InputError(
                f"found {self.substeps} steps of order {self.order} per sample, expected a "
                "positive number (0: exact) of order 2 or 4"
            )

    @classmethod
    def for_model(
        cls,
        model: Model,
        theta: ArrayLike,
        interval: float,
        imposed: Imposed = "torque",
        *,
        curved: bool = False,
    ) -> Scheme:
        """Scheme that suits a model: exact if it is linear, else as its fastest effect asks.

        The number of steps is a power of two.

        Parameters
        ----------
        model : Model
        theta : array, shape (n_parameters,)
        interval : float
            Sampling interval [s].
        imposed : {"torque", "angle"}
            Under an imposed angle only effects with states of their own need steps.
        curved : bool
            Whether the torque bends between its samples, of which steps of second order see only
            the ends.
        """
        if model.linear:
            return EXACT
        values = dict(zip(model.parameter_names, map(float, np.asarray(theta)), strict=True))
        turned = model.pace(values, imposed) * interval
        settled = model.settling(values, imposed) * interval
        second = max(turned / _SECOND, settled / _SECOND_STABLE)
        if second <= _MOST_SECOND and not curved:
            return cls(_power_of_two(second), 2)
        fourth = max(turned / _FOURTH, settled / _FOURTH_STABLE)
        return cls(min(_power_of_two(fourth), MOST_SUBSTEPS), 4)

    @property
    def exact(self) -> bool:
        """Whether nothing is integrated."""
        return self.substeps == 0

    @property
    def halved(self) -> Scheme:
        """The same with steps half as long: what tells the error of this one."""
        return replace(self, substeps=2 * self.substeps)

    @property
    def shown(self) -> float:
        """Share of the error E (a square) that half the step shows: the half has an error too."""
        return (1 - 2.0**-self.order) ** 2

    def improved(self, ratio: float) -> Scheme:
        """The scheme whose error E (a square) should be so many times smaller; at least halved.

        Where the steps are far too long their error says little, so what is found is to be checked
        again.
        """
        factor = max(2.0, ratio ** (0.5 / self.order))
        substeps = _power_of_two(self.substeps * factor)
        if self.order == 2 and substeps > _MOST_SECOND:
            return Scheme(max(substeps // 4, 1), 4)
        return Scheme(min(substeps, MOST_SUBSTEPS), self.order)

    def up_to(self, finest: Scheme) -> Iterator[Scheme]:
        """Schemes each finer than the one before, from this one to another, both left out."""
        scheme = self.improved(1.0)
        while finest.is_finer_than(scheme):
            yield scheme
            scheme = scheme.improved(1.0)

    def within(self, most: int) -> Scheme:
        """The same in so many steps a sample at most."""
        return replace(self, substeps=min(self.substeps, most))

    def between(self, readings: int) -> int:
        """Steps from one reading of an instrument to the next, of so many in an interval."""
        return -(-self.substeps // readings)

    @property
    def finest(self) -> bool:
        """Whether it is as fine as schemes get."""
        return self.substeps >= MOST_SUBSTEPS

    def is_finer_than(self, other: Scheme) -> bool:
        """Whether it does more work, or work of a higher order."""
        return (self.substeps * self.order, self.order) > (
            other.substeps * other.order,
            other.order,
        )

    def check(self, model: Model) -> None:
        """Refuse to compute a model by a scheme that does not suit it.

        Raises
        ------
        InputError
            Where the exact response is asked of a model that has none.
        """
        if self.exact and not model.linear:
            raise InputError(
                f"found no steps for {model!r}, which has no exact response; leave the scheme to "
                "Scheme.for_model, or give Scheme(substeps)"
            )

    def __str__(self) -> str:
        if self.exact:
            return "exact"
        steps = "step" if self.substeps == 1 else "steps"
        return f"{self.substeps} {steps} a sample of order {self.order}"


EXACT = Scheme(0)
"""The exact response, of linear models."""


def _power_of_two(number: float) -> int:
    """The next power of two, from 1 on."""
    limited = min(max(number, 1.0), 2.0 * MOST_SUBSTEPS)
    return 1 << math.ceil(math.log2(limited) - 1e-9)
