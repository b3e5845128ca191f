"""The computations of Kistemaker & Rozendaal (2011), PLoS ONE 6(5): e19568, done again.

KBI is fitted to noise-free responses of the musculoskeletal model: four examples (the paper's
Figures 2 and 7), the error surface about one optimum (Figure 6), and grids of settings (Figures 3
to 5, 8, 9 and the comparison of perturbations).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from identifiability.inference.conditional import conditional_optima
from identifiability.inference.curvature import largest_change
from identifiability.inference.fitting import fit, fit_simplex
from identifiability.inference.problem import Prior, Problem
from identifiability.joint.model import KBI
from identifiability.measurement.perturbations import (
    PERTURBATIONS,
    WINDOWS,
    Impulse,
    Perturbation,
    SampledTorque,
    Sinusoid,
)
from identifiability.provenance import stamp
from identifiability.study.setting import Setting, error_problem
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

K_CE = tuple(np.linspace(10.0, 200.0, 20).tolist())
B_CE = tuple(np.linspace(2.0, 30.0, 15).tolist())
RATIOS = (2.0, 5.0, 10.0)
DE = 1e-3

# The text's grid ends at 30 Nms/rad, the Methods' at 32.
WIDER_B_CE = 32.0

PARAMETERS = ("K", "B", "I")
QUANTITIES = {
    "E": ("1", "smallest error E* (Eq. 3)"),
    "K": ("Nm/rad", "fitted stiffness"),
    "B": ("Nms/rad", "fitted damping"),
    "I": ("kg m2", "fitted inertia"),
    "dK": ("Nm/rad", "change of K that raises E by dE, with dB and dI (Eq. 15)"),
    "dB": ("Nms/rad", "change of B that raises E by dE, with dK and dI (Eq. 15)"),
    "dI": ("kg m2", "change of I that raises E by dE, with dK and dB (Eq. 15)"),
    "reach_K": ("Nm/rad", "largest change of K on the ellipsoid of E* + dE"),
    "reach_B": ("Nms/rad", "largest change of B on the ellipsoid of E* + dE"),
    "reach_I": ("kg m2", "largest change of I on the ellipsoid of E* + dE"),
}


class Panel(NamedTuple):
    """One panel of the paper's Figures 2 and 7."""

    letter: str
    setting: Setting
    perturbation: Perturbation
    window: float


