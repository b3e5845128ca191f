"""Findings that are made up: what is probable, what a model leaves, and what nothing names."""

import numpy as np

from identifiability.investigation.fits.candidate import Candidate, Residual, unfitted
from identifiability.investigation.posterior.probabilities import (
    Probabilities,
    SetProbability,
    WeighedSet,
)
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.unexplained.explanation import Family
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI


def model_of(*keys):
    """K, B and I with some effects."""
    return sum((EFFECTS[key]() for key in keys), KBI())


def values_of(model):
    """Nominal values of all parameters."""
    return dict(zip(model.parameter_names, model.nominal, strict=True))


def probabilities(*rows, evidence=None):
    """Rows of (effects, probability) as probabilities; evidence by set, 0 by default."""
    ranked = tuple(SetProbability(e, p, 0.0) for e, p in sorted(rows, key=lambda r: -r[1]))
    known = {tuple(sorted(e)) for e, _ in rows if e is not None} | {(), *(evidence or {})}
    sets = {
        keys: WeighedSet(
            unfitted(model_of(*keys), values_of(model_of(*keys))),
            (evidence or {}).get(keys, 0.0),
            0.1 / (1 + len(keys)),
        )
        for keys in known
    }
    return Probabilities(ranked, (), {}, 0.5, 1.0, None, (), {}, None, sets, (100, 100))


def candidate(error, *keys):
    """A fitted model that leaves so much of both parts."""
    model = model_of(*keys)
    white = np.random.default_rng(1).standard_normal(500)
    left = Residual((white,), np.array([error]), 500 * error)
    return Candidate(model, values_of(model), model.parameter_names, left, left)


def left_over(kind, share=0.9, noise_ratio=1.0):
    """A clear account of what is left; noise comes second, or a torque of each trial's own."""
    second = "unrepeatable" if kind == "none" else "none"
    families = [
        Family(k, k, k, evidence, {}, {}, False) for k, evidence in ((kind, 0.0), (second, -1.0))
    ]
    return Unexplained(tuple(families), 1.0, share, (), noise_ratio)
