"""A hidden joint and its response to a torque, by adaptive integration in plain floats."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.integrate import solve_ivp

from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.effects import (
    AT_REST,
    EFFECTS,
    CoulombFriction,
    Coupling,
    HiddenEffect,
    HillForceVelocity,
    Past,
    Reaction,
    SensorDelay,
    SensorDrift,
    SensorLowpass,
    Tendon,
    TorqueEffect,
)
from identifiability.benchmark.unknowns import UNKNOWNS
from identifiability.errors import InputError

E = TypeVar("E", bound=HiddenEffect)

RTOL = 1e-9
"""Relative tolerance of the integration; the absolute one is a hundredth of it."""

MEMORY_STEP = 0.25e-3
"""Largest interval (s) at which the motion is kept for a delayed effect, at this tolerance."""

LARGEST_ANGLE = 100.0
"""Angle (rad) beyond which a joint has run away."""

BREAKAWAY_SPEED = 1e-9
"""Velocity (rad/s) with which a joint leaves standstill, so that it is seen to have left."""


@dataclass(frozen=True)
class Joint:
    """A joint with hidden effects, at rest before the torque begins.

    The muscle (stiffness, damping, force-velocity relation) acts on the joint through the tendon,
    where there is one; all other torques act at the joint; the sensor sees the joint's angle
    through its filter, then its delay, then its drift.

    Attributes
    ----------
    anatomy : Anatomy
        Inertia, stiffness and damping.
    effects : tuple of HiddenEffect
        The effects, at most one of each kind.
    """

    anatomy: Anatomy
    effects: tuple[HiddenEffect, ...] = ()

    def __post_init__(self) -> None:
        keys = [effect.key for effect in self.effects]
        if len(set(keys)) < len(keys) or sum(isinstance(e, Tendon) for e in self.effects) > 1:
            raise InputError(f"found the effects {keys}, expected each, and one tendon, once")
        if any(isinstance(e, Coupling) for e in self.effects) and len(keys) > 1:
            raise InputError(f"found the effects {keys}, but a coupling can only be had alone")

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the effects."""
        return tuple(effect.key for effect in self.effects)

    @property
    def driven(self) -> Anatomy:
        """What is driven and measured, before its effects: the joint, or a coupling's handle."""
        coupling = find(Coupling, self.effects)  # type: ignore[type-abstract]
        return self.anatomy if coupling is None else coupling.handle()

    @property
    def parameters(self) -> dict[str, float | str]:
        """Every value by name, those of an effect as ``key.name``."""
        values: dict[str, float | str] = dict(dataclasses.asdict(self.anatomy))
        for effect in self.effects:
            for item in dataclasses.fields(effect):  # type: ignore[arg-type]
                value = getattr(effect, item.name)
                if not isinstance(value, Anatomy):  # the limb behind a handle is listed already
                    values[f"{effect.key}.{item.name}"] = value
        return values

    def without(self, key: str) -> Joint:
        """Return the joint without one of its effects."""
        return Joint(self.anatomy, tuple(e for e in self.effects if e.key != key))

    def scaled(self, stiffness: float, damping: float, inertia: float = 1.0) -> Joint:
        """Return the joint with its anatomy multiplied by factors, its effects as they are."""
        anatomy = self.anatomy.scaled(stiffness, damping, inertia)
        effects = (
            dataclasses.replace(effect, limb=anatomy) if isinstance(effect, Coupling) else effect
            for effect in self.effects
        )
        return Joint(anatomy, tuple(effects))

    def respond(self, torque: np.ndarray, interval: float, rtol: float = RTOL) -> np.ndarray:
        """Angle that an ideal recorder behind this joint's sensor sees.

        Parameters
        ----------
        torque : array, shape (n,)
            Applied torque (Nm) at the samples, linear between them.
        interval : float
            Sampling interval (s).
        rtol : float
            Relative tolerance of the integration.

        Returns
        -------
        array, shape (n,)
            Angle (rad) at the samples.

        Raises
        ------
        InputError
            Where a delay inside the joint is shorter than the sampling interval.
        ArithmeticError
            Where the joint runs away, as with too much delayed feedback.
        """
        recorded = _Run(self, np.asarray(torque, float), interval, rtol).recorded()
        for effect in self.effects:
            if isinstance(effect, SensorDrift):
                recorded = recorded + effect.offset(np.arange(recorded.size) * interval)
        return recorded


def draw_joint(
    keys: Sequence[str], rng: np.random.Generator, forms: Sequence[str | None] | None = None
) -> Joint:
    """Draw a joint with some effects within their physiological ranges.

    Parameters
    ----------
    keys : sequence of str
        Keys of `EFFECTS` or `UNKNOWNS`.
    rng : numpy.random.Generator
    forms : sequence of str or None, optional
        Form of each effect; drawn where it is ``None``.

    Raises
    ------
    InputError
        For a key or form that does not exist.
    """
    known = EFFECTS | UNKNOWNS
    anatomy = Anatomy.draw(rng, keys)
    effects = []
    for key, form in zip(keys, forms or [None] * len(keys), strict=True):
        if key not in known:
            raise InputError(f"found the effect '{key}', expected one of {sorted(known)}")
        if form is not None and form not in known[key].forms:
            raise InputError(f"{key} has the forms {known[key].forms}, found '{form}'; choose one")
        chosen = str(rng.choice(known[key].forms)) if form is None else form
        effects.append(known[key].draw(rng, anatomy, chosen))
    return Joint(anatomy, tuple(effects))