PANELS = (
    Panel("A", Setting(32.0, 3.2, 100.0, 0.1), Impulse(), 0.05),
    Panel("B", Setting(32.0, 3.2, 100.0, 0.1), Sinusoid(), 0.05),
    Panel("C", Setting(32.0, 3.2, 100.0, 0.1), Impulse(), 0.1),
    Panel("D", Setting(32.0, 10.0, 320.0, 0.1), Impulse(), 0.1),
)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Best KBI model for one response, and how far it can move.

    Attributes
    ----------
    values : array, shape (3,)
        K [Nm/rad], B [Nms/rad], I [kg m²].
    E : float
        The error there (Eq. 3).
    change : array, shape (3,)
        Largest simultaneous change of K, B, I that raises E by dE (Eq. 15), dK positive; NaN where
        the Hessian of E is not positive definite.
    reach : array, shape (3,)
        Largest change of each parameter on the ellipsoid where the quadratic has risen by dE;
        unlike Eq. 15 it does not depend on the units the parameters are written in.
    at_bound : tuple of str
        Parameters that lie on a physical bound.
    n_agreeing : int
        Number of the four starts that led there.
    """

    values: np.ndarray
    E: float
    change: np.ndarray
    reach: np.ndarray
    at_bound: tuple[str, ...]
    n_agreeing: int


def paper_optimum(
    setting: Setting, perturbation: Perturbation, window: float, dE: float = DE
) -> Optimum:
    """Fit KBI to one response by its error E, within the physical bounds.

    Parameters
    ----------
    setting : Setting
    perturbation : Perturbation
    window : float
        T [s].
    dE : float
        Rise of E in Eq. 15.

    Returns
    -------
    Optimum
    """
    problem = error_problem(setting, perturbation, window)
    found = fit(problem, setting.starts())
    hessian = 2 * problem.hessian(found.values)
    change = reach = np.full(3, np.nan)
    if np.linalg.eigvalsh(hessian)[0] > 0:
        change = largest_change(hessian, dE)
        reach = np.sqrt(2 * dE * np.diag(np.linalg.inv(hessian)))
    return Optimum(found.values, 2 * found.cost, change, reach, found.at_bound, found.n_agreeing)


@dataclass(frozen=True, eq=False)
class PanelFit:
    """One panel of Figures 2 and 7, computed.

    Attributes
    ----------
    panel : Panel
    optimum : Optimum
    simplex : array, shape (3,)
        K, B, I found by the Nelder-Mead simplex as in MATLAB.
    simplex_E : float
        The error there.
    time : array, shape (n,)
        [s]
    reference : array, shape (n,)
        Angle of the musculoskeletal model [rad].
    fitted : array, shape (n,)
        Angle of KBI at its optimum [rad].
    changed : array, shape (2, n)
        Angle of KBI moved from its optimum by plus and minus the change of Eq. 15 [rad].
    changed_E : array, shape (2,)
        The error of each; Eq. 15 intends E* + dE.
    """

    panel: Panel
    optimum: Optimum
    simplex: np.ndarray
    simplex_E: float
    time: np.ndarray
    reference: np.ndarray
    fitted: np.ndarray
    changed: np.ndarray
    changed_E: np.ndarray


def panel_fit(panel: Panel, dE: float = DE) -> PanelFit:
    """Fit one panel of Figure 2, move it as in Figure 7, and repeat the fit with the simplex.

    The simplex starts from the nominal K, B, I of `KBI` (50 Nm/rad, 1 Nms/rad, 0.1 kg m²), is not
    bounded, and stops by the defaults of MATLAB's ``fminsearch``, 1e-4 on parameters and on E.
    """
    model = KBI()
    problem = error_problem(panel.setting, panel.perturbation, panel.window)
    best = paper_optimum(panel.setting, panel.perturbation, panel.window, dE)
    simplex = fit_simplex(
        problem.with_prior(Prior.unbounded(model)), model.nominal, xatol=1e-4, fatol=0.5e-4
    )
    moved = [best.values + best.change, best.values - best.change]
    measured = problem.observations[0].measured
    return PanelFit(
        panel,
        best,
        simplex.values,
        2 * simplex.cost,
        np.linspace(0.0, panel.window, measured.size),
        measured,
        problem.responses(best.values)[0],
        np.array([problem.responses(x)[0] for x in moved]),
        errors(problem, moved),
    )


def errors(problem: Problem, points: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Error E of each of a batch of points, shape (n, 3)."""
    return -2 * problem.log_likelihood(np.asarray(points))


