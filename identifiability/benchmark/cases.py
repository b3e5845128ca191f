"""Measured joints whose truth is known, in tiers of difficulty."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from identifiability.benchmark.effects import EFFECTS
from identifiability.benchmark.joints import Joint, draw_joint
from identifiability.benchmark.protocol import (
    INTERVAL,
    Load,
    Protocol,
    Recorder,
    record,
    responses,
    short,
    standard,
)
from identifiability.benchmark.unknowns import UNKNOWNS
from identifiability.benchmark.visibility import missed_by_kbi, missed_without
from identifiability.errors import InputError
from identifiability.measurement.trials import Trial

Kind = Literal["known", "none", "unknown", "unrepeatable"]

MATTERS = 3.0
"""Error without an effect, over the noise's, from which on the effect matters."""

ATTEMPTS = 6
"""Joints that are drawn at most until each of their effects matters."""

LARGEST_MOVEMENT = 0.9
"""Angle (rad) that no pulse may exceed."""

PROTOCOLS = {"standard": standard, "short": short}


@dataclass(frozen=True, eq=False)
class HiddenCase:
    """A recorded joint and what is hidden in it.

    Attributes
    ----------
    name : str
    truth : tuple of str
        Keys of the hidden effects; empty where there is none.
    kind : {"known", "none", "unknown", "unrepeatable"}
        Effects that an investigation should name; none, only noise; effects outside its list; or a
        joint that is not the same in every trial.
    parameters : mapping
        Every hidden value by name; forms of effects are words.
    fit, held_out : tuple of Trial
    noise_ratio : float
        Energy of the angle's noise over that of the angle.
    weak : bool
        Whether an effect of the truth hides below `MATTERS` times the noise, when stiffness,
        damping and inertia are fitted without it.
    seed : int
    """

    name: str
    truth: tuple[str, ...]
    kind: Kind
    parameters: Mapping[str, float | str] = field(repr=False)
    fit: tuple[Trial, ...] = field(repr=False)
    held_out: tuple[Trial, ...] = field(repr=False)
    noise_ratio: float
    weak: bool
    seed: int

    @property
    def joint(self) -> dict[str, float]:
        """Its K, B and I in SI units, what is hidden not counted; of a measured joint.

        Before a coupling there is some of the inertia, which is found as a share of all.
        """
        size = float(self.parameters["size"])

        def of(*names: str) -> float:
            return size * sum(float(self.parameters[name]) for name in names)

        return {
            "K": of("passive_stiffness", "muscle_stiffness"),
            "B": of("passive_damping", "muscle_damping"),
            "I": of("inertia", *(n for n in self.parameters if n.endswith(".handle_inertia"))),
        }


@dataclass(frozen=True)
class CaseSpec:
    """A case that is not built yet.

    Attributes
    ----------
    name : str
        Tier, number, effects.
    kind : {"known", "none", "unknown", "unrepeatable"}
    keys : tuple of str
        Keys of the hidden effects.
    forms : tuple of str or None
        Form of each effect, drawn where it is ``None``.
    recorder : Recorder
    seed : int
    stream : tuple of int
        Which of the seed's random streams is the case's own.
    variation : float
        Relative standard deviation of stiffness and damping from trial to trial.
    protocol : {"standard", "short"}
    """

    name: str
    kind: Kind
    keys: tuple[str, ...]
    forms: tuple[str | None, ...]
    recorder: Recorder
    seed: int
    stream: tuple[int, int]
    variation: float = 0.0
    protocol: Literal["standard", "short"] = "standard"

    def build(self) -> HiddenCase:
        """Draw the joint, simulate its trials and record them."""
        root = np.random.SeedSequence(self.seed, spawn_key=self.stream)
        for_joint, for_variation, for_records = root.spawn(3)
        protocol = PROTOCOLS[self.protocol]()
        joint, matters = self._draw(np.random.default_rng(for_joint), protocol)
        loads = (*protocol.fit, *protocol.held_out)
        n_fit = len(protocol.fit)

        rng = np.random.default_rng(for_variation)
        factors = 1.0 + self.variation * rng.standard_normal((len(loads), 2))
        angles = [
            joint.scaled(stiffness, damping).respond(load.torque, INTERVAL)
            for load, (stiffness, damping) in zip(loads, factors.tolist(), strict=True)
        ]
        if self.keys:
            missed = missed_by_kbi(joint, protocol.fit, angles[:n_fit])
            matters = matters and missed > MATTERS * self.recorder.ratio
        trials = tuple(
            record(load, angle, self.recorder, np.random.default_rng(stream))
            for load, angle, stream in zip(
                loads, angles, for_records.spawn(len(loads)), strict=True
            )
        )
        return HiddenCase(
            name=self.name,
            truth=self.keys,
            kind=self.kind,
            parameters=self._parameters(joint),
            fit=trials[:n_fit],
            held_out=trials[n_fit:],
            noise_ratio=self.recorder.ratio,
            weak=bool(self.keys) and not matters,
            seed=self.seed,
        )

    def _draw(self, rng: np.random.Generator, protocol: Protocol) -> tuple[Joint, bool]:
        """Draw joints until one comes to rest and each of its effects matters.

        Where none does, the last that comes to rest is what there is.

        Returns
        -------
        tuple of Joint and bool
            The joint, and whether each of its effects matters.
        """
        n_settled, n_drawn, matters = 0, 0, False
        while n_settled < ATTEMPTS and not matters:
            n_drawn += 1
            if n_drawn > 20 * ATTEMPTS:
                raise ArithmeticError(f"{self.name}: no joint with {self.keys} comes to rest")
            candidate = draw_joint(self.keys, rng, self.forms)
            if _settles(candidate):
                joint, n_settled = candidate, n_settled + 1
                matters = not self.keys or self._each_matters(joint, protocol)
        return joint, matters

    def _each_matters(self, joint: Joint, protocol: Protocol) -> bool:
        """Whether the joint is missed without its effects, and without each one of them."""
        loads = _quick(protocol)
        angles = responses(joint, loads)
        least = MATTERS * self.recorder.ratio
        if missed_by_kbi(joint, loads, angles) < least:
            return False
        if len(self.keys) == 1:
            return True
        # The pulse of 50 ms and the step tell combined effects apart about as well as all trials.
        loads, angles = loads[-2:], angles[-2:]
        return all(missed_without(key, joint, loads, angles) > least for key in self.keys)

    def _parameters(self, joint: Joint) -> dict[str, float | str]:
        recorded = dataclasses.asdict(self.recorder)
        values = {f"recorder.{name}": value for name, value in recorded.items()}
        return {**joint.parameters, **values, "variation": self.variation}


