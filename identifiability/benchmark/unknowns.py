"""Hidden effects outside the usual list: the right verdict is that none of the known ones fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.effects import AT_REST, HiddenEffect, Past, Reaction, TorqueEffect


@dataclass(frozen=True)
class TimeVaryingStiffness(TorqueEffect):
    """Stiffness that swings while the trial lasts, as under a changing co-contraction.

    Attributes
    ----------
    stiffness : float
        Amplitude (Nm/rad) of the swing.
    frequency : float
        Of the swing (Hz), in phase with the beginning of every trial.
    """

    stiffness: float
    frequency: float
    key = "time_varying_stiffness"
    forms = ("sinusoidal",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a swing of 20 to 50 % of the joint's stiffness at 1.5 to 5 Hz."""
        return cls(rng.uniform(0.2, 0.5) * anatomy.stiffness, rng.uniform(1.5, 5.0))

    def scaled(self, size: float) -> Self:
        """Scale the swing."""
        return self._times(size, "stiffness")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        return self.stiffness * math.sin(2.0 * math.pi * self.frequency * time) * angle, AT_REST


@dataclass(frozen=True)
class BoucWenHysteresis(TorqueEffect):
    """Hysteresis after Bouc and Wen (Wen 1976, J Eng Mech 102:249).

    With ``-beta <= gamma <= beta`` it never gives energy (Erlicher & Point 2004, C R Mecanique
    332:51). With gamma below zero it stiffens on every reversal, which yielding cross-bridges, that
    have ``beta = gamma``, do not.

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) from rest.
    limit : float
        Stretch (rad) at which it yields.
    beta, gamma : float
        Shape of the loop; their sum is 1.
    power : float
        Sharpness of the yielding.
    """

    stiffness: float
    limit: float
    beta: float
    gamma: float
    power: float
    key = "bouc_wen"
    forms = ("stiffening_on_reversal",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a loop that stiffens on reversal and yields after 0.04 to 0.12 rad."""
        beta = rng.uniform(2.0, 3.0)
        return cls(
            rng.uniform(0.6, 1.5) * anatomy.stiffness,
            rng.uniform(0.04, 0.12),
            beta,
            1.0 - beta,
            rng.uniform(1.2, 2.0),
        )

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def n_states(self) -> int:  # noqa: D102
        return 1

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        stretch = states[0]
        shape = self.beta * math.copysign(1.0, stretch * velocity) + self.gamma
        rate = velocity * (1.0 - shape * (abs(stretch) / self.limit) ** self.power)
        return self.stiffness * stretch, (rate,)


@dataclass(frozen=True)
class FractionalDamping(TorqueEffect):
    r"""Spring-pot: a torque of `coefficient` times the derivative of fractional `order`.

    The derivative is a continuum of relaxations (diffusive representation),

    .. math:: s^\alpha = \frac{\sin \pi\alpha}{\pi} \int_0^\infty
              \mu^{\alpha - 1} \frac{s}{s + \mu} \, d\mu ,

    here two Maxwell branches a decade; slower ones act as a spring, faster ones as a dashpot. Up
    to 100 Hz that is exact within 1 %.

    Attributes
    ----------
    coefficient : float
        In Nm s^order / rad.
    order : float
        Between 0 (spring) and 1 (dashpot).
    """

    coefficient: float
    order: float
    key = "fractional_damping"
    forms = ("spring_pot",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw an impedance of 0.8 to 1.6 times the stiffness at the joint's frequency."""
        order = rng.uniform(0.35, 0.65)
        frequency = math.sqrt(anatomy.stiffness / anatomy.inertia)
        return cls(rng.uniform(0.8, 1.6) * anatomy.stiffness / frequency**order, order)

    def scaled(self, size: float) -> Self:
        """Scale its coefficient."""
        return self._times(size, "coefficient")

    @cached_property
    def rates(self) -> tuple[float, ...]:
        """Rates (1/s) of the branches."""
        return tuple(0.1 * 10.0 ** (0.5 * k) for k in range(10))

    @cached_property
    def gains(self) -> tuple[float, ...]:
        """Stiffnesses (Nm/rad) of the branches."""
        return tuple(self._density * rate**self.order * 0.5 * math.log(10.0) for rate in self.rates)

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Stiffness (Nm/rad) and damping (Nms/rad) that stand for all other branches."""
        slowest, fastest = self.rates[0] / 10**0.25, self.rates[-1] * 10**0.25
        spring = self._density * slowest**self.order / self.order
        return spring, self._density * fastest ** (self.order - 1.0) / (1.0 - self.order)

    @cached_property
    def _density(self) -> float:
        return self.coefficient * math.sin(math.pi * self.order) / math.pi

    def n_states(self) -> int:  # noqa: D102
        return len(self.rates)

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        spring, dashpot = self.ends
        torque = spring * angle + dashpot * velocity
        for gain, stretch in zip(self.gains, states, strict=True):
            torque += gain * stretch
        return torque, [
            velocity - rate * stretch for rate, stretch in zip(self.rates, states, strict=True)
        ]


@dataclass(frozen=True)
class QuadraticDrag(TorqueEffect):
    """Drag of a fluid, as the square of velocity.

    Attributes
    ----------
    coefficient : float
        In Nm s²/rad².
    """

    coefficient: float
    key = "quadratic_drag"
    forms = ("square",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw drag that at 2 to 7 rad/s equals the joint's damping."""
        return cls(rng.uniform(0.15, 0.5) * anatomy.damping)

    def scaled(self, size: float) -> Self:
        """Scale its coefficient."""
        return self._times(size, "coefficient")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        return self.coefficient * abs(velocity) * velocity, AT_REST


@dataclass(frozen=True)
class CoggingTorque(TorqueEffect):
    """Torque that comes and goes with the angle, as between a motor's magnets and teeth.

    Attributes
    ----------
    torque : float
        Amplitude (Nm).
    pitch : float
        Angle (rad) from tooth to tooth.
    """

    torque: float
    pitch: float
    key = "cogging"
    forms = ("sinusoidal",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw teeth 0.06 to 0.15 rad apart, as steep as 0.8 to 2 times the joint's stiffness."""
        pitch = rng.uniform(0.06, 0.15)
        steep = rng.uniform(0.8, 2.0) * anatomy.stiffness
        return cls(steep * pitch / (2.0 * math.pi), pitch)

    def scaled(self, size: float) -> Self:
        """Scale its torque."""
        return self._times(size, "torque")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        return self.torque * math.sin(2.0 * math.pi * angle / self.pitch), AT_REST


@dataclass(frozen=True)
class Thixotropy(TorqueEffect):
    """Stiffness that motion breaks down and rest restores (Lakie & Robson 1988, QJEP 73:487).

    Attributes
    ----------
    stiffness : float
        In Nm/rad, after long rest.
    recovery : float
        Time constant (s) of the restoring.
    path : float
        Way (rad) after which motion has broken it down.
    """

    stiffness: float
    recovery: float
    path: float
    key = "thixotropy"
    forms = ("first_order",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw 0.5 to 1.5 of the joint's stiffness, lost within 0.05 to 0.2 rad, back in 1-5 s."""
        return cls(
            rng.uniform(0.5, 1.5) * anatomy.stiffness,
            rng.uniform(1.0, 5.0),
            rng.uniform(0.05, 0.2),
        )

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def n_states(self) -> int:  # noqa: D102
        return 1

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        broken = states[0]
        rate = (1.0 - broken) * abs(velocity) / self.path - broken / self.recovery
        return self.stiffness * (1.0 - broken) * angle, (rate,)


UNKNOWNS: dict[str, type[HiddenEffect]] = {
    effect.key: effect
    for effect in (
        TimeVaryingStiffness,
        BoucWenHysteresis,
        FractionalDamping,
        QuadraticDrag,
        CoggingTorque,
        Thixotropy,
    )
}
"""Effects outside the usual list, by key."""
