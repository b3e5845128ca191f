"""Measured joints of every kind: torque or angle imposed, any noise, short trials or long records.

The hidden joints are those of `cases`; what is done to them and how it is recorded is drawn too:
joints from wrist to knee, 100 to 1,000 samples a second, eight kinds of noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import interpolate, optimize

from identifiability.benchmark.cases import (
    ATTEMPTS,
    LARGEST_MOVEMENT,
    MATTERS,
    PAIRS,
    RATIOS,
    TRIPLES,
    HiddenCase,
    Kind,
)
from identifiability.benchmark.effects import EFFECTS
from identifiability.benchmark.joints import RTOL, Joint, draw_joint
from identifiability.benchmark.motion import Motion, reaction
from identifiability.benchmark.noisy_recordings import KINDS as NOISES
from identifiability.benchmark.noisy_recordings import noise_of
from identifiability.benchmark.unknowns import UNKNOWNS
from identifiability.measurement.trials import Trial

Imposed = Literal["torque", "angle"]

RATES = (100, 200, 500, 1000)
_COARSE, _FINER = 200, 4  # Hz up to which a torque may be smooth; steps a sample that make it so
_SPREAD, _RINGING = (0.0625, 0.25, 0.375, 0.25, 0.0625), 1e-4
_SHORT, _LONG = 0.8, 12.0  # seconds of a trial and of a record
_FIT, _HELD_OUT = 8, 3  # short trials
_LEAD = 0.1  # seconds at rest
_SIZES = (0.1, 3.0)  # of the joint, as a factor of the torques of those that `draw_joint` draws
_QUICK_RTOL = 1e-6
_JUDGED = 1.0  # seconds of a trial by which it is judged whether an effect matters
_QUICK_STEPS = 6
_STRIDE = 7  # shares no factor with the numbers of kinds

TIERS = ("singles", "pairs", "unknown", "nulls")


@dataclass(frozen=True)
class BlindSpec:
    """A case that is not built yet.

    Attributes
    ----------
    name, tier : str
    kind : {"known", "none", "unknown"}
    keys : tuple of str
        Keys of the hidden effects.
    imposed : {"torque", "angle"}
    noise : str
        One of `NOISES`.
    ratio : float
        Energy of the noise over that of the response.
    seed : int
    stream : tuple of int
        Which of the seed's random streams is the case's own.
    """

    name: str
    tier: str
    kind: Kind
    keys: tuple[str, ...]
    imposed: Imposed
    noise: str
    ratio: float
    seed: int
    stream: tuple[int, ...]

    def build(self) -> HiddenCase:
        """Draw joint and perturbations, simulate the trials and record them."""
        root = np.random.SeedSequence(self.seed, spawn_key=self.stream)
        for_joint, for_trials, for_records, for_torque = (
            np.random.default_rng(s) for s in root.spawn(4)
        )
        rate = int(for_trials.choice(RATES[1:] if self.noise == "hum" else RATES))
        long = bool(for_trials.random() < 0.4)
        size = float(np.exp(for_trials.uniform(*np.log(_SIZES))))
        # A coarse recorder sees a torque that is straight between its samples, or a smooth one.
        smooth = self.imposed == "torque" and rate <= _COARSE and bool(for_torque.random() < 0.5)
        joint, clean, matters = self._draw(for_joint, for_trials, rate, long, smooth)
        response = 1 if self.imposed == "angle" else 2
        energy = np.mean([np.var(signals[response]) for signals in clean])
        sd = float(np.sqrt(self.ratio * energy))
        trials = tuple(
            self._recorded(signals, sd, size, rate, for_records, f"trial {i + 1}")
            for i, signals in enumerate(clean)
        )
        held_out = () if long else trials[_FIT:]
        parameters = {**joint.parameters, "size": size, "rate": float(rate)}
        if smooth:
            parameters["smooth"] = 1.0
        return HiddenCase(
            self.name,
            self.keys,
            self.kind,
            parameters,
            trials[: len(trials) - len(held_out)],
            held_out,
            self.ratio,
            bool(self.keys) and not matters,
            self.seed,
        )

    def _draw(
        self,
        for_joint: np.random.Generator,
        random: np.random.Generator,
        rate: int,
        long: bool,
        smooth: bool,
    ) -> tuple[Joint, list[tuple[np.ndarray, ...]], bool]:
        """Draw joints until each effect of one shows well above the noise, or attempts are over."""
        for attempt in range(20 * ATTEMPTS):
            joint = draw_joint(self.keys, for_joint)
            try:
                if self.imposed == "torque":
                    clean = _pushed(joint, random, rate, long, _FINER if smooth else 1)
                else:
                    clean = _moved(joint, random, rate, long)
            except ArithmeticError:
                continue
            if max(np.abs(signals[2]).max() for signals in clean) > LARGEST_MOVEMENT:
                continue
            matters = all(self._matters(joint, clean, key) for key in self.keys)
            if matters or attempt >= ATTEMPTS:
                return joint, clean, matters
        raise ArithmeticError(f"{self.name}: no joint with {self.keys} stays within reach")

    def _matters(self, joint: Joint, clean: Sequence[tuple[np.ndarray, ...]], key: str) -> bool:
        return missed(joint.without(key), clean, self.imposed) > MATTERS * self.ratio

    def _recorded(
        self,
        signals: tuple[np.ndarray, ...],
        sd: float,
        size: float,
        rate: int,
        random: np.random.Generator,
        name: str,
    ) -> Trial:
        time, torque, angle = signals[:3]
        noise = sd * noise_of(self.noise, time.size, rate, random)
        if self.noise == "encoder":
            # The step's rounding error is what the noise would be.
            step = np.sqrt(12) * sd if self.imposed == "torque" else np.ptp(angle) / 1000
            angle = step * np.round(angle / step)
            noise = noise if self.imposed == "angle" else np.zeros(time.size)
        elif self.noise == "both channels":
            other = random.standard_normal(time.size)
            if self.imposed == "torque":
                torque = torque + 0.005 * np.std(torque) * other
            else:
                angle = angle + 5e-4 * np.ptp(angle) * other
        if self.imposed == "torque":
            angle = angle + noise
        else:
            torque = torque + noise
        return Trial(time, size * torque, angle, driven=self.imposed, name=name, condition=name)


def missed(joint: Joint, clean: Sequence[tuple[np.ndarray, ...]], imposed: Imposed) -> float:
    """Share of the response's energy that a joint misses, its K, B and I refitted.

    Parameters
    ----------
    joint : Joint
    clean : sequence of tuple of array
        Time, torque and angle of each trial without noise; then, of an imposed torque, how many
        steps a sample it is smooth in, of an imposed angle its motion.
    imposed : {"torque", "angle"}
    """
    trials = clean[:: max(1, len(clean) // 3)]
    if imposed == "torque":
        trials = [
            (*(x[: round(_JUDGED / (s[0][1] - s[0][0]))] for x in s[:3]), s[3]) for s in trials
        ]
    energy = sum(float(np.sum(np.square(s[2 if imposed == "torque" else 1]))) for s in trials)
    if imposed == "angle":
        # Linear in K, B and I: what the rest of the joint does not resist is regressed on motion.
        left, energy_left = [], 0.0
        for time, torque, _, onsets, heights, pace in trials:
            motion = Motion(onsets, heights, float(pace))
            without = reaction(joint, motion, time)
            regressors = np.column_stack([motion.at(time).T, without, np.ones(time.size)])
            left.append((regressors, torque))
        every = np.concatenate([r for r, _ in left]), np.concatenate([t for _, t in left])
        found = np.linalg.lstsq(*every, rcond=None)[0]
        energy_left = float(np.sum((every[1] - every[0] @ found) ** 2))
        return energy_left / energy

    def residuals(logs: np.ndarray) -> np.ndarray:
        moved = joint.scaled(*np.exp(np.clip(logs, -3, 3)))
        parts = []
        for time, torque, angle, finer in trials:
            try:
                own = _response(moved, torque, time[1] - time[0], int(finer), _QUICK_RTOL)
            except ArithmeticError:
                own = np.zeros(time.size)
            parts.append(own - angle)
        return np.concatenate(parts) / np.sqrt(energy)

    found = optimize.least_squares(
        residuals, np.zeros(3), x_scale=0.3, diff_step=1e-3, max_nfev=_QUICK_STEPS
    )
    return float(2 * found.cost)


def _response(
    joint: Joint, torque: np.ndarray, interval: float, finer: int, rtol: float = RTOL
) -> np.ndarray:
    """Angle at the samples of a torque that is linear in so many steps a sample, on a spline."""
    if finer == 1:
        return joint.respond(torque, float(interval), rtol)
    at = np.arange(torque.size)
    spline = interpolate.make_interp_spline(at, torque, k=3)
    places = np.arange((torque.size - 1) * finer + 1) / finer
    # Straight lines lose a twelfth of the second difference of what they join.
    between = spline(places) - spline(places, 2) / (12 * finer**2)
    # At rest the spline's ringing is no torque that a joint would have to be followed for.
    between[np.abs(between) < _RINGING * np.abs(torque).max()] = 0.0
    return joint.respond(between, float(interval) / finer, rtol)[::finer]


def _pushed(
    joint: Joint, random: np.random.Generator, rate: int, long: bool, finer: int
) -> list[tuple[np.ndarray, ...]]:
    """Time, torque and angle of every trial, torque imposed: pulses, steps, random steps.

    Smooth torques have no corners: each is spread over some samples first.
    """
    strength = joint.anatomy.stiffness
    out: list[tuple[np.ndarray, ...]] = []
    for i in range(1 if long else _FIT + _HELD_OUT):
        n = round((_LONG if long else _SHORT) * rate)
        time = np.arange(n) / rate
        torque = np.zeros(n)
        quiet = round(_LEAD * rate)
        if long:
            hold = max(1, round(random.uniform(0.08, 0.25) * rate))
            levels = random.uniform(-0.25, 0.25, -(-n // hold))
            torque[quiet:] = np.repeat(levels, hold)[: n - quiet]
        elif i % 4 == 0:
            torque[quiet : quiet + max(1, round(random.uniform(0.02, 0.08) * rate))] = 0.5
        elif i % 4 == 1:
            torque[quiet:] = 0.15
        elif i % 4 == 2:
            hold = max(1, round(0.05 * rate))
            levels = random.choice([-0.15, 0.15], -(-n // hold))
            torque[quiet:] = np.repeat(levels, hold)[: n - quiet]
        else:
            waves = np.arange(1, max(2, int(0.6 * _SHORT * min(20, rate / 5))))
            phases = random.uniform(0, 2 * np.pi, waves.size)
            run = 2 * np.pi * np.outer(time[: n - quiet] / _SHORT, waves) + phases
            wave = np.sin(run).sum(axis=1)
            torque[quiet:] = 0.3 * wave / np.abs(wave).max()
        torque *= strength * random.uniform(0.5, 1.2) * (1 if long else random.choice([-1, 1]))
        if finer > 1:
            spread = np.convolve(torque, _SPREAD, mode="full")[: torque.size]
            torque = np.where(np.arange(n) < quiet, 0.0, spread)
        out.append((time, torque, _response(joint, torque, 1 / rate, finer), np.array(finer)))
    return out


def _moved(
    joint: Joint, random: np.random.Generator, rate: int, long: bool
) -> list[tuple[np.ndarray, ...]]:
    """The same, angle imposed by smooth steps; each with its motion's onsets, heights and pace."""
    out: list[tuple[np.ndarray, ...]] = []
    for _ in range(1 if long else _FIT + _HELD_OUT):
        n = round((_LONG if long else _SHORT) * rate)
        time = np.arange(n) / rate
        pace = min(random.uniform(50.0, 100.0), 0.6 * rate)
        gaps = random.uniform(0.08, 0.35, n)
        onsets = _LEAD + np.cumsum(gaps) - gaps[0]
        onsets = onsets[onsets < time[-1] - 0.1]
        reach = random.uniform(0.05, 0.25)
        heights = np.diff(random.uniform(-reach, reach, onsets.size), prepend=0.0)
        motion = Motion(onsets, heights, pace)
        angle = motion.at(time)[0]
        torque = reaction(joint, motion, time)
        out.append((time, torque, angle, onsets, heights, np.array(pace)))
    return out


