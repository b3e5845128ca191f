"""How well models are integrated: error of the steps against the effect and against noise.

Every effect that is not linear, and every instrument with a memory, is simulated at nominal and at
fast parameters, at sampling rates from 60 to 2,000 Hz, under an imposed torque and under an imposed
angle: in the steps that the investigation would take, and in far more. The measure is the error E
(Eq. 3) between the two, beside that between the joint with the effect and without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from identifiability.joint.effects import EFFECTS
from identifiability.joint.instruments import between, readings_of
from identifiability.joint.model import KBI, Imposed
from identifiability.joint.response import drive_arrays, simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.provenance import stamp

RATES = (60, 100, 200, 500, 1000, 2000)
"""Samples per second."""
NOISES = (1e-3, 1e-4)
"""Errors E that measured noise typically leaves."""
ALLOWED = 0.1 * min(NOISES)
"""Error E that the integration may have."""

JOINT = {"K": 30.0, "B": 0.8, "I": 0.1}
FAST: dict[str, dict[str, float]] = {
    "activation_lag": {"gain": 50.0, "time_constant": 0.005, "off_ratio": 3.0},
    "backlash": {"stiffness": 2000.0, "gap": 0.003, "share": 0.1},
    "coulomb_friction": {"torque": 0.3, "velocity": 0.002, "range": 1e-4, "damping": 100.0},
    "cubic_stiffness": {"coefficient": 2000.0},
    "damping_by_angle": {"difference": 1.5, "width": 0.002},
    "damping_by_direction": {"difference": 0.7, "velocity": 0.002},
    "end_stop": {"stiffness": 300.0, "angle": 0.02, "side": 1.0, "rounding": 0.0005},
    "gravity": {"moment": 30.0},
    "hill_force_velocity": {"strength": 20.0, "max_velocity": 5.0, "asymmetry": 0.5},
    "nonlinear_tendon": {"stiffness": 500.0, "hardening": 40.0, "asymmetry": 0.5},
    "quadratic_stiffness": {"coefficient": 200.0, "hardening": 5.0},
    "sensor_delay": {"delay": 0.0006},
    "sensor_lowpass": {"time_constant": 0.001, "shape": 0.5},
    "short_range_stiffness": {"stiffness": 100.0, "range": 0.005, "sharpness": 4.0},
    "stretch_reflex": {
        "position_gain": 20.0,
        "velocity_gain": 1.0,
        "delay": 0.025,
        "time_constant": 0.005,
        "asymmetry": 1.0,
        "off_ratio": 3.0,
    },
}
"""Parameters at which an effect changes quickly; the others are nominal."""

_SAMPLES = 601  # of every record, whatever its rate: one compiled program serves all rates
_REFERENCE = 16  # times as many steps
_PULSE, _LEAD = 0.05, 0.02  # s
_TONES = ((1.0, 0.3), (2.7, 1.1), (6.1, 2.3))  # Hz and phase


@dataclass(frozen=True)
class Row:
    """One effect at one sampling rate.

    Attributes
    ----------
    effect : str
    speed : {"nominal", "fast"}
    rate : int
        Samples per second.
    imposed : {"torque", "angle"}
    apriori : str
        Scheme that the model asks for before anything is computed.
    scheme : str
        Scheme that is taken: that one, or finer until its error is no more than `ALLOWED`.
    halved : float
        E as an investigation knows it, from what half the step changes.
    error : float
        E against the reference.
    size : float
        E of the joint without the effect.
    """

    effect: str
    speed: str
    rate: int
    imposed: Imposed
    apriori: str
    scheme: str
    halved: float
    error: float
    size: float

    @property
    def passes(self) -> bool:
        """Whether the error is below a tenth of the smaller noise."""
        return self.error < ALLOWED


def questions() -> Iterator[tuple[str, str, int, Imposed]]:
    """List effect, speed, rate and what is imposed, of every row."""
    for key, kind in EFFECTS.items():
        if not (KBI() + kind()).linear or kind.reads_between:
            for speed in ("nominal", "fast"):
                for rate in RATES:
                    yield key, speed, rate, "torque"
                    yield key, speed, rate, "angle"


def measure(key: str, speed: str, rate: int, imposed: Imposed) -> Row:
    """Integrate one effect at one sampling rate.

    Parameters
    ----------
    key : str
        Of the effect.
    speed : {"nominal", "fast"}
    rate : int
        Samples per second.
    imposed : {"torque", "angle"}

    Returns
    -------
    Row
    """
    model = KBI() + EFFECTS[key]()
    values = dict(zip(model.parameter_names, map(float, model.nominal), strict=True)) | JOINT
    if speed == "fast":
        values |= {f"{key}.{name}": value for name, value in FAST[key].items()}
    theta, drive = model.vector(values), _drive(rate, imposed)

    def by(scheme: Scheme) -> np.ndarray:
        return simulate(model, theta, drive, scheme=scheme)

    apriori = Scheme.for_model(model, theta, drive.interval, imposed)
    scheme, found, halved = _settled(apriori, by)
    if model.linear:
        # Its instruments see the response so many times as often.
        times = _REFERENCE * readings_of(model, drive.interval)
        interval, *arrays = map(np.asarray, between(drive_arrays(drive), times))
        finer = Drive(float(interval), *arrays)
        reference = simulate(model, theta, finer)[::times]
    else:
        reference = by(Scheme(_REFERENCE * max(scheme.substeps, 4), 4))
    without = simulate(KBI(), np.array(list(JOINT.values())), drive)
    return Row(
        key,
        speed,
        rate,
        imposed,
        str(apriori),
        str(scheme),
        halved,
        _error(found, reference),
        _error(without, reference),
    )


def _settled(
    scheme: Scheme, by: Callable[[Scheme], np.ndarray]
) -> tuple[Scheme, np.ndarray, float]:
    """The scheme that half the step leaves as it is, its response, and its error by that."""
    while True:
        found = by(scheme)
        halved = _error(found, by(scheme.halved)) / scheme.shown
        if halved <= ALLOWED or scheme.finest:
            return scheme, found, halved
        scheme = scheme.improved(halved / ALLOWED)


def _error(found: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sum((found - reference) ** 2) / np.sum(reference**2))


def _drive(rate: int, imposed: Imposed) -> Drive:
    time = np.arange(_SAMPLES) / rate
    moved = np.maximum(time - _LEAD, 0.0)
    waves = sum(np.sin(2 * np.pi * f * moved + p) - np.sin(p) for f, p in _TONES)
    if imposed == "angle":
        # The motion begins smoothly, as a servo moves.
        return imposed_motion(time, 0.05 * np.tanh(10 * moved) ** 3 * waves)
    pulse = np.where((time > _LEAD) & (time <= _LEAD + _PULSE), 6.0, 0.0)
    return SampledTorque(pulse + waves).drive(time)


def record(rows: Sequence[Row]) -> dict[str, Any]:
    """Plain record, for JSON."""
    return {
        "schema": 1,
        **stamp(__name__),
        "noises": list(NOISES),
        "allowed": ALLOWED,
        "joint": JOINT,
        "fast": FAST,
        "rows": [asdict(row) | {"passes": row.passes} for row in rows],
    }