class Muscle:
    """Muscle, behind a tendon where there is one; its state is the angle at the tendon's end."""

    def __init__(
        self, anatomy: Anatomy, tendon: Tendon | None, hill: HillForceVelocity | None
    ) -> None:
        self._stiffness, self._damping = anatomy.muscle_stiffness, anatomy.muscle_damping
        self._tendon, self._hill = tendon, hill

    def n_states(self) -> int:
        """Number of states."""
        return int(self._tendon is not None)

    def react(
        self, time: float, angle: float, velocity: float, states: Sequence[float], past: Past
    ) -> Reaction:
        """Resist a motion of the joint: see `TorqueEffect.react`."""
        if self._tendon is None:
            torque = self._stiffness * angle + self._damping * velocity
            if self._hill is not None:
                torque += self._hill.torque(velocity)[0]
            return torque, AT_REST
        tension = self._tendon.tension(angle - states[0])
        return tension, (self._speed(tension - self._stiffness * states[0]),)

    def _speed(self, load: float) -> float:
        """Velocity at which damping and force-velocity relation carry the load.

        Their torque is steepest at standstill and flattens from there, so that Newton's steps from
        standstill approach the velocity from one side.
        """
        if self._hill is None:
            return load / self._damping
        speed = 0.0
        for _ in range(100):
            torque, slope = self._hill.torque(speed)
            step = (load - self._damping * speed - torque) / (self._damping + slope)
            speed += step
            if abs(step) <= 1e-13 * (1.0 + abs(speed)):
                break
        return speed


def find(kind: type[E], effects: Sequence[HiddenEffect]) -> E | None:
    """Return the effect of a kind, if there is one."""
    return next((effect for effect in effects if isinstance(effect, kind)), None)


