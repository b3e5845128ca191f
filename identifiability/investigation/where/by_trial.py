"""In which trials, or kinds of perturbation, a model fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identifiability.investigation.fits.refits import correlation_time
from identifiability.investigation.where.compare import plain
from identifiability.investigation.where.scene import Scene, View
from identifiability.investigation.where.whitening import excess


@dataclass(frozen=True, eq=False)
class TrialView(View):
    """Error of each trial, or condition, against the noise; or against the others, if unknown.

    Attributes
    ----------
    names : tuple of str
    errors : array, shape (n,)
        E (Eq. 3).
    pooled : float
        E over all.
    ratio : array, shape (n,)
        Mean square of the residual over that of the noise; where that is unknown, error or mean
        square over the others', whichever is less.
    p_values, flags : array, shape (n,)
    """

    names: tuple[str, ...]
    errors: np.ndarray
    pooled: float
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray


def by_trial(
    scene: Scene, groups: Sequence[tuple[str, list[int]]], what: str, plural: str
) -> TrialView:
    """Test the residual of every trial, or group of trials."""
    fitted = scene.candidate.fitted
    names = tuple(name for name, _ in groups)
    errors = np.array([float(np.mean(fitted.errors[members])) for _, members in groups])
    n = len(groups)
    ratio, p_values = np.ones(n), np.ones(n)
    if scene.noise.known:
        for k, (_, members) in enumerate(groups):
            portions = [scene.noise.portion(i, scene.blocks[i], slice(None)) for i in members]
            total = sum(float(np.sum(scene.blocks[i].values ** 2)) for i in members)
            ratio[k], p_values[k] = excess(total, portions, scene.slack)
    elif n > 1:
        # The noise may be alike in all trials, or in proportion to the response: exceed both.
        squares = [float(np.mean(r**2)) for r in fitted.by_trial]
        samples = [r.size / correlation_time((r,)) for r in fitted.by_trial]
        counts = np.array([sum(samples[i] for i in members) for _, members in groups])
        levels = np.array([np.mean([squares[i] for i in members]) for _, members in groups])
        for k in range(n):
            others = np.arange(n) != k
            ratio[k] = min(
                x[k] / max(float(np.average(x[others], weights=counts[others])), 1e-300)
                for x in (errors, levels)
            )
            p_values[k] = stats.f.sf(ratio[k], counts[k], counts[others].sum())
    flags = scene.significant(p_values)
    pooled = fitted.error
    if n == 1 and not scene.noise.known:
        sentence = f"There is one {what} (E = {plain(pooled)}), and the noise is unknown."
    elif not flags.any():
        against = (
            "the noise explains" if scene.noise.known else "the others have (the noise is unknown)"
        )
        sentence = f"No {what} has a larger error than {against} (E = {plain(pooled)})."
    else:
        worst = int(np.argmax(np.where(flags, ratio, 0.0)))
        against = (
            "the noise explains" if scene.noise.known else "the others have (the noise is unknown)"
        )
        sentence = (
            f"{flags.sum()} of {n} {plural} have a larger error than {against}; it is largest "
            f"against that in {names[worst]} (E = {plain(errors[worst])}, over all "
            f"{plain(pooled)})."
        )
        if n == 1:
            sentence = f"The one {what} has a larger error than {against} (E = {plain(pooled)})."
    return TrialView(bool(flags.any()), sentence, names, errors, pooled, ratio, p_values, flags)
