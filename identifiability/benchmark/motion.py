"""Torque with which a hidden joint resists a motion that a servo imposes on it."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy import signal
from scipy.integrate import solve_ivp

from identifiability.benchmark.effects import (
    CoulombFriction,
    HillForceVelocity,
    SensorDelay,
    SensorDrift,
    SensorLowpass,
    Tendon,
    TorqueEffect,
)
from identifiability.benchmark.joints import Joint, Muscle, find

_ORDER = 6  # of the smooth steps: continuous up to the fourth derivative
_RTOL = 1e-8
_FINER = 8  # samples, between two that are recorded, at which a filter of the sensor is computed


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of smooth steps, whose derivatives are known at any time.

    Attributes
    ----------
    onsets : array, shape (m,)
        When each step begins [s].
    heights : array, shape (m,)
        How far it goes [rad].
    pace : float
        How fast [1/s].
    """

    onsets: np.ndarray
    heights: np.ndarray
    pace: float

    def at(self, time: float | np.ndarray) -> np.ndarray:
        """Angle, velocity and acceleration, shape (3,) or (3, n)."""
        since = np.asarray(time, float)[..., None] - self.onsets
        s = self.pace * np.maximum(since, 0.0)
        fading, m = np.exp(-s), _ORDER
        angle = 1 - fading * sum(s**j / factorial(j) for j in range(m))
        velocity = self.pace * fading * s ** (m - 1) / factorial(m - 1)
        rising = s ** (m - 2) / factorial(m - 2) - s ** (m - 1) / factorial(m - 1)
        acceleration = self.pace**2 * fading * rising
        return np.array([angle, velocity, acceleration]) @ self.heights


def reaction(joint: Joint, motion: Motion, time: np.ndarray) -> np.ndarray:
    """Torque that an ideal recorder behind the joint's sensor sees, shape (n,).

    A delay, filter or drift of the sensor is that of the torque here: it is the response. Drift is
    that of the angle times the joint's stiffness.

    Parameters
    ----------
    joint : Joint
    motion : Motion
        Of the joint, or of the handle where there is play.
    time : array, shape (n,)
        Equidistant [s], from rest.
    """
    late = next((e.delay for e in joint.effects if isinstance(e, SensorDelay)), 0.0)
    lowpass = find(SensorLowpass, joint.effects)
    if lowpass is None:
        torque = _reaction(joint, motion, time - late)
    else:
        interval = (time[1] - time[0]) / _FINER
        fine = time[0] + interval * np.arange(_FINER * (time.size - 1) + 1) - late
        order = 1 if lowpass.form == "first_order" else 2
        sections = signal.butter(order, lowpass.cutoff, fs=1 / interval, output="sos")
        torque = signal.sosfilt(sections, _reaction(joint, motion, fine))[::_FINER]
    drift = find(SensorDrift, joint.effects)
    if drift is not None:
        torque = torque + joint.anatomy.stiffness * drift.offset(time)
    return np.asarray(torque)


def _reaction(joint: Joint, motion: Motion, time: np.ndarray) -> np.ndarray:
    effects, anatomy = joint.effects, joint.driven
    muscle = Muscle(
        anatomy,
        find(Tendon, effects),  # type: ignore[type-abstract]
        find(HillForceVelocity, effects),
    )
    parts: list[Muscle | TorqueEffect] = [
        muscle,
        *(e for e in effects if isinstance(e, TorqueEffect) and not isinstance(e, SensorLowpass)),
    ]
    sizes = [part.n_states() for part in parts]
    ends = np.cumsum([0, *sizes])

    def past(when: float) -> tuple[float, float]:
        angle, velocity, _ = motion.at(when)
        return float(angle), float(velocity)

    def react(when: float, state: list[float]) -> tuple[float, list[float]]:
        angle, velocity, _ = map(float, motion.at(when))
        total = 0.0
        rates: list[float] = []
        for part, first, last in zip(parts, ends[:-1], ends[1:], strict=True):
            torque, own = part.react(when, angle, velocity, state[first:last], past)
            total += torque
            rates += own
        return total, rates

    states = np.zeros((ends[-1], time.size))
    if ends[-1]:
        begin = min(0.0, float(time[0]))
        solution = solve_ivp(
            lambda t, y: react(t, y.tolist())[1],
            (begin, float(time[-1])),
            np.zeros(ends[-1]),
            t_eval=np.clip(time, begin, time[-1]),
            method="LSODA",
            rtol=_RTOL,
            atol=1e-3 * _RTOL,
            max_step=0.3 / motion.pace,
        )
        if not solution.success:
            raise ArithmeticError(f"the joint could not be followed: {solution.message}")
        states = solution.y
    resisted = np.array([react(t, y)[0] for t, y in zip(time, states.T.tolist(), strict=True)])
    angle, velocity, acceleration = motion.at(time)
    resisted += anatomy.inertia * acceleration
    resisted += anatomy.passive_stiffness * angle + anatomy.passive_damping * velocity
    friction = find(CoulombFriction, effects)
    if friction is not None:
        # At a standstill it holds what it held before.
        direction, last = np.zeros(time.size), 0.0
        for i, speed in enumerate(velocity):
            last = float(np.sign(speed)) if abs(speed) > 1e-6 else last
            direction[i] = last
        resisted += [
            way and friction.torque(speed, way)
            for speed, way in zip(velocity, direction.tolist(), strict=True)
        ]
    return np.asarray(resisted)
