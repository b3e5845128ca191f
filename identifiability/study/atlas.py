"""Where the quadratic widths hold: the widths of every cell of a grid of joints and measurements.

A cell is one musculoskeletal model, one perturbation, one duration and one reading of the noise.
It depends on nothing but its own coordinates, its random numbers neither, so that cells may be
added to a grid, computed in any order and taken up again after an interruption.
"""

from __future__ import annotations

import itertools
import math
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.curvature import curvature, largest_change
from identifiability.inference.problem import Problem
from identifiability.inference.sampling import sample
from identifiability.inference.widths import Widths, widths
from identifiability.measurement.noise import READINGS
from identifiability.measurement.perturbations import PERTURBATIONS, WINDOWS
from identifiability.provenance import fingerprint
from identifiability.study import paper
from identifiability.study.setting import Setting, measured_problem
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

N_DRAWS = 250
ENOUGH = 1_000.0  # effective draws of a cell's posterior
LONGEST = 10.0  # [s]; beyond it a duration is likely to be in milliseconds
TIME_LIMIT = 900.0  # for one cell [s]; it takes about one, but compiles for each new array shape


@dataclass(frozen=True)
class Cell:
    """One fit, and everything that decides its result.

    Attributes
    ----------
    K_CE, B_CE : float
        Of the contractile element [Nm/rad, Nms/rad].
    ratio : float
        K_SE / K_CE.
    T : float
        Duration that is fitted [s].
    perturbation : str
        Key in `PERTURBATIONS`.
    reading : {"contour", "energy"}
        See `matched_noise`.
    I : float
        Inertia [kg m²].
    dE, rate, correlation_time : float
        See `measured_problem`.
    seed : int
        The atlas's, of which each cell makes its own.
    """

    K_CE: float
    B_CE: float
    ratio: float
    T: float
    perturbation: str
    reading: str
    I: float = 0.1
    dE: float = 1e-3
    rate: float = 1000.0
    correlation_time: float = 0.0
    seed: int = 1

    @property
    def name(self) -> str:
        """The coordinates as text."""
        return (
            f"K_CE={self.K_CE:.12g} B_CE={self.B_CE:.12g} K_SE/K_CE={self.ratio:.12g} "
            f"T={self.T:.12g} {self.perturbation} {self.reading}"
        )

    @property
    def setting(self) -> Setting:
        """The musculoskeletal model."""
        return Setting(self.K_CE, self.B_CE, self.ratio * self.K_CE, self.I)

    @property
    def own_seed(self) -> int:
        """Seed of this cell's random numbers, from the atlas's seed and the coordinates."""
        words = int(fingerprint(replace(self, seed=0)), 16)
        return int(np.random.SeedSequence([self.seed, words]).generate_state(1)[0])

    def problem(self, *, draw: int | None = None) -> Problem:
        """Set up the fit of KBI that the cell is about, with a draw of the noise in it or none."""
        return measured_problem(
            self.setting,
            PERTURBATIONS[self.perturbation](),
            self.T,
            reading=self.reading,  # type: ignore[arg-type]
            dE=self.dE,
            correlation_time=self.correlation_time,
            rate=self.rate,
            seed=draw,
        )

    def widths(self, problem: Problem) -> Widths:
        """All widths of those of K, B and I that are free; `problem` is the cell's own."""
        return widths(
            problem,
            starts=self.setting.starts()[:, list(problem.free)],
            seed=self.own_seed,
            sampler=partial(sample, enough=ENOUGH),
        )


class Drawn(NamedTuple):
    """A musculoskeletal model whose posterior is drawn; units as in `Setting`."""

    K_CE: float
    B_CE: float
    K_SE: float
    I: float