def _quick(protocol: Protocol) -> list[Load]:
    """The strongest pulse of each length and the strongest step, which are simulated fastest."""
    return [
        max(
            (load for load in protocol.fit if load.kind == kind),
            key=lambda load: abs(load.amplitude),
        )
        for kind in ("pulse5", "pulse50", "step")
    ]


def _settles(joint: Joint) -> bool:
    """Whether the movements after the strongest pulses stay within reach and decay."""
    strongest = (standard().held_out[-1], standard().fit[4])
    try:
        angles = [np.abs(joint.respond(load.torque, INTERVAL)) for load in strongest]
    except ArithmeticError:
        return False
    return all(y.max() < LARGEST_MOVEMENT and y[-150:].max() < 0.5 * y.max() for y in angles)


# The tiers

RATIOS = (1e-5, 1e-4, 1e-3)

QUIET = ("activation_lag", "stretch_reflex", "gravity", "second_mass")
"""Effects of which K, B and I absorb too much to be seen in the strongest noise."""

PAIRS: tuple[tuple[str, ...], ...] = (
    ("series_tendon", "stretch_reflex"),
    ("series_tendon", "hill_force_velocity"),
    ("series_tendon", "coulomb_friction"),
    ("series_tendon", "gravity"),
    ("series_tendon", "cubic_stiffness"),
    ("series_tendon", "sensor_drift"),
    ("nonlinear_tendon", "stretch_reflex"),
    ("nonlinear_tendon", "coulomb_friction"),
    ("maxwell_branch", "quadratic_stiffness"),
    ("activation_lag", "coulomb_friction"),
    ("stretch_reflex", "hill_force_velocity"),
    ("stretch_reflex", "coulomb_friction"),
    ("stretch_reflex", "quadratic_stiffness"),
    ("stretch_reflex", "sensor_delay"),
    ("hill_force_velocity", "gravity"),
    ("hill_force_velocity", "second_mass"),
    ("short_range_stiffness", "stretch_reflex"),
    ("second_mass", "cubic_stiffness"),
    ("coulomb_friction", "sensor_lowpass"),
    ("quadratic_stiffness", "sensor_drift"),
    ("stretch_reflex", "end_stop"),
    ("gravity", "end_stop"),
    ("series_tendon", "damping_by_angle"),
    ("coulomb_friction", "damping_by_direction"),
)

TRIPLES: tuple[tuple[str, ...], ...] = (
    ("series_tendon", "stretch_reflex", "hill_force_velocity"),
    ("series_tendon", "stretch_reflex", "sensor_drift"),
    ("stretch_reflex", "coulomb_friction", "gravity"),
    ("short_range_stiffness", "stretch_reflex", "sensor_delay"),
    ("second_mass", "coulomb_friction", "cubic_stiffness"),
    ("hill_force_velocity", "quadratic_stiffness", "sensor_lowpass"),
)

