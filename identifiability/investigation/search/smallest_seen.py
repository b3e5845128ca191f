"""The smallest effect that would have been seen, for every effect of the library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.independent import effective_samples
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import Model
from identifiability.joint.scheme import Scheme

_HALVINGS = 12


@dataclass(frozen=True)
class Detectable:
    """Smallest size of an effect that would have been decisive.

    Attributes
    ----------
    key : str
    parameter : str
        Parameter that measures its size.
    size : float
        In the parameter's unit; where the effect vanishes with infinite stiffness, the largest
        stiffness that would have been seen.
    unit : str
    sentence : str
    """

    key: str
    parameter: str
    size: float
    unit: str
    sentence: str


def detectable(
    bench: Workbench, candidate: Candidate, library: Mapping[str, type[Effect]]
) -> tuple[Detectable, ...]:
    """Smallest effects that would have been seen beside a fitted model.

    An effect of nominal shape is added at a size, and what the model's own free parameters cannot
    absorb of the change of its responses is compared with the noise: decisive where its square
    exceeds the decisive difference plus the penalty for the effect's parameters (as the search asks
    of it). The size is found by bisection; effects that stay invisible at any size are left out.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        The model in which nothing was found missing.
    library : mapping of str to type of Effect
    """
    split = bench.split
    problem = bench.problem(candidate.model, split.fitted, scheme=candidate.scheme)
    theta = problem.free_vector(candidate.values)
    basis, _ = np.linalg.qr(problem.jacobian(theta))
    before = problem.residuals(theta)
    samples = effective_samples(candidate.fitted)
    # The weights are not the noise: the residual says how large it is in their units.
    scale = samples / candidate.fitted.weighted
    found = []
    for key, kind in library.items():
        if key in candidate.keys:
            continue
        try:
            one = _smallest(
                bench, candidate, candidate.model + kind(), key, before, basis, scale, samples
            )
        except (InputError, np.linalg.LinAlgError):
            continue
        if one is not None:
            found.append(one)
    return tuple(found)


def _smallest(
    bench: Workbench,
    candidate: Candidate,
    model: Model,
    key: str,
    before: np.ndarray,
    basis: np.ndarray,
    scale: float,
    samples: float,
) -> Detectable | None:
    shape = starting_values(model, dict(candidate.values))[0] | dict(candidate.values)
    for name, p in model.parameters.items():
        if name.startswith(f"{key}.") and p.plain is None and p.null is None:
            shape[name] = p.nominal
    sizes = [
        n for n, p in model.parameters.items() if n.startswith(f"{key}.") and p.null is not None
    ]
    sizes = [n for n in sizes if model.parameters[n].plain is None]
    measure = sizes[0]
    p = model.parameters[measure]
    problem = bench.problem(model, bench.split.fitted)
    penalty = sum(q.plain is None for n, q in model.parameters.items() if n.startswith(f"{key}."))
    needed = bench.rules.decisive + penalty * np.log(samples)

    def seen(size: float) -> bool:
        values = shape | dict.fromkeys(sizes[1:], 0.0) | {measure: size}
        theta = model.vector(values)
        suited = problem.with_scheme(Scheme.for_model(model, theta, problem.interval))
        change = suited.residuals(suited.free_vector(values)) - before
        left = change - basis @ (basis.T @ change)
        return bool(scale * left @ left > needed)

    assert p.null is not None
    if np.isfinite(p.null):
        low, high = 0.0, p.upper - p.null
        inner = 1e-6 * p.nominal
        if not seen(p.null + high):
            high = 100 * (p.nominal - p.null)
            if not seen(p.null + high):
                return None
        for _ in range(3 * _HALVINGS):
            middle = np.sqrt(max(low, inner) * high)
            low, high = (low, middle) if seen(p.null + middle) else (middle, high)
            if high < 1.05 * max(low, inner):
                break
        size = p.null + high
        words = f"{p.description} of {size:.2g} {p.unit}"
    else:
        low, high = candidate.values["K"] + 1.0, p.upper
        if not seen(low):
            return None
        for _ in range(2 * _HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if seen(middle) else (low, middle)
            if high < 1.05 * low:
                break
        size = low
        words = f"{p.description} up to {size:.2g} {p.unit}"
    return Detectable(key, measure, float(size), p.unit, words)