@dataclass(frozen=True)
class Corner:
    """A cell whose posterior is drawn; it need not lie on the grid."""

    cell: Cell

    @property
    def stem(self) -> str:
        """Name of the figure's file, without suffix."""
        s = self.cell.setting
        return f"corner_{s.K_CE:g}_{s.B_CE:g}_{s.K_SE:g}_{s.I:g}_{1000 * self.cell.T:g}ms"

    @property
    def caption(self) -> str:
        """What is drawn."""
        s, cell = self.cell.setting, self.cell
        return (
            f"K_CE {s.K_CE:g}, B_CE {s.B_CE:g}, K_SE {s.K_SE:g}, I {s.I:g}, "
            f"{cell.perturbation.replace('_', ' ')}, T = {1000 * cell.T:g} ms, {cell.reading}"
        )


@dataclass(frozen=True)
class Plan:
    """The grid, and how it is measured.

    Attributes
    ----------
    K_CE, B_CE, ratio, T : tuple of float
        Axes of the grid, ascending.
    perturbations, readings : tuple of str
    corner : tuple of Drawn
        Models whose corner plots are drawn, for each T, after the first perturbation and under the
        first reading.
    seed : int
    draws : bool
        Whether thinned draws of every posterior are stored.
    dE, rate, correlation_time : float
        See `measured_problem`.
    """

    K_CE: tuple[float, ...] = (10.0, 30.0, 60.0, 100.0, 200.0)
    B_CE: tuple[float, ...] = (2.0, 8.0, 30.0)
    ratio: tuple[float, ...] = (2.0, 10.0)
    T: tuple[float, ...] = WINDOWS
    perturbations: tuple[str, ...] = ("impulse", "sinusoid")
    readings: tuple[str, ...] = READINGS
    corner: tuple[Drawn, ...] = field(
        default=(Drawn(32.0, 3.2, 100.0, 0.1), Drawn(32.0, 10.0, 320.0, 0.1))
    )
    seed: int = 1
    draws: bool = True
    dE: float = 1e-3
    rate: float = 1000.0
    correlation_time: float = 0.0

    def __post_init__(self) -> None:
        for key, duration in itertools.product(self.perturbations, self.T):
            intervals = round(duration * self.rate)
            if intervals < 3 or abs(intervals - duration * self.rate) > 1e-6:
                raise InputError(
                    f"found T = {duration:g} s at rate = {self.rate:g} Hz, expected at least three "
                    "whole sampling intervals"
                )
            # A pulse whose edge lies between samples is found out now, not in every cell.
            PERTURBATIONS[key]().drive(np.linspace(0, duration, intervals + 1))

    @property
    def axes(self) -> dict[str, tuple[Any, ...]]:
        """Axes of the grid, by the names they have in the stored atlas."""
        return {
            "K_CE": self.K_CE,
            "B_CE": self.B_CE,
            "ratio": self.ratio,
            "T": self.T,
            "perturbation": self.perturbations,
            "reading": self.readings,
        }

    def cells(self) -> dict[str, Cell]:
        """All cells by name, those with arrays of one shape in a row."""
        found = {}
        for duration, perturbation in itertools.product(self.T, self.perturbations):
            for reading, ratio, K_CE, B_CE in itertools.product(
                self.readings, self.ratio, self.K_CE, self.B_CE
            ):
                cell = self._cell(K_CE, B_CE, ratio, duration, perturbation, reading)
                found[cell.name] = cell
        return found

    def corners(self) -> Iterator[Corner]:
        """All cells whose posterior is drawn."""
        first = self.perturbations[0], self.readings[0]
        for T, (K_CE, B_CE, K_SE, inertia) in itertools.product(self.T, self.corner):
            yield Corner(self._cell(K_CE, B_CE, K_SE / K_CE, T, *first, inertia))

    def _cell(
        self,
        K_CE: float,
        B_CE: float,
        ratio: float,
        T: float,
        perturbation: str,
        reading: str,
        I: float = 0.1,
    ) -> Cell:
        return Cell(
            K_CE,
            B_CE,
            ratio,
            T,
            perturbation,
            reading,
            I,
            dE=self.dE,
            rate=self.rate,
            correlation_time=self.correlation_time,
            seed=self.seed,
        )


