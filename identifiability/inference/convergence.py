"""Whether samples may be believed: R-hat, nested R-hat, effective sample sizes, and their limits.

All are judged across ensembles that know nothing of each other. Ensembles that begin in one place
and have not left it yet agree with each other perfectly, however wrong they are; so each begins at
a point of its own, and *nested R-hat* (Margossian, Hoffman, Sountsov, Riou-Durand, Vehtari &
Gelman 2024, Bayesian Analysis, doi:10.1214/24-BA1453) asks whether all of them have forgotten it.
It is made for many short chains, of which none needs to have explored the posterior alone.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

RHAT_LIMIT = 1.01
ESS_LIMIT = 400.0
FEWEST_STEPS = 200
"""Steps in which walkers that depend on each other show how slowly they forget their start."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """Diagnostics of samples.

    Attributes
    ----------
    rhat : array, shape (k,)
        Rank-normalised split R-hat of each ensemble's draws in one row (Vehtari et al. 2021).
    rhat_nested : array, shape (k,)
        See `rhat_nested`.
    ess_bulk, ess_tail : array, shape (k,)
        Effective sample sizes.
    sd_mcse : array, shape (k,)
        Monte Carlo error of the standard deviations.
    unmet : tuple of str
        Every limit that is not met, with the figure; empty where the samples may be used.
    """

    rhat: np.ndarray
    rhat_nested: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    sd_mcse: np.ndarray
    unmet: tuple[str, ...]


def convergence(draws: np.ndarray, names: tuple[str, ...], *, independent: bool) -> Convergence:
    """Hold samples to every limit.

    Parameters
    ----------
    draws : array, shape (n_ensembles, n_walkers, n_steps, k)
        The ensembles must not know of each other, and each must have begun at a point of its own,
        further from the others' than the posterior is wide or as far: see `rhat_nested`.
    names : tuple of str
        Of the k parameters.
    independent : bool
        Whether the walkers of an ensemble move independently of each other.
    """
    n_ensembles, _, n_steps, k = draws.shape
    if independent:
        # Walker after walker, so that neighbours in the row are neighbours in a walker's time.
        rhat, bulk, tail, mcse = diagnose(draws.reshape(n_ensembles, -1, k))
    else:
        # In time order: one ensemble counts as one chain.
        in_time = draws.transpose(0, 2, 1, 3)
        rhat, bulk, tail, mcse = diagnose(in_time.reshape(n_ensembles, -1, k))
        bulk, tail, mcse = _of_dependent_walkers(in_time, bulk, tail)
    nested = rhat_nested(draws)

    def worst(what: str, values: np.ndarray, limit: float, sign: float) -> list[str]:
        i = int(np.argmax(np.where(np.isnan(values), np.inf, sign * values)))
        if sign * values[i] < sign * limit:
            return []
        asked = "less than" if sign > 0 else "at least"
        figure = f"{values[i]:.3f}" if sign > 0 else f"{values[i]:.0f}"
        return [f"{what} of {names[i]} is {figure}, and {asked} {limit:g} is asked"]

    unmet = [
        *worst("nested R-hat", nested, RHAT_LIMIT, 1.0),
        *worst("R-hat", rhat, RHAT_LIMIT, 1.0),
        *worst("the bulk effective sample size", bulk, np.nextafter(ESS_LIMIT, 0), -1.0),
        *worst("the tail effective sample size", tail, np.nextafter(ESS_LIMIT, 0), -1.0),
    ]
    different = np.unique(draws[..., 0]).size
    # As many independent draws as are claimed must at least differ.
    if different < ESS_LIMIT:
        unmet.append(f"only {different} draws differ")
    if not independent and n_steps < FEWEST_STEPS:
        unmet.append(f"{n_steps} steps are too few, {FEWEST_STEPS} are asked")
    return Convergence(rhat, nested, bulk, tail, mcse, tuple(unmet))


def rhat_nested(draws: np.ndarray) -> np.ndarray:
    r"""Nested R-hat on ranks, of location and of spread whichever is larger.

    .. math:: \sqrt{1 + B / W}

    where B is the variance of the ensembles' means and W the variance within ensembles, between
    walkers and in each walker's time (Margossian et al. 2024); ranks and folding as in
    Vehtari et al. 2021. Walkers that still huddle about where their ensemble began make W small
    and leave B large.

    Where an ensemble is worth E independent draws, B / W is near 1 / E, so that the limit of 1.01
    asks for about 50 from each (about: four ensembles know B to three degrees of freedom).
    Walkers that depend on each other are worth fewer, as their mean wanders with them: B grows,
    and nothing else. Such an ensemble fails for longer, and needs no other limit.

    Parameters
    ----------
    draws : array, shape (n_ensembles, n_walkers, n_steps, k)

    Returns
    -------
    array, shape (k,)
        Infinite where nothing moved.
    """
    out = []
    for x in np.moveaxis(np.asarray(draws, float), -1, 0):
        folded = np.abs(x - np.median(x))
        out.append(max(nested_ratio(_normal_scores(x)), nested_ratio(_normal_scores(folded))))
    return np.array(out)


def nested_ratio(x: np.ndarray) -> float:
    """Nested R-hat of one quantity as it is, shape (n_ensembles, n_walkers, n_steps)."""
    _, walkers, n_steps = x.shape
    means = x.mean(axis=2)
    within = x.var(axis=2, ddof=1).mean() if n_steps > 1 else 0.0
    within += means.var(axis=1, ddof=1).mean() if walkers > 1 else 0.0
    between = means.mean(axis=1).var(ddof=1)
    return float(np.sqrt(1 + between / within)) if within > 0 else float("inf")


def _normal_scores(x: np.ndarray) -> np.ndarray:
    return np.asarray(ndtri((rankdata(x).reshape(x.shape) - 0.375) / (x.size + 0.25)))


def _arviz() -> ModuleType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # 0.x announces 1.x at every import
        try:
            import arviz
        except FileNotFoundError:
            # It notes on which day it announced that; another process has just moved that note.
            import arviz
    return arviz


def diagnose(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rank R-hat, bulk and tail effective sample size, and Monte Carlo error of the sd.

    Parameters
    ----------
    draws : array, shape (n_chains, n_draws, k)

    Returns
    -------
    tuple of four arrays, shape (k,)
    """
    arviz = _arviz()
    if hasattr(arviz, "Numba"):
        arviz.Numba.disable_numba()  # in 0.x what it compiles fails with NumPy 2
    columns = np.moveaxis(draws, -1, 0)
    return (
        np.array([float(arviz.rhat(x, method="rank")) for x in columns]),
        np.array([float(arviz.ess(x, method="bulk")) for x in columns]),
        np.array([float(arviz.ess(x, method="tail", prob=(0.05, 0.95))) for x in columns]),
        np.array([float(arviz.mcse(x, method="sd")) for x in columns]),
    )


def _of_dependent_walkers(
    in_time: np.ndarray, bulk: np.ndarray, tail: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Effective sample sizes that count walkers as dependent.

    From the series of ensemble means, whose variance is that of one draw divided by the number of
    draws that each ensemble is worth; the tail's size is lowered in the same proportion.
    """
    k = in_time.shape[-1]
    means = in_time.mean(axis=2)
    series = diagnose(means)[1]
    flat = in_time.reshape(-1, k)
    worth = flat.var(axis=0) / means.reshape(-1, k).var(axis=0)
    honest = np.minimum(series * worth, bulk)
    return honest, tail * honest / bulk, flat.std(axis=0) / np.sqrt(2 * honest)
