"""The model that an investigation starts from, fitted from a regression's guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.starts import first_guess, starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.joint.model import KBI, Model

_FACTORS = (1.0, 0.3, 3.0)


def fit_baseline(bench: Workbench, model: Model, *, refined: bool = False) -> Candidate:
    """Fit a model to the trials that are not held out, with nothing known beforehand.

    Parameters
    ----------
    bench : Workbench
    model : Model
    refined : bool
        Whether parameters that refine an effect are free too.

    Raises
    ------
    InputError
        Where no fit succeeds.
    """
    trials = [r.trial for r in bench.split.fitted]
    values = map(float, first_guess(trials, bench.prior(KBI())))
    guess = dict(zip(("K", "B", "I"), values, strict=True))
    starts = []
    for factor in _FACTORS:
        start = guess | {"K": factor * guess["K"], "B": guess["B"] / factor}
        starts += starting_values(model, start, most=3 if model.effects else 1)
    found = bench.fit(model, starts, refined=model.effect_keys if refined else ())
    if found.failure:
        raise InputError(f"{model!r} could not be fitted: {found.failure}")
    return found


def leads_are_motion(bench: Workbench) -> bool:
    """Whether K, B and I explain most of what precedes the onsets: then it is not noise."""
    if not (bench.split.has_noise and bench.split.moves_early):
        return False
    kbi = fit_baseline(bench, KBI())
    leads = [(r, slice(r.lead.n_samples)) for r in bench.split.fitted]
    left = sum(
        float(np.sum(e[s] ** 2)) for e, (_, s) in zip(kbi.fitted.by_trial, leads, strict=True)
    )
    return left < 0.5 * sum(float(np.sum(r.compared[s] ** 2)) for r, s in leads)


def without_leads(bench: Workbench) -> Workbench:
    """Return the bench with the same trials, their noise and level at rest unknown."""
    return replace(bench, split=bench.split.without_leads())