def blind_cases(tier: str, seed: int, n: int) -> list[BlindSpec]:
    """List so many cases of a tier, torque and angle imposed in turn.

    Parameters
    ----------
    tier : str
        One of `TIERS`: one known effect; two or three; effects outside the library; none.
    seed : int
    n : int
    """
    names: list[tuple[str, ...]] = [(key,) for key in EFFECTS]
    several = [*PAIRS, *TRIPLES]
    outside: list[tuple[str, ...]] = [(key,) for key in UNKNOWNS]
    kinds: dict[str, tuple[Kind, list[tuple[str, ...]]]] = {
        "singles": ("known", names),
        "pairs": ("known", several),
        "unknown": ("unknown", outside),
        "nulls": ("none", [()]),
    }
    kind, keys = kinds[tier]
    random = np.random.default_rng([seed, TIERS.index(tier)])
    out = []
    for i in range(n):
        # Few cases are of many kinds, and twice as many as there are kinds are all of them.
        chosen = keys[(_STRIDE * (i // 2) + seed) % len(keys)]
        noise = NOISES[int(random.integers(len(NOISES)))]
        ratio = float(RATIOS[int(random.integers(len(RATIOS)))])
        imposed: Imposed = "torque" if i % 2 == 0 else "angle"
        label = "+".join(chosen) or "null"
        out.append(
            BlindSpec(
                f"{tier}-{i:03d}-{imposed}-{label}",
                tier,
                kind,
                chosen,
                imposed,
                noise,
                ratio,
                seed,
                (100 + TIERS.index(tier), i),
            )
        )
    return out
