"""How many samples of a residual count as independent."""

from __future__ import annotations

import numpy as np

from identifiability.investigation.fits.candidate import Residual
from identifiability.measurement.noise import correlation_time


def effective_samples(rest: Residual, change: Residual | None = None) -> float:
    """Number of samples that count as independent in the comparison of two fits.

    A change of the prediction is judged against noise with the residual's own spectrum: its
    variance along the change, over what it would be if the residual were white, says how many
    samples count as one (as heteroscedasticity- and autocorrelation-consistent tests have it, Newey
    & West 1987, Econometrica 55: 703-708). A slow wander of the residual does not blur a fast
    effect; a residual of the effect's own pace does.

    Parameters
    ----------
    rest : Residual
        Taken for the noise: that of the best model.
    change : Residual, optional
        Differences of two models' residuals. Without it the slowest change is assumed, for which
        samples count by the residual's integrated autocorrelation time.
    """
    if change is None:
        return float(sum(r.size / correlation_time(r - r.mean()) for r in rest.by_trial))
    seen, white = 0.0, 0.0
    for left, moved in zip(rest.by_trial, change.by_trial, strict=True):
        n = left.size
        weight = 1.0 / max(float(np.mean(left**2)), 1e-300) ** 2
        power = np.abs(np.fft.fft(left, 2 * n)) ** 2 / n
        moves = np.abs(np.fft.fft(moved, 2 * n)) ** 2
        seen += weight * float(np.mean(power * moves))
        white += weight * float(np.mean(left**2) * np.mean(moves))
    correlation = seen / white if white > 0 else 1.0
    return rest.n_samples / max(1.0, correlation)


def difference(first: Residual, second: Residual) -> Residual:
    """Change of the prediction from the first to the second model, trial by trial."""
    moved = tuple(a - b for a, b in zip(first.by_trial, second.by_trial, strict=True))
    return Residual(moved, np.zeros(len(moved)), 0.0)
