"""How long a response and its first derivatives take, by machine code and by JAX.

A fit asks for them one parameter vector at a time, a search for missing effects of some hundred
models. Both ways take the same steps; what is timed apart is what each model costs once.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from identifiability.joint.effects import EFFECTS
from identifiability.joint.instruments import readings_of
from identifiability.joint.integrator import integrate
from identifiability.joint.model import KBI, Imposed, Model
from identifiability.joint.native.response import responses_of
from identifiability.joint.programs import compiled
from identifiability.joint.response import drive_arrays, exact_response
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.provenance import stamp

MODELS = (
    (),
    *((key,) for key in EFFECTS),
    ("coulomb_friction", "gravity", "stretch_reflex"),
    ("hill_force_velocity", "nonlinear_tendon"),
)
"""Effects of the models that are timed."""

SAMPLES, RATE = 500, 500
_CALLS = 7  # of which the quickest counts


@dataclass(frozen=True)
class Row:
    """One model under one kind of drive.

    Attributes
    ----------
    effects : tuple of str
    imposed : {"torque", "angle"}
    scheme : str
    n_parameters : int
        By which there are derivatives.
    once : float
        Time [s] that the model costs once by machine code.
    once_jax : float
        The same by JAX, nothing of it kept from before: tracing and compiling.
    each, each_jax : float
        Time [s] of every evaluation.
    difference : float
        Largest difference of the two ways, over the largest value of its column.
    """

    effects: tuple[str, ...]
    imposed: Imposed
    scheme: str
    n_parameters: int
    once: float
    once_jax: float
    each: float
    each_jax: float
    difference: float


def questions() -> Iterator[tuple[tuple[str, ...], Imposed]]:
    """List effects and what is imposed, of every row."""
    for effects in MODELS:
        yield effects, "torque"
        yield effects, "angle"


def measure(effects: Sequence[str], imposed: Imposed) -> Row:
    """Time one model.

    Parameters
    ----------
    effects : sequence of str
        Their keys.
    imposed : {"torque", "angle"}
    """
    model = KBI()
    for key in effects:
        model = model + EFFECTS[key]()
    theta, drive = 1.01 * model.nominal, _drive(imposed)
    scheme = Scheme.for_model(model, theta, drive.interval, imposed)
    free = tuple(range(theta.size))
    # What serves all models is compiled before: loops over samples, and what instruments do.
    warm = responses_of(KBI(), (0, 1, 2), [drive], scheme)
    assert warm is not None
    warm.at(np.array([30.0, 1.0, 0.1]))

    began = time.perf_counter()
    code = responses_of(model, free, [drive], scheme)
    assert code is not None
    found = code.at(theta)[0]
    first, each = time.perf_counter() - began, _quickest(lambda: code.at(theta))

    # A number that no other run has: nothing of it was compiled before.
    by_jax = compiled(partial(_linearised, scheme=scheme, unlike=time.time()))
    arrays = drive_arrays(drive)

    def ask() -> np.ndarray:
        return np.asarray(by_jax(model, theta, arrays))

    began = time.perf_counter()
    expected = ask()
    first_jax, each_jax = time.perf_counter() - began, _quickest(ask)
    size = np.maximum(np.max(np.abs(expected), axis=0), 1e-300)
    return Row(
        tuple(effects),
        imposed,
        str(scheme),
        theta.size,
        max(first - each, 0.0),
        max(first_jax - each_jax, 0.0),
        each,
        each_jax,
        float(np.max(np.abs(found - expected) / size)),
    )


def _linearised(model: Model, theta: Any, arrays: Any, scheme: Scheme, unlike: float) -> Any:
    readings = readings_of(model, 1 / RATE)

    def twice(x: Any) -> Any:
        if scheme.exact:
            response = exact_response(model, x, arrays, readings)
        else:
            steps = scheme.between(readings)
            response = integrate(model, x, arrays, steps, scheme.order, steps, readings)
        response = jnp.where(x[0] == unlike, 0.0, response)
        return response, response

    slopes, response = jax.jacfwd(twice, has_aux=True)(theta)
    return jnp.concatenate([response[:, None], slopes], axis=1)


def _quickest(ask: Any) -> float:
    took = []
    for _ in range(_CALLS):
        began = time.perf_counter()
        ask()
        took.append(time.perf_counter() - began)
    return min(took)


def _drive(imposed: Imposed) -> Drive:
    at = np.arange(SAMPLES) / RATE
    waves = np.sin(2 * np.pi * 3 * at) ** 3 + 0.5 * np.sin(2 * np.pi * 11 * at) ** 3
    if imposed == "angle":
        return imposed_motion(at, 0.05 * waves)
    return SampledTorque(2.0 * waves).drive(at)


def record(rows: Sequence[Row]) -> dict[str, Any]:
    """Plain record, for JSON: what all models cost once, and the median ratio of evaluations."""
    return {
        "schema": 1,
        **stamp(__name__),
        "samples": SAMPLES,
        "rate": RATE,
        "once": float(sum(r.once for r in rows)),
        "once_jax": float(sum(r.once_jax for r in rows)),
        "median_each": float(np.median([r.each_jax / r.each for r in rows])),
        "least_each": float(min(r.each_jax / r.each for r in rows)),
        "rows": [asdict(row) for row in rows],
    }
