"""Hidden effects that an investigation should name, in their textbook physical forms.

Many have more than one form. The first is the plainest; the others are the same physics as a
biomechanist might equally write it down, so that a name cannot be earned by equal equations only.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from identifiability.benchmark.anatomy import Anatomy

Past = Callable[[float], tuple[float, float]]
"""Angle (rad) and velocity (rad/s) of the joint at an earlier time (s)."""

Reaction = tuple[float, Sequence[float]]
"""Torque (Nm) that resists the motion, and the rates of the effect's states."""

AT_REST: tuple[float, ...] = ()


class HiddenEffect(ABC):
    """A physical effect beside inertia, damping and stiffness.

    Attributes
    ----------
    key : str
        Name of the effect.
    forms : tuple of str
        Forms in which it can be drawn.
    """

    key: ClassVar[str]
    forms: ClassVar[tuple[str, ...]]

    @classmethod
    @abstractmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> HiddenEffect:
        """Draw parameters within their physiological ranges for a joint of this anatomy."""

    @abstractmethod
    def scaled(self, size: float) -> Self:
        """Return the effect at `size` times its size; it vanishes as the size goes to 0."""

    def _times(self, size: float, *names: str) -> Self:
        changes = {name: getattr(self, name) * size for name in names}
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]


class TorqueEffect(HiddenEffect):
    """An effect that resists the joint's motion by a torque, with states that are 0 at rest."""

    def n_states(self) -> int:
        """Number of states."""
        return 0

    def history(self) -> float:
        """How far back (s) the effect remembers the motion itself; 0 where it does not."""
        return 0.0

    @abstractmethod
    def react(
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        """Resist a motion.

        Parameters
        ----------
        time : float
            Time (s) since the trial began.
        angle, velocity : float
            Of the joint (rad, rad/s).
        states : sequence of float
            The effect's own states.
        past : callable
            The joint's earlier motion.
        """


# In series with the muscle


class Tendon(HiddenEffect):
    """An elastic element between the muscle and the joint."""

    @abstractmethod
    def tension(self, stretch: float) -> float:
        """Torque (Nm), as a deviation from rest, at a stretch (rad) from rest."""


@dataclass(frozen=True)
class SeriesTendon(Tendon):
    """Linear tendon. With passive tissue beside the muscle it is a Poynting-Thomson solid.

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) as seen at the joint.
    """

    stiffness: float
    key = "series_tendon"
    forms = ("linear",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw it 1.5 to 4 times as stiff as the muscle."""
        return cls(rng.uniform(1.5, 4.0) * anatomy.muscle_stiffness)

    def scaled(self, size: float) -> Self:
        """Scale its compliance."""
        return self._times(1.0 / size, "stiffness")

    def tension(self, stretch: float) -> float:  # noqa: D102
        return self.stiffness * stretch


@dataclass(frozen=True)
class NonlinearTendon(Tendon):
    """Tendon with an exponential toe (Zajac 1989, Crit Rev Biomed Eng 17:359).

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) at rest.
    toe : float
        Stretch (rad) that makes the tendon e times stiffer.
    preload : float
        Torque (Nm) at rest; where it is used up the tendon is slack.
    form : str
        "toe": one muscle, exponential up to `LINEAR_FROM` times the stiffness at rest, then linear.
        "antagonists": two muscles that pull against each other, equally stiff.
    """

    stiffness: float
    toe: float
    preload: float
    form: str
    key = "nonlinear_tendon"
    forms = ("toe", "antagonists")
    LINEAR_FROM: ClassVar[float] = 3.0

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw it, at rest, 1.2 to 2.5 times as stiff as the muscle."""
        stiffness = rng.uniform(1.2, 2.5) * anatomy.muscle_stiffness
        toe = rng.uniform(0.08, 0.2)
        return cls(stiffness, toe, rng.uniform(0.6, 0.9) * stiffness * toe, form)

    def scaled(self, size: float) -> Self:
        """Scale its compliance."""
        return self._times(1.0 / size, "stiffness")

    def tension(self, stretch: float) -> float:  # noqa: D102
        if self.form == "toe":
            return self._one(stretch)
        return 0.5 * (self._one(stretch) - self._one(-stretch))

    def _one(self, stretch: float) -> float:
        scale = self.stiffness * self.toe
        beyond = stretch - self.toe * math.log(self.LINEAR_FROM)
        if beyond > 0.0:
            return scale * (self.LINEAR_FROM - 1.0) + self.LINEAR_FROM * self.stiffness * beyond
        return max(scale * math.expm1(stretch / self.toe), -self.preload)


# Beside the muscle's stiffness and damping


@dataclass(frozen=True)
class HillForceVelocity(HiddenEffect):
    """Force-velocity relation of two antagonist muscles (Hill 1938; eccentric after Katz 1939).

    Attributes
    ----------
    flexor, extensor : float
        Isometric torques (Nm) with which they pull against each other; the flexor resists
        movement in the positive direction.
    top_speed : float
        Joint velocity (rad/s) at which a shortening muscle loses all its torque.
    curvature : float
        Hill's a over the isometric force.
    plateau : float
        Torque of a fast lengthening muscle over its isometric torque.
    """

    flexor: float
    extensor: float
    top_speed: float
    curvature: float
    plateau: float
    key = "hill_force_velocity"
    forms = ("hyperbolic",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw muscles that damp slow movements at 0.3 to 0.6 of critical damping."""
        top_speed, curvature = rng.uniform(6.0, 14.0), rng.uniform(0.2, 0.35)
        # Slow movements are damped by (flexor + extensor) (1 + 1 / curvature) / top_speed.
        damping = rng.uniform(0.3, 0.6) * anatomy.critical_damping
        isometric = 0.5 * damping * top_speed / (1.0 + 1.0 / curvature)
        ratio = rng.uniform(0.75, 1.3)
        return cls(isometric * ratio, isometric / ratio, top_speed, curvature, 1.4)

    def scaled(self, size: float) -> Self:
        """Scale the muscles' torques."""
        return self._times(size, "flexor", "extensor")

    def torque(self, velocity: float) -> tuple[float, float]:
        """Torque (Nm) that resists a velocity (rad/s), and its slope (Nms/rad)."""
        along, slope_along = self._relative(velocity / self.top_speed)
        against, slope_against = self._relative(-velocity / self.top_speed)
        torque = self.flexor * (along - 1.0) - self.extensor * (against - 1.0)
        slope = self.flexor * slope_along + self.extensor * slope_against
        return torque, slope / self.top_speed

    def _relative(self, lengthening: float) -> tuple[float, float]:
        """Force over isometric force, and its slope, at a velocity of lengthening."""
        k = self.curvature
        if lengthening > 0.0:
            gain = self.plateau - 1.0
            denominator = 1.0 + (1.0 + 1.0 / k) / gain * lengthening
            return self.plateau - gain / denominator, (1.0 + 1.0 / k) / denominator**2
        if lengthening > -1.0:
            denominator = 1.0 - lengthening / k
            return (1.0 + lengthening) / denominator, (1.0 + 1.0 / k) / denominator**2
        return 0.0, 0.0


# Torques at the joint


@dataclass(frozen=True)
class MaxwellBranch(TorqueEffect):
    """Spring and dashpot in series, beside the joint.

    Attributes
    ----------
    stiffness : float
        Of the spring (Nm/rad).
    relaxation : float
        Time (s) in which its torque falls to 1/e.
    """

    stiffness: float
    relaxation: float
    key = "maxwell_branch"
    forms = ("linear",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a spring of 0.8 to 2 times the joint's stiffness."""
        return cls(rng.uniform(0.8, 2.0) * anatomy.stiffness, rng.uniform(0.02, 0.08))

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def n_states(self) -> int:  # noqa: D102
        return 1

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        stretch = states[0]
        return self.stiffness * stretch, (velocity - stretch / self.relaxation,)


def _toward(excitation: float, activation: float, on: float, off: float) -> float:
    """Rate of an activation that rises fast and falls slowly (Zajac 1989)."""
    return (excitation - activation) / (on if excitation > activation else off)


@dataclass(frozen=True)
class ActivationLag(TorqueEffect):
    """Stiffness that muscle provides only after its activation has followed.

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) once activated.
    on, off : float
        Times (s) of activation and deactivation.
    form : str
        "first_order": one lag, `on`. "antagonists": each muscle answers its own stretch, fast on
        and slow off.
    """

    stiffness: float
    on: float
    off: float
    form: str
    key = "activation_lag"
    forms = ("first_order", "antagonists")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a lag that takes 40 to 75 % of the joint's damping."""
        on = rng.uniform(0.015, 0.03)
        off = on if form == "first_order" else on * rng.uniform(1.8, 3.0)
        # The late spring takes damping away, stiffness times lag of it.
        damping = rng.uniform(0.4, 0.75) * anatomy.damping
        return cls(min(damping / (0.5 * (on + off)), 1.5 * anatomy.stiffness), on, off, form)

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def n_states(self) -> int:  # noqa: D102
        return 1 if self.form == "first_order" else 2

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        if self.form == "first_order":
            return self.stiffness * states[0], ((angle - states[0]) / self.on,)
        flexor, extensor = states
        return self.stiffness * (flexor - extensor), (
            _toward(max(angle, 0.0), flexor, self.on, self.off),
            _toward(max(-angle, 0.0), extensor, self.on, self.off),
        )


@dataclass(frozen=True)
class StretchReflex(TorqueEffect):
    """Feedback of length and velocity through a neural delay and muscle activation.

    Attributes
    ----------
    length_gain : float
        Torque per angle (Nm/rad).
    velocity_gain : float
        Torque per velocity (Nms/rad).
    delay : float
        Delay (s) of the reflex loop.
    on, off : float
        Times (s) of activation and deactivation.
    form : str
        "first_order": one lag, `on`. "critically_damped": two of them. "antagonists": each muscle
        answers its own stretch only, and its activation rises fast and falls slowly.
    """

    length_gain: float
    velocity_gain: float
    delay: float
    on: float
    off: float
    form: str
    key = "stretch_reflex"
    forms = ("first_order", "critically_damped", "antagonists")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw gains that leave most joints stable, and delays of arm and ankle."""
        length = rng.uniform(0.2, 0.7) * anatomy.stiffness
        velocity = rng.uniform(0.2, 0.6) * anatomy.critical_damping
        delay, on = rng.uniform(0.025, 0.045), rng.uniform(0.01, 0.025)
        off = on * rng.uniform(1.8, 3.0) if form == "antagonists" else on
        return cls(length, velocity, delay, on, off, form)

    def scaled(self, size: float) -> Self:
        """Scale its gains."""
        return self._times(size, "length_gain", "velocity_gain")

    def n_states(self) -> int:  # noqa: D102
        return 1 if self.form == "first_order" else 2

    def history(self) -> float:  # noqa: D102
        return self.delay

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        earlier, speed = past(time - self.delay)
        excitation = self.length_gain * earlier + self.velocity_gain * speed
        if self.form == "first_order":
            return states[0], ((excitation - states[0]) / self.on,)
        if self.form == "critically_damped":
            first, second = states
            return second, ((excitation - first) / self.on, (first - second) / self.on)
        flexor, extensor = states
        return flexor - extensor, (
            _toward(max(excitation, 0.0), flexor, self.on, self.off),
            _toward(max(-excitation, 0.0), extensor, self.on, self.off),
        )


@dataclass(frozen=True)
class ShortRangeStiffness(TorqueEffect):
    """Attached cross-bridges: a spring that yields and, in time, lets go.

    Either all yield alike, and renew in time, or they are `YIELDS` in parallel, each almost ideally
    plastic, that yield one after the other (Iwan 1966, J Appl Mech 33: 893-900).

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) before yielding.
    limit : float
        Stretch (rad) at which the cross-bridges yield, on average.
    turnover : float
        Time (s) in which cross-bridges detach and attach anew; infinite where they only yield.
    form : str
        "yielding" one after the other, or "turnover".
    """

    stiffness: float
    limit: float
    turnover: float
    form: str
    key = "short_range_stiffness"
    forms = ("yielding", "turnover")
    YIELDS: ClassVar = (0.5, 5 / 6, 7 / 6, 1.5)  # of the limit

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw cross-bridges that yield after 0.7 to 2.6 degrees."""
        turnover = rng.uniform(0.1, 0.3) if form == "turnover" else math.inf
        return cls(
            rng.uniform(0.6, 1.8) * anatomy.stiffness, rng.uniform(0.012, 0.045), turnover, form
        )

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def n_states(self) -> int:  # noqa: D102
        return len(self.YIELDS) if self.form == "yielding" else 1

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        yields, sharpness = (self.YIELDS, 8.0) if self.form == "yielding" else ((1.0,), 4.0)
        rates = []
        for stretch, share in zip(states, yields, strict=True):
            rate = velocity
            if stretch * velocity > 0.0:
                beyond = min(abs(stretch) / (share * self.limit), 2.0)  # a trial step may overshoot
                rate -= velocity * beyond**sharpness
            rates.append(rate - stretch / self.turnover)
        return self.stiffness * sum(states) / len(yields), rates


@dataclass(frozen=True)
class QuadraticStiffness(TorqueEffect):
    """Passive tissue that stiffens in one direction.

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) at rest of the tissue that stiffens; its linear part counts as K.
    rate : float
        Relative change of that stiffness per angle (1/rad); negative where it softens.
    form : str
        "polynomial": only the quadratic term. "exponential": Fung's tissue, with all the others.
    """

    stiffness: float
    rate: float
    form: str
    key = "quadratic_stiffness"
    forms = ("polynomial", "exponential")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw tissue that stiffens in either direction."""
        rate = rng.uniform(0.7, 1.5) if form == "polynomial" else rng.uniform(0.8, 2.2)
        return cls(anatomy.stiffness, rate * float(rng.choice([-1.0, 1.0])), form)

    def scaled(self, size: float) -> Self:
        """Scale the change of stiffness."""
        return self._times(size, "rate")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        if self.form == "polynomial":
            return 0.5 * self.stiffness * self.rate * angle * angle, AT_REST
        return self.stiffness * (math.expm1(self.rate * angle) / self.rate - angle), AT_REST


@dataclass(frozen=True)
class CubicStiffness(TorqueEffect):
    """Passive tissue that stiffens in both directions.

    Attributes
    ----------
    stiffness : float
        Stiffness (Nm/rad) at rest of the tissue that stiffens; its linear part counts as K.
    doubling : float
        Angle (rad) at which the cubic term has made that stiffness twice as large.
    form : str
        "polynomial": only the cubic term. "sinh": two exponential tissues against each other.
    """

    stiffness: float
    doubling: float
    form: str
    key = "cubic_stiffness"
    forms = ("polynomial", "sinh")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw tissue twice as stiff after 0.2 to 0.4 rad."""
        return cls(anatomy.stiffness, rng.uniform(0.2, 0.4), form)

    def scaled(self, size: float) -> Self:
        """Scale the cubic term."""
        return self._times(1.0 / math.sqrt(size), "doubling")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        if self.form == "polynomial":
            return self.stiffness * angle * (angle / self.doubling) ** 2 / 3.0, AT_REST
        scale = self.doubling / math.sqrt(2.0)
        return self.stiffness * (scale * math.sinh(angle / scale) - angle), AT_REST


@dataclass(frozen=True)
class CoulombFriction(HiddenEffect):
    """Dry friction: it holds the joint up to its static torque, then slides (Stribeck 1902).

    Attributes
    ----------
    sliding, static : float
        Torques (Nm) while sliding fast and at standstill.
    stribeck_speed : float
        Velocity (rad/s) over which the one goes over into the other.
    form : str
        "sign": the two are equal. "stribeck": static friction is larger. "uneven": the two are
        equal, and larger one way than the other. "bristles" is `BristleFriction`.
    uneven : float
        How much larger they are towards larger angles than on average, as a share.
    """

    sliding: float
    static: float
    stribeck_speed: float
    form: str
    uneven: float = 0.0
    key = "coulomb_friction"
    forms = ("sign", "stribeck", "uneven", "bristles")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> HiddenEffect:
        """Draw friction that can hold the joint 0.01 to 0.025 rad or more from rest."""
        sliding = rng.uniform(0.01, 0.025) * anatomy.stiffness
        static = sliding * rng.uniform(1.15, 1.5) if form == "stribeck" else sliding
        speed = rng.uniform(0.1, 0.4)
        if form == "bristles":
            static = sliding * rng.uniform(1.0, 1.3)
            stiffness = sliding / rng.uniform(5e-4, 3e-3)
            damping = rng.uniform(0.0, 0.3) * math.sqrt(stiffness * anatomy.inertia)
            return BristleFriction(sliding, static, speed, stiffness, damping)
        uneven = 0.0
        if form == "uneven":
            uneven = rng.uniform(0.2, 0.5) * float(rng.choice([-1.0, 1.0]))
        return cls(sliding, static, speed, form, uneven)

    def scaled(self, size: float) -> Self:
        """Scale both torques."""
        return self._times(size, "sliding", "static")

    def torque(self, velocity: float, direction: float) -> float:
        """Torque (Nm) while sliding in a direction (1 or -1) at a velocity (rad/s)."""
        excess = self.static - self.sliding
        rest = excess * math.exp(-((velocity / self.stribeck_speed) ** 2)) if excess else 0.0
        return direction * self._one_way(direction) * (self.sliding + rest)

    def beyond(self, torque: float) -> float:
        """Torque (Nm) beyond what it holds at rest; negative where it holds."""
        return abs(torque) - self._one_way(torque) * self.static

    def _one_way(self, direction: float) -> float:
        return 1.0 + self.uneven * math.copysign(1.0, direction)


@dataclass(frozen=True)
class BristleFriction(TorqueEffect):
    """Dry friction of bristles that bend before they slip (Canudas de Wit & al. 1995: LuGre).

    Attributes
    ----------
    sliding, static : float
        Torques (Nm) while sliding fast and slowly.
    stribeck_speed : float
        Velocity (rad/s) over which the one goes over into the other.
    stiffness, damping : float
        Of the bristles (Nm/rad, Nms/rad).
    """

    sliding: float
    static: float
    stribeck_speed: float
    stiffness: float
    damping: float
    key = CoulombFriction.key
    forms = ("bristles",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> HiddenEffect:
        """Draw them as one form of dry friction."""
        return CoulombFriction.draw(rng, anatomy, form)

    def scaled(self, size: float) -> Self:
        """Scale all torques: the bristles bend as far."""
        return self._times(size, "sliding", "static", "stiffness", "damping")

    def n_states(self) -> int:  # noqa: D102
        return 1

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        excess = (self.static - self.sliding) * math.exp(-((velocity / self.stribeck_speed) ** 2))
        bent = states[0]
        rate = velocity - abs(velocity) * self.stiffness * bent / (self.sliding + excess)
        return self.stiffness * bent + self.damping * rate, (rate,)


@dataclass(frozen=True)
class Gravity(TorqueEffect):
    """Weight of the limb, beyond what balances it at rest.

    Attributes
    ----------
    moment : float
        Mass times g times distance of the centre of mass (Nm).
    posture : float
        Angle (rad) at rest from hanging down.
    """

    moment: float
    posture: float
    key = "gravity"
    forms = ("pendulum",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a limb that would swing like a pendulum of 5 to 25 cm, 0.5 to 1.4 rad from down."""
        length = rng.uniform(0.05, 0.25)
        return cls(
            9.81 * anatomy.inertia / length,
            rng.uniform(0.5, 1.4) * float(rng.choice([-1.0, 1.0])),
        )

    def scaled(self, size: float) -> Self:
        """Scale its moment."""
        return self._times(size, "moment")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        return self.moment * (math.sin(self.posture + angle) - math.sin(self.posture)), AT_REST


@dataclass(frozen=True)
class SecondMass(TorqueEffect):
    """Soft tissue that wobbles on the bone.

    Attributes
    ----------
    inertia : float
        Inertia (kg m²) of what wobbles, beside that of the joint.
    stiffness : float
        Stiffness (Nm/rad) of its attachment.
    damping : float
        Damping (Nms/rad) of its attachment.
    """

    inertia: float
    stiffness: float
    damping: float
    key = "second_mass"
    forms = ("linear",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw tissue of 20 to 45 % of the joint's inertia that wobbles at 6 to 15 Hz."""
        inertia = rng.uniform(0.2, 0.45) * anatomy.inertia
        frequency = 2.0 * math.pi * rng.uniform(6.0, 15.0)
        damping = 2.0 * rng.uniform(0.08, 0.25) * inertia * frequency
        return cls(inertia, inertia * frequency**2, damping)

    def scaled(self, size: float) -> Self:
        """Scale its inertia, at the same frequency."""
        return self._times(size, "inertia", "stiffness", "damping")

    def n_states(self) -> int:  # noqa: D102
        return 2

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        where, speed = states
        torque = self.stiffness * (angle - where) + self.damping * (velocity - speed)
        return torque, (speed, torque / self.inertia)


@dataclass(frozen=True)
class EndStop(TorqueEffect):
    """A stop beyond which the joint is stiff: bone, capsule or rubber of a rig.

    Attributes
    ----------
    stiffness : float
        In Nm/rad, beyond the stop; of a rubber ball at `DEEP` beyond it.
    begin : float
        Angle (rad) of the stop.
    side : float
        1 or -1: towards larger angles, or towards smaller ones.
    form : str
        "one_sided": at once as stiff. "both_sides": another at the same angle on the other side.
        "hertzian": a ball of rubber, whose torque grows as the power 3/2 (Hertz 1882).
    """

    stiffness: float
    begin: float
    side: float
    form: str
    key = "end_stop"
    forms = ("one_sided", "both_sides", "hertzian")
    DEEP: ClassVar[float] = 0.03

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a stop two to five times as stiff as the joint, at 0.01 to 0.05 rad."""
        return cls(
            rng.uniform(2.0, 5.0) * anatomy.stiffness,
            rng.uniform(0.01, 0.05),
            float(rng.choice([-1.0, 1.0])),
            form,
        )

    def scaled(self, size: float) -> Self:
        """Scale its stiffness."""
        return self._times(size, "stiffness")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        torque = self.side * self._pressed(self.side * angle)
        if self.form == "both_sides":
            torque -= self.side * self._pressed(-self.side * angle)
        return torque, AT_REST

    def _pressed(self, towards: float) -> float:
        deep = max(towards - self.begin, 0.0)
        if self.form == "hertzian":
            return self.stiffness * deep * math.sqrt(deep / self.DEEP) / 1.5
        return self.stiffness * deep


@dataclass(frozen=True)
class DampingByAngle(TorqueEffect):
    """Damping that the joint meets on one side, or that grows towards it.

    Attributes
    ----------
    damping : float
        In Nms/rad, on that side; of one that grows, the part of the joint's that does.
    side : float
        1 or -1: towards larger angles, or towards smaller ones.
    reach : float
        Angle (rad) over which damping grows by a factor of e.
    form : str
        "half": a damper that is met on the way. "growing": exponentially, with the angle.
    """

    damping: float
    side: float
    reach: float
    form: str
    key = "damping_by_angle"
    forms = ("half", "growing")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a damper of two to five times the joint's damping, or all that grows."""
        more = rng.uniform(2.0, 5.0) if form == "half" else 1.0
        side, reach = float(rng.choice([-1.0, 1.0])), rng.uniform(0.06, 0.15)
        return cls(more * anatomy.damping, side, reach, form)

    def scaled(self, size: float) -> Self:
        """Scale the damper, or the exponent."""
        if self.form == "half":
            return self._times(size, "damping")
        return self._times(1.0 / size, "reach")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        towards = self.side * angle
        if self.form == "half":
            return (self.damping * velocity if towards > 0.0 else 0.0), AT_REST
        return self.damping * math.expm1(towards / self.reach) * velocity, AT_REST


@dataclass(frozen=True)
class DampingByDirection(TorqueEffect):
    """Damping with another value in each direction, as of a shock absorber.

    Attributes
    ----------
    damping : float
        In Nms/rad: how much more one direction has.
    side : float
        1 or -1: towards larger angles, or towards smaller ones.
    """

    damping: float
    side: float
    key = "damping_by_direction"
    forms = ("two_values",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw one to three times the joint's damping."""
        return cls(rng.uniform(1.0, 3.0) * anatomy.damping, float(rng.choice([-1.0, 1.0])))

    def scaled(self, size: float) -> Self:
        """Scale the difference."""
        return self._times(size, "damping")

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        return (self.damping * velocity if self.side * velocity > 0.0 else 0.0), AT_REST


# Between what is driven and measured and the limb


@dataclass(frozen=True)
class Coupling(TorqueEffect):
    """A link between the driven and measured handle and the limb, which has its own K, B and I.

    Attributes
    ----------
    stiffness : float
        In Nm/rad.
    damping : float
        In Nms/rad.
    handle_inertia : float
        Inertia (kg m²) of the handle.
    limb : Anatomy
        The joint behind the link.
    """

    stiffness: float
    damping: float
    handle_inertia: float
    limb: Anatomy

    def handle(self) -> Anatomy:
        """The handle alone: what the applied torque acts on."""
        return Anatomy(self.handle_inertia, 0.0, 0.0, 0.0, 0.0)

    def n_states(self) -> int:  # noqa: D102
        return 2

    @abstractmethod
    def contact(self, stretch: float, rate: float) -> float:
        """Torque (Nm) of the link at a stretch (rad) and its rate."""

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        where, speed = states
        contact = self.contact(angle - where, velocity - speed)
        resisted = self.limb.stiffness * where + self.limb.damping * speed
        return contact, (speed, (contact - resisted) / self.limb.inertia)


@dataclass(frozen=True)
class SoftCoupling(Coupling):
    """A cuff or fixture that gives."""

    key = "soft_coupling"
    forms = ("linear",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a cuff 4 to 12 times as stiff, and a handle of 15 to 30 % of the inertia."""
        stiffness = rng.uniform(4.0, 12.0) * anatomy.stiffness
        handle = rng.uniform(0.15, 0.3) * anatomy.inertia
        damping = 2.0 * rng.uniform(0.1, 0.4) * math.sqrt(stiffness * handle)
        return cls(stiffness, damping, handle, anatomy)

    def scaled(self, size: float) -> Self:
        """Scale its compliance."""
        return self._times(1.0 / size, "stiffness", "damping")

    def contact(self, stretch: float, rate: float) -> float:  # noqa: D102
        return self.stiffness * stretch + self.damping * rate


@dataclass(frozen=True)
class Backlash(Coupling):
    """Play: a link that pushes beyond a gap and never pulls.

    Attributes
    ----------
    gap : float
        Play (rad) to either side.
    """

    gap: float
    key = "backlash"
    forms = ("symmetric",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a play of 4 to 12 mrad and a handle of 15 to 30 % of the joint's inertia."""
        handle = rng.uniform(0.15, 0.3) * anatomy.inertia
        return cls(900.0, 1.5, handle, anatomy, rng.uniform(0.004, 0.012))

    def scaled(self, size: float) -> Self:
        """Return the joint with `size` times the play; without it the handle adds its inertia."""
        return self._times(size, "gap")

    def contact(self, stretch: float, rate: float) -> float:  # noqa: D102
        if abs(stretch) <= self.gap:
            return 0.0
        push = self.stiffness * (stretch - math.copysign(self.gap, stretch)) + self.damping * rate
        return max(push, 0.0) if stretch > 0.0 else min(push, 0.0)


# On the way from the joint to the record


@dataclass(frozen=True)
class SensorDelay(HiddenEffect):
    """The angle is recorded late.

    Attributes
    ----------
    delay : float
        Delay (s).
    """

    delay: float
    key = "sensor_delay"
    forms = ("pure",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a delay of 3 to 12 ms."""
        return cls(rng.uniform(0.003, 0.012))

    def scaled(self, size: float) -> Self:
        """Scale the delay."""
        return self._times(size, "delay")


@dataclass(frozen=True)
class SensorLowpass(TorqueEffect):
    """The angle is recorded through an analogue filter, whose first state is its output.

    Attributes
    ----------
    cutoff : float
        Frequency (Hz) at which half of the power passes.
    form : str
        "first_order", or "butterworth": second order, maximally flat.
    """

    cutoff: float
    form: str
    key = "sensor_lowpass"
    forms = ("first_order", "butterworth")

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a cut-off between 12 and 35 Hz."""
        return cls(rng.uniform(12.0, 35.0), form)

    def scaled(self, size: float) -> Self:
        """Scale the filter's period."""
        return self._times(1.0 / size, "cutoff")

    def n_states(self) -> int:  # noqa: D102
        return 1 if self.form == "first_order" else 2

    def react(  # noqa: D102
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        w = 2.0 * math.pi * self.cutoff
        if self.form == "first_order":
            return 0.0, (w * (angle - states[0]),)
        output, slope = states
        return 0.0, (slope, w * w * (angle - output) - math.sqrt(2.0) * w * slope)


@dataclass(frozen=True)
class SensorDrift(HiddenEffect):
    """The zero of the angle wanders, in the same way in every trial.

    Attributes
    ----------
    ramp : float
        Steady part (rad/s).
    swing : float
        Amplitude (rad) of the slow swing.
    frequency : float
        Of the slow swing (Hz).
    """

    ramp: float
    swing: float
    frequency: float
    key = "sensor_drift"
    forms = ("ramp_and_swing",)

    @classmethod
    def draw(cls, rng: np.random.Generator, anatomy: Anatomy, form: str) -> Self:
        """Draw a ramp of 5 to 20 mrad/s and a swing of 1 to 5 mrad."""
        ramp, swing = rng.uniform(0.005, 0.02), rng.uniform(0.001, 0.005)
        signs = rng.choice([-1.0, 1.0], size=2).tolist()
        return cls(ramp * signs[0], swing * signs[1], rng.uniform(0.4, 1.5))

    def scaled(self, size: float) -> Self:
        """Scale ramp and swing."""
        return self._times(size, "ramp", "swing")

    def offset(self, time: np.ndarray) -> np.ndarray:
        """Error (rad) of the recorded angle at times (s), shape (n,)."""
        return self.ramp * time + self.swing * np.sin(2.0 * np.pi * self.frequency * time)


EFFECTS: dict[str, type[HiddenEffect]] = {
    effect.key: effect
    for effect in (
        SeriesTendon,
        NonlinearTendon,
        MaxwellBranch,
        ActivationLag,
        StretchReflex,
        HillForceVelocity,
        ShortRangeStiffness,
        QuadraticStiffness,
        CubicStiffness,
        CoulombFriction,
        Gravity,
        SecondMass,
        SensorDelay,
        SensorLowpass,
        SensorDrift,
        EndStop,
        DampingByAngle,
        DampingByDirection,
        SoftCoupling,
        Backlash,
    )
}
"""Effects by the names that an investigation knows them by."""
