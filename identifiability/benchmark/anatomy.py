"""Inertia, stiffness and damping of a hidden joint, and the muscle's share in them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Anatomy:
    """A joint of inertia, passive tissue and, beside it, muscle.

    Without a tendon muscle and passive tissue move together, and only their sums matter.

    Attributes
    ----------
    inertia : float
        Inertia (kg m²).
    passive_stiffness, muscle_stiffness : float
        Stiffness (Nm/rad).
    passive_damping, muscle_damping : float
        Damping (Nms/rad).
    """

    inertia: float
    passive_stiffness: float
    passive_damping: float
    muscle_stiffness: float
    muscle_damping: float

    @classmethod
    def draw(cls, rng: np.random.Generator, keys: Collection[str] = ()) -> Anatomy:
        """Draw a joint of 2 to 4 Hz, damped like a relaxed to moderately tensed limb.

        Parameters
        ----------
        rng : numpy.random.Generator
        keys : collection of str
            The effects the joint will have. Muscle behind a tendon needs more damping, because the
            tendon gives way; force-velocity behaviour is damping by itself and leaves less to add.
        """
        inertia = math.exp(rng.uniform(math.log(0.06), math.log(0.14)))
        frequency = rng.uniform(13.0, 21.0)
        stiffness = inertia * frequency**2
        damping = 2.0 * rng.uniform(0.2, 0.5) * inertia * frequency
        share, muscle_ratio = rng.uniform(0.1, 0.25), rng.uniform(0.7, 1.4)
        muscle_damping = (1.0 - share) * damping
        if {"series_tendon", "nonlinear_tendon"} & set(keys):
            muscle_damping = 2.0 * muscle_ratio * inertia * frequency
        if "hill_force_velocity" in keys:
            muscle_damping *= 0.3
        return cls(
            inertia, share * stiffness, share * damping, (1 - share) * stiffness, muscle_damping
        )

    @property
    def stiffness(self) -> float:
        """Stiffness (Nm/rad) of muscle and passive tissue together."""
        return self.passive_stiffness + self.muscle_stiffness

    @property
    def damping(self) -> float:
        """Damping (Nms/rad) of muscle and passive tissue together."""
        return self.passive_damping + self.muscle_damping

    @property
    def critical_damping(self) -> float:
        """Damping (Nms/rad) at which a joint of this stiffness and inertia ceases to oscillate."""
        return 2.0 * math.sqrt(self.stiffness * self.inertia)

    def scaled(self, stiffness: float, damping: float, inertia: float = 1.0) -> Anatomy:
        """Return the joint with its stiffnesses, dampings and inertia multiplied by factors."""
        return dataclasses.replace(
            self,
            inertia=self.inertia * inertia,
            passive_stiffness=self.passive_stiffness * stiffness,
            muscle_stiffness=self.muscle_stiffness * stiffness,
            passive_damping=self.passive_damping * damping,
            muscle_damping=self.muscle_damping * damping,
        )