# The whole of the paper: 300 models of the muscle, three tendons, three durations, five torques.
PAPER = {
    "K_CE": list(paper.K_CE),
    "B_CE": list(paper.B_CE),
    "ratio": list(paper.RATIOS),
    "T": list(WINDOWS),
    "perturbations": list(PERTURBATIONS),
    "readings": list(READINGS),
    "draws": False,
}


def read_plan(path: Path | None) -> Plan:
    """Read a plan from a TOML file; without one, a grid that spans the paper's.

    The path ``paper``, where there is no such file, stands for the paper's whole grid.

    Raises
    ------
    InputError
        Where the file cannot be read, or holds what a plan cannot be made of.
    """
    if path is None:
        return Plan()
    if str(path) == "paper" and not Path(path).exists():
        return plan_from({"grid": "paper"})
    try:
        content = Path(path).read_bytes().decode()
    except OSError as error:
        raise InputError(
            f"cannot read '{path}' ({error.strerror}); give the path of a TOML file"
        ) from None
    except UnicodeDecodeError:
        raise InputError(f"'{path}' is no text; expected a TOML file in UTF-8") from None
    try:
        return plan_from(tomllib.loads(content))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"'{path}' is not valid TOML ({error}); mend that place") from None
    except InputError as error:
        raise InputError(f"in '{path}': {error}") from None


def plan_from(config: Mapping[str, Any]) -> Plan:
    """Make a plan from a configuration.

    Parameters
    ----------
    config : mapping
        Attributes of `Plan`, and ``grid = "paper"`` for the paper's whole grid, of which the
        attributes given replace their part.

    Raises
    ------
    InputError
        Where a key is unknown or a value is not what its key needs.
    """
    known = [f.name for f in fields(Plan)] + ["grid"]
    for key in config:
        if key not in known:
            raise InputError(f"found the unknown key '{key}', expected some of {known}")
    grid = config.get("grid", "default")
    if grid not in ("default", "paper"):
        raise InputError(f'found grid = {grid!r}, expected "paper" or "default"')
    merged = {**(PAPER if grid == "paper" else {}), **config}
    merged.pop("grid", None)
    return Plan(**{key: _CHECKS[key](key, value) for key, value in merged.items()})


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _positive_list(key: str, value: Any) -> tuple[float, ...]:
    good = isinstance(value, list) and value and all(_is_number(v) and v > 0 for v in value)
    if not good or len(set(value)) < len(value):
        raise InputError(
            f"found {key} = {value!r}, expected a list of different numbers above 0, such as "
            f"{key} = {list(getattr(Plan, key))}"
        )
    return tuple(sorted(float(v) for v in value))


def _durations(key: str, value: Any) -> tuple[float, ...]:
    durations = _positive_list(key, value)
    if durations[-1] > LONGEST:
        raise InputError(f"found {key} = {value!r}, expected seconds, {LONGEST:g} at most")
    return durations


def _choices(options: tuple[str, ...]) -> Callable[[str, Any], tuple[str, ...]]:
    def check(key: str, value: Any) -> tuple[str, ...]:
        good = isinstance(value, list) and value and all(v in options for v in value)
        if not good or len(set(value)) < len(value):
            raise InputError(
                f"found {key} = {value!r}, expected a list of some of {list(options)}, each once"
            )
        return tuple(value)

    return check


def _models(key: str, value: Any) -> tuple[Drawn, ...]:
    def is_model(row: Any) -> bool:
        return isinstance(row, list) and len(row) == 4 and all(_is_number(v) and v > 0 for v in row)

    if not isinstance(value, list) or not all(is_model(row) for row in value):
        raise InputError(
            f"found {key} = {value!r}, expected rows of K_CE, B_CE, K_SE and I, numbers above 0, "
            f"such as {key} = [[32, 3.2, 100, 0.1]]"
        )
    return tuple(Drawn(*map(float, row)) for row in value)


def _flag(key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"found {key} = {value!r}, expected true or false")
    return value