def smallest_errors(
    problem: Problem, held: tuple[int, ...], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smallest error E with some of K, B, I held, and where it is reached.

    Parameters
    ----------
    problem : Problem
        From `error_problem`.
    held : tuple of int
        Positions of the held parameters.
    points : array, shape (n, 3)
        Held values, and starts for the others.

    Returns
    -------
    E : array, shape (n,)
    points : array, shape (n, 3)
    """
    # The search stops by differences of the log likelihood, so E is counted in millionths.
    observation = problem.observations[0]
    fine = replace(problem, observations=[replace(observation, scale=1e3 * observation.scale)])
    found = conditional_optima(fine, held, points)
    return -2e-6 * found.log_likelihood, found.points


@dataclass(frozen=True, eq=False)
class Valley:
    """Smallest error E for every K, B and I being fitted anew.

    Attributes
    ----------
    K : array, shape (n,)
        [Nm/rad]
    E : array, shape (n,)
        With the physical bounds, hence B not below zero.
    E_unbounded : array, shape (n,)
        With B of any sign.
    B, B_unbounded : array, shape (n,)
        The damping that goes with them [Nms/rad].
    """

    K: np.ndarray
    E: np.ndarray
    E_unbounded: np.ndarray
    B: np.ndarray
    B_unbounded: np.ndarray


def valley(panel: Panel, K: np.ndarray) -> Valley:
    """Profile of the error of one panel over K [Nm/rad], shape (n,), and the optimum's K."""
    problem = error_problem(panel.setting, panel.perturbation, panel.window)
    free = problem.with_prior(Prior.unbounded(problem.model))
    start = paper_optimum(panel.setting, panel.perturbation, panel.window).values
    K = np.union1d(K, start[0])
    points = np.tile(start, (K.size, 1))
    points[:, 0] = K
    E, path = smallest_errors(problem, (0,), points)
    E_unbounded, path_unbounded = smallest_errors(free, (0,), points)
    return Valley(K, E, E_unbounded, path[:, 1], path_unbounded[:, 1])


def timing_slip(panel: Panel, hold: float = 1e-3) -> dict[str, np.ndarray]:
    """Fit of a panel when only one of the two simulations holds the torque between samples.

    Holding a sampled torque delays it by half a sample on average.

    Parameters
    ----------
    panel : Panel
        One with a sinusoid.
    hold : float
        Time for which the torque is held [s].

    Returns
    -------
    dict of str to array, shape (3,)
        K, B, I with the torque held for the musculoskeletal model (``"MSM"``) or for ``"KBI"``,
        with the physical bounds, and without them (``"MSM, unbounded"``, ``"KBI, unbounded"``).
    """
    problem = error_problem(panel.setting, panel.perturbation, panel.window)
    observation = problem.observations[0]
    time = np.linspace(0.0, panel.window, observation.measured.size)
    torque = observation.drive.signals[:, 0]
    last = np.floor(time / hold + 1e-9) * hold
    held = SampledTorque(np.interp(last, time, torque), hold="zero-order").drive(time)
    response = panel.setting.response(held)
    # The scale makes the squares of the response sum to one, as in the denominator of Eq. 3.
    scale = observation.scale / np.linalg.norm(observation.scale * response)
    slips = {
        "MSM": replace(observation, measured=response, scale=scale),
        "KBI": replace(observation, drive=held),
    }
    fits = {}
    for name, slipped in slips.items():
        for suffix, prior in (("", problem.prior), (", unbounded", Prior.unbounded(problem.model))):
            slip = Problem(problem.model, [slipped], prior)
            fits[name + suffix] = fit(slip, panel.setting.starts()).values
    return fits


@dataclass(frozen=True, eq=False)
class Surface:
    """Error E about one optimum, over K and B (Figure 6).

    Attributes
    ----------
    setting : Setting
    window : float
        T [s].
    optimum : Optimum
    hessian : array, shape (3, 3)
        Of E.
    K, B : array, shapes (n,), (m,)
    held : array, shape (m, n)
        E with I at its optimum, as in the paper.
    refitted : array, shape (m, n)
        E with I fitted anew at every point.
    """

    setting: Setting
    window: float
    optimum: Optimum
    hessian: np.ndarray
    K: np.ndarray
    B: np.ndarray
    held: np.ndarray
    refitted: np.ndarray


def surface(setting: Setting, window: float, dE: float = DE, n: int = 41) -> Surface:
    """Error surface about the optimum of an impulse response, wide enough for E* + dE."""
    problem = error_problem(setting, Impulse(), window)
    best = paper_optimum(setting, Impulse(), window, dE)
    hessian = 2 * problem.hessian(best.values)
    K, B = (
        np.linspace(
            max(best.values[i] - 1.5 * best.reach[i], 0.0), best.values[i] + 1.5 * best.reach[i], n
        )
        for i in range(2)
    )
    mesh = np.stack(np.meshgrid(K, B), axis=-1).reshape(-1, 2)
    points = np.column_stack([mesh, np.full(len(mesh), best.values[2])])
    refitted, _ = smallest_errors(problem, (0, 1), points)
    return Surface(
        setting,
        window,
        best,
        hessian,
        K,
        B,
        errors(problem, points).reshape(n, n),
        refitted.reshape(n, n),
    )


class Row(NamedTuple):
    """Cells of the grid that differ in B_CE alone: what a worker computes at a time."""

    perturbation: str
    ratio: float
    window: float
    K_CE: float
    B_CE: tuple[float, ...]
    dE: float


def compute_row(row: Row) -> Arrays:
    """Fit the cells of a row.

    Returns
    -------
    dict
        ``"cells"``, shape (n_cells, 12): the values of `QUANTITIES`, the bounds met (1
        for K, 2 for B, 4 for I, added), and the number of starts that agree.
    """
    out = np.empty((len(row.B_CE), len(QUANTITIES) + 2))
    for i, damping in enumerate(row.B_CE):
        setting = Setting(row.K_CE, damping, row.ratio * row.K_CE)
        best = paper_optimum(setting, PERTURBATIONS[row.perturbation](), row.window, row.dE)
        bounds = sum(1 << PARAMETERS.index(name) for name in best.at_bound)
        out[i] = [best.E, *best.values, *best.change, *best.reach, bounds, best.n_agreeing]
    return {"cells": out}


def coarse() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """K_CE and B_CE of the quick grid: every fourth and every third of the full one."""
    return K_CE[::4], B_CE[::3]


def rows(
    K: Sequence[float], B: Sequence[float], ratios: Sequence[float], dE: float = DE
) -> list[Row]:
    """Rows of the study: an impulse for every ratio, the other perturbations for K_SE = 5 K_CE."""
    return [
        Row(key, ratio, window, stiffness, tuple(B), dE)
        for key in PERTURBATIONS
        for ratio in ratios
        if key == "impulse" or ratio == 5.0
        for window in WINDOWS
        for stiffness in K
    ]


def compute_rows(
    tasks: Sequence[Row],
    *,
    folder: Path | None,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
) -> tuple[dict[Row, np.ndarray], list[Outcome]]:
    """Compute rows in worker processes.

    Parameters
    ----------
    tasks : sequence of Row
    folder : Path or None
        Where finished rows are kept, so that an interrupted run can go on; see `sweep`.
    workers, executor
        See `sweep`.

    Returns
    -------
    rows : dict of Row to array
        From `compute_row`; the same whatever the number of workers.
    failed : list of Outcome
        Rows without a result, and why.
    """
    named = {
        f"{t.perturbation}, K_SE = {t.ratio:g} K_CE, T = {t.window:g} s, K_CE = {t.K_CE:g}, "
        f"B_CE from {t.B_CE[0]:g}": t
        for t in tasks
    }
    outcomes = sweep(
        compute_row,
        named,
        folder=folder,
        label="rows of fits",
        workers=workers,
        executor=executor,
    )
    done = {named[o.name]: o.arrays["cells"] for o in outcomes.values() if o.arrays is not None}
    return done, [o for o in outcomes.values() if o.arrays is None]


def to_dataset(
    results: Mapping[Row, np.ndarray],
    K: Sequence[float],
    B: Sequence[float],
    ratios: Sequence[float],
    dE: float = DE,
) -> xr.Dataset:
    """Arrange rows as a labelled grid.

    Returns
    -------
    Dataset
        Over perturbation, ratio (K_SE / K_CE), T, K_CE, B_CE; NaN where nothing was computed.
    """
    axes: dict[str, list[Any]] = {
        "perturbation": list(PERTURBATIONS),
        "ratio": list(ratios),
        "T": list(WINDOWS),
        "K_CE": list(K),
        "B_CE": list(B),
    }
    shape = [len(values) for values in axes.values()]
    cells = np.full([*shape, len(QUANTITIES) + 2], np.nan)
    for row, values in results.items():
        at = (
            axes["perturbation"].index(row.perturbation),
            axes["ratio"].index(row.ratio),
            axes["T"].index(row.window),
            axes["K_CE"].index(row.K_CE),
        )
        cells[at] = values
    variables: dict[str, Any] = {
        name: (tuple(axes), cells[..., i], {"units": unit, "long_name": text})
        for i, (name, (unit, text)) in enumerate(QUANTITIES.items())
    }
    counts = np.where(np.isnan(cells[..., -2:]), -1, cells[..., -2:]).astype(np.int8)
    flags = {
        "long_name": "parameters whose optimum lies on a physical bound, -1: not computed",
        "flag_masks": np.array([1, 2, 4], np.int8),
        "flag_meanings": " ".join(PARAMETERS),
    }
    variables["at_bound"] = (tuple(axes), counts[..., 0], flags)
    agreeing = {"units": "1", "long_name": "starts (of 4) that reach E*, -1: not computed"}
    variables["n_agreeing"] = (tuple(axes), counts[..., 1], agreeing)
    data = xr.Dataset(
        variables,
        axes,
        {
            "title": "KBI fitted to the musculoskeletal model of Kistemaker & Rozendaal (2011)",
            "references": "doi:10.1371/journal.pone.0019568",
            **stamp(__name__),
            "dE": dE,
            "I_MSM": 0.1,
        },
    )
    labels = {
        "ratio": ("1", "K_SE / K_CE"),
        "T": ("s", "window over which the responses are compared"),
        "K_CE": ("Nm/rad", "stiffness of the contractile element"),
        "B_CE": ("Nms/rad", "damping of the contractile element"),
    }
    for name, (unit, text) in labels.items():
        data[name].attrs.update(units=unit, long_name=text)
    return data