CONTROLS: tuple[tuple[str, Recorder, float], ...] = (
    ("white", Recorder(1e-5), 0.0),
    ("white", Recorder(1e-4), 0.0),
    ("white", Recorder(1e-3), 0.0),
    ("ar1", Recorder(1e-4, correlation=0.7), 0.0),
    ("ar1", Recorder(1e-3, correlation=0.7), 0.0),
    ("ar1", Recorder(1e-5, correlation=0.9), 0.0),
    ("ar1", Recorder(1e-4, correlation=0.9), 0.0),
    ("ar1", Recorder(1e-3, correlation=0.9), 0.0),
    ("hum", Recorder(1e-5, hum=1.0), 0.0),
    ("hum", Recorder(1e-4, hum=0.7), 0.0),
    ("quantised", Recorder(1e-5, resolution=3e-4), 0.0),
    ("quantised", Recorder(1e-4, resolution=1e-3), 0.0),
    ("torque_noise", Recorder(1e-5, torque_noise=0.01), 0.0),
    ("torque_noise", Recorder(1e-4, torque_noise=0.01), 0.0),
    ("torque_noise", Recorder(1e-3, torque_noise=0.01), 0.0),
    ("ar1_torque_noise", Recorder(1e-4, correlation=0.9, torque_noise=0.01), 0.0),
    ("ar1_quantised", Recorder(1e-4, correlation=0.7, resolution=5e-4), 0.0),
    ("variation", Recorder(1e-5), 0.05),
    ("variation", Recorder(1e-4), 0.05),
    ("variation", Recorder(1e-3), 0.05),
)
"""Joints without an effect: what nastiness, how it is recorded, variation of K and B."""

CONTROL_DRAWS = 5
"""Joints of each kind of control."""

NULLS = 100
"""Joints without an effect, in white noise: where none of so many is named, the rate of false names
is below 3.7 % (Wilson)."""

QUICK: tuple[tuple[str, int], ...] = (
    ("controls", 1),
    ("controls", 6),
    ("singles", 0),
    ("singles", 14),
    ("singles", 28),
    ("singles", 36),
    ("pairs", 11),
    ("unknown", 0),
)
"""A few of every tier, by tier and number."""


def hidden_cases(tier: str, seed: int) -> list[CaseSpec]:
    """List the cases of a tier; each is built, deterministically, by its own `CaseSpec.build`.

    Parameters
    ----------
    tier : str
        "singles": every known effect, alone. "nulls": no effect, and white noise. "controls": no
        effect, but awkward noise. "pairs": two and three effects at once. "unknown": effects
        outside the list. "quick": some of each, with fewer and shorter trials.
    seed : int
        Of all random draws; a case does not depend on which others are built.

    Raises
    ------
    InputError
        For a tier that does not exist.
    """
    if tier not in TIERS:
        raise InputError(f"found the tier '{tier}', expected one of {list(TIERS)}")
    if tier == "quick":
        full = {name: hidden_cases(name, seed) for name in {source for source, _ in QUICK}}
        return [
            dataclasses.replace(
                full[source][number], name=f"quick-{full[source][number].name}", protocol="short"
            )
            for source, number in QUICK
        ]
    number = TIERS.index(tier)
    drafts = {
        "singles": _singles,
        "controls": _controls,
        "pairs": _pairs,
        "unknown": _unknown,
        "nulls": _nulls,
    }[tier]()
    return [
        CaseSpec(
            name=f"{tier}-{index:02d}-{label}",
            kind=kind,
            keys=keys,
            forms=forms,
            recorder=recorder,
            seed=seed,
            stream=(number, index),
            variation=variation,
        )
        for index, (label, kind, keys, forms, recorder, variation) in enumerate(drafts)
    ]


# A tier's place sets its random streams: a new one goes to the end.
TIERS = ("singles", "controls", "pairs", "unknown", "quick", "nulls")

Draft = tuple[str, Kind, tuple[str, ...], tuple[str | None, ...], Recorder, float]


def _recorder(ratio: float, index: int) -> Recorder:
    """White noise, in every fourth case correlated."""
    return Recorder(ratio, correlation=0.9 if index % 4 == 3 else 0.0)


def _singles() -> Iterator[Draft]:
    draws = [(key, draw) for key in EFFECTS for draw in range(3)]
    # Forms beyond the third come last, so that they change no other case.
    draws += [(key, d) for key, effect in EFFECTS.items() for d in range(3, len(effect.forms))]
    numbers = {key: number for number, key in enumerate(EFFECTS)}
    for index, (key, draw) in enumerate(draws):
        forms, ratio = EFFECTS[key].forms, RATIOS[(numbers[key] + draw) % 3]
        if key in QUIET:
            ratio = min(ratio, 1e-4)
        yield key, "known", (key,), (forms[draw % len(forms)],), _recorder(ratio, index), 0.0


def _nulls() -> Iterator[Draft]:
    for index in range(NULLS):
        yield "white", "none", (), (), Recorder(RATIOS[index % 3]), 0.0


def _controls() -> Iterator[Draft]:
    for label, recorder, variation in CONTROL_DRAWS * CONTROLS:
        yield label, "unrepeatable" if variation else "none", (), (), recorder, variation


def _pairs() -> Iterator[Draft]:
    for index, keys in enumerate(PAIRS + TRIPLES):
        forms = (None,) * len(keys)
        ratio = RATIOS[index % 2]
        yield "+".join(keys), "known", keys, forms, _recorder(ratio, index), 0.0


def _unknown() -> Iterator[Draft]:
    # Those that the published cases know; the blind ones draw from all.
    known = list(UNKNOWNS)[:5]
    for index, key in enumerate([*known, *known, "time_varying_stiffness", "bouc_wen"]):
        ratio = RATIOS[index // len(known)]
        yield key, "unknown", (key,), (None,), _recorder(ratio, index), 0.0