class _Run:
    """One integration of a joint under one torque.

    States: angle and velocity of the joint, then those of the muscle and of each effect.
    """

    def __init__(self, joint: Joint, torque: np.ndarray, interval: float, rtol: float) -> None:
        effects, anatomy = joint.effects, joint.driven
        tendon = find(Tendon, effects)  # type: ignore[type-abstract]
        muscle = Muscle(anatomy, tendon, find(HillForceVelocity, effects))
        self._inertia = anatomy.inertia
        self._stiffness, self._damping = anatomy.passive_stiffness, anatomy.passive_damping
        self._friction = find(CoulombFriction, effects)
        self._sliding = 0  # direction in which the joint slides, 0 where friction holds it

        torque_effects = [e for e in effects if isinstance(e, TorqueEffect)]
        self._parts: list[tuple[Muscle | TorqueEffect, int, int]] = []
        self._seen, n_states = 0, 2
        parts: list[Muscle | TorqueEffect] = [muscle, *torque_effects]
        for part in parts:
            if isinstance(part, SensorLowpass):
                self._seen = n_states
            self._parts.append((part, n_states, n_states + part.n_states()))
            n_states += part.n_states()
        self._state = np.zeros(n_states)

        self._torque, self._interval, self._rtol = torque, interval, rtol
        sensor_delay = find(SensorDelay, effects)
        late = 0.0 if sensor_delay is None else sensor_delay.delay
        self._wanted = np.arange(torque.size) * interval - late
        self._recorded = np.zeros(torque.size)
        self._n_recorded = int(np.searchsorted(self._wanted, 0.0, side="right"))

        # No leg is longer than a delay, so that what it remembers lies before it.
        delays = [effect.history() for effect in torque_effects if effect.history()]
        self._remembers = bool(delays)
        shortest = min(delays, default=torque.size * interval)
        self._longest = int(shortest / interval + 1e-9)  # in samples
        if self._longest < 1:
            raise InputError(
                f"found a delay of {shortest:g} s inside the joint, expected at least the "
                f"sampling interval of {interval:g} s"
            )
        # Cubic interpolation errs as the fourth power of the step.
        coarsest = MEMORY_STEP * (rtol / RTOL) ** 0.25
        self._memory_step = interval / math.ceil(interval / coarsest - 1e-9)
        self._memory: list[tuple[float, float, float]] = [(0.0, 0.0, 0.0)]
        self._load = (0.0, 0.0, 0.0)  # start of the leg (s), torque there (Nm), its slope (Nm/s)

    def recorded(self) -> np.ndarray:
        """Integrate leg by leg, in each of which the torque is linear, and return the angle."""
        slopes = np.diff(self._torque) / self._interval
        corners = np.flatnonzero(np.abs(np.diff(slopes)) > 1e-9) + 1
        ends = [0, *corners.tolist(), self._torque.size - 1]
        for left, right in itertools.pairwise(ends):
            for first in range(left, right, self._longest):
                last = min(first + self._longest, right)
                start = first * self._interval
                self._load = (start, float(self._torque[first]), float(slopes[left]))
                self._advance(start, last * self._interval)
        return self._recorded

    def _advance(self, start: float, stop: float) -> None:
        while start < stop:
            within = self._wanted[self._n_recorded :]
            within = within[within < stop - 1e-12]
            solution = solve_ivp(
                self._rates,
                (start, stop),
                self._state,
                method="DOP853",
                rtol=self._rtol,
                atol=0.01 * self._rtol,
                first_step=min(stop - start, 2.0 * self._interval),
                dense_output=self._remembers or within.size > 0,
                events=self._events(),
            )
            if not solution.success or not abs(solution.y[0, -1]) < LARGEST_ANGLE:
                raise ArithmeticError(f"the joint could not be followed beyond {start:g} s")
            end = stop if solution.status == 0 else float(solution.t[-1])
            self._state = solution.y[:, -1].copy()
            self._record(solution, end)
            if self._remembers:
                self._remember(solution, end)
            if solution.status == 1:
                self._stick_or_slip(end)
            start = end

    def _record(self, solution: object, end: float) -> None:
        times = self._wanted[self._n_recorded :]
        times = times[times < end + 1e-12]
        if times.size == 0:
            return
        values = np.full(times.size, self._state[self._seen])
        if times[0] < end - 1e-12:
            values = solution.sol(times)[self._seen]  # type: ignore[attr-defined]
        self._recorded[self._n_recorded : self._n_recorded + times.size] = values
        self._n_recorded += times.size

    def _remember(self, solution: object, end: float) -> None:
        first = len(self._memory)
        last = int(end / self._memory_step + 1e-6)
        times = np.arange(first, last + 1) * self._memory_step
        if times.size:
            states = solution.sol(times).T  # type: ignore[attr-defined]
            for time, state in zip(times.tolist(), states, strict=True):
                rates = self._rates(time, state)
                self._memory.append((float(state[0]), float(state[1]), rates[1]))

    def _past(self, time: float) -> tuple[float, float]:
        """Earlier angle and velocity, by cubic Hermite interpolation."""
        if time <= 0.0:
            return 0.0, 0.0
        h = self._memory_step
        index = min(int(time / h), len(self._memory) - 2)
        angle, velocity, acceleration = self._memory[index]
        next_angle, next_velocity, next_acceleration = self._memory[index + 1]
        f = time / h - index
        g = 1.0 - f
        left, right = g * g * (1.0 + 2.0 * f), f * f * (3.0 - 2.0 * f)
        rise, fall = h * f * g * g, -h * f * f * g
        return (
            left * angle + right * next_angle + rise * velocity + fall * next_velocity,
            left * velocity
            + right * next_velocity
            + rise * acceleration
            + fall * next_acceleration,
        )

    def _rates(self, time: float, state: np.ndarray) -> list[float]:
        values = state.tolist()
        net, rates = self._balance(time, values)
        velocity = values[1]
        if self._friction is None:
            rates[0], rates[1] = velocity, net / self._inertia
        elif self._sliding:
            net -= self._friction.torque(velocity, self._sliding)
            rates[0], rates[1] = velocity, net / self._inertia
        return rates

    def _balance(self, time: float, values: list[float]) -> tuple[float, list[float]]:
        """Torque that would accelerate the joint if there were no dry friction; states' rates."""
        since, torque, slope = self._load
        angle, velocity = values[0], values[1]
        net = torque + slope * (time - since)
        net -= self._stiffness * angle + self._damping * velocity
        rates = [0.0, 0.0]
        for part, first, last in self._parts:
            resisted, own = part.react(time, angle, velocity, values[first:last], self._past)
            net -= resisted
            rates += own
        return net, rates

    def _events(self) -> list[object] | None:
        if self._friction is None:
            return None
        friction, sliding = self._friction, self._sliding

        def slides_to_a_halt(time: float, state: np.ndarray) -> float:
            return float(sliding * state[1])

        def breaks_away(time: float, state: np.ndarray) -> float:
            return friction.beyond(self._balance(time, state.tolist())[0])

        event = slides_to_a_halt if sliding else breaks_away
        event.terminal, event.direction = True, -1 if sliding else 1  # type: ignore[attr-defined]
        return [event]

    def _stick_or_slip(self, time: float) -> None:
        assert self._friction is not None
        self._state[1] = 0.0
        net = self._balance(time, self._state.tolist())[0]
        held = self._sliding and self._friction.beyond(net) <= 0
        self._sliding = 0 if held else int(np.sign(net))
        self._state[1] = self._sliding * BREAKAWAY_SPEED