def _seed(key: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InputError(f"found {key} = {value!r}, expected a whole number, 0 or above")
    return value


def _positive(key: str, value: Any) -> float:
    if not _is_number(value) or value <= 0:
        raise InputError(f"found {key} = {value!r}, expected a number above 0")
    return float(value)


def _not_negative(key: str, value: Any) -> float:
    if not _is_number(value) or value < 0:
        raise InputError(f"found {key} = {value!r}, expected a number, 0 or above")
    return float(value)


_CHECKS: dict[str, Callable[[str, Any], Any]] = {
    "K_CE": _positive_list,
    "B_CE": _positive_list,
    "ratio": _positive_list,
    "T": _durations,
    "perturbations": _choices(tuple(PERTURBATIONS)),
    "readings": _choices(READINGS),
    "corner": _models,
    "seed": _seed,
    "draws": _flag,
    "dE": _positive,
    "rate": _positive,
    "correlation_time": _not_negative,
}


def evaluate(cell: Cell) -> Arrays:
    """All widths of a cell as plain arrays; `store.FIELDS` says what each is."""
    start = time.process_time()
    problem = cell.problem()
    found = cell.widths(problem)
    measured = problem.observations[0].measured
    misfit = problem.responses(found.fit.values)[0] - measured
    rows, sampler = found.rows, found.posterior
    numbers = (
        "optimum",
        "slice",
        "quadratic",
        "gauss_newton",
        "sandwich",
        "profile",
        "profile_68",
        "profile_95",
        "posterior_mean",
        "posterior_sd",
        "posterior_sd_mcse",
        "posterior_68",
        "posterior_95",
        "quadrature_mean",
        "quadrature_sd",
        "rhat",
        "ess_bulk",
        "ess_tail",
    )
    draws = sampler.flat
    thinned = np.linspace(0, len(draws) - 1, N_DRAWS).round().astype(int)
    arrays = {name: np.array([getattr(row, name) for row in rows]) for name in numbers}
    arrays |= {
        # The criterion of the paper (Eq. 3) at the samples, whatever the noise is taken to be.
        "E": np.sum(misfit**2) / np.sum(measured**2),
        "change": _largest_change(cell, problem, found),
        "at_bound": np.array([row.name in found.fit.at_bound for row in rows]),
        "profile_end": np.array([row.profile_sides for row in rows]),
        "parameter_verdict": np.array([row.verdict for row in rows]),
        "parameter_reason": np.array([row.reason for row in rows]),
        "verdict": np.array(found.verdict),
        "reason": np.array(found.reason),
        "step": np.array(sampler.step),
        "step_reason": np.array(sampler.reason),
        "acceptance": np.array(sampler.acceptance),
        "draws": draws[thinned].astype(np.float32),
        "seconds": np.array(time.process_time() - start),
    }
    return arrays


def _largest_change(cell: Cell, problem: Problem, found: Widths) -> np.ndarray:
    """The paper's estimate (Eq. 15), of E, in which no sample weighs more than another."""
    hessian = found.curvature.hessian
    if cell.correlation_time:
        problem = replace(cell, correlation_time=0.0).problem()
        hessian = curvature(problem, found.fit.values).hessian
    (observation,) = problem.observations
    energy = np.sum((observation.scale * observation.measured) ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.abs(largest_change(2 * hessian / energy, cell.dE))


def run_atlas(
    plan: Plan,
    folder: Path,
    *,
    workers: int | None = None,
    executor: Callable[[], Executor] | None = None,
    progress: bool = True,
    retry_failed: bool = True,
) -> dict[str, Outcome]:
    """Compute the cells of an atlas that are not in its folder yet.

    Parameters
    ----------
    plan : Plan
    folder : Path
        For finished cells.
    workers, executor, progress, retry_failed
        See `sweep`.

    Returns
    -------
    dict of str to Outcome
        By the names of the cells.
    """
    return sweep(
        evaluate,
        plan.cells(),
        folder=folder,
        label="atlas",
        workers=workers,
        executor=executor,
        timeout_s=None if executor else TIME_LIMIT,
        progress=progress,
        retry_failed=retry_failed,
    )
