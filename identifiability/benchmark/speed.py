"""Effective draws a CPU second, of this package's sampler and of others; and what a cell costs.

In one process, one after another, for musculoskeletal models that span the paper's grid. All
evaluate the same likelihood: its machine code, for as many points at once as they ask for, and
NumPyro the same equations by JAX.
"""

from __future__ import annotations

import itertools
import json
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.benchmark.peers import NUTS_NAME, PEERS, Drawn, Nuts, installed, own
from identifiability.inference.curvature import curvature
from identifiability.inference.fitting import fit
from identifiability.inference.problem import Problem
from identifiability.inference.profiles import profile
from identifiability.inference.quadrature import quadrature
from identifiability.inference.sampling import sample
from identifiability.measurement.noise import READINGS
from identifiability.measurement.perturbations import PERTURBATIONS, WINDOWS
from identifiability.provenance import stamp
from identifiability.study import paper
from identifiability.study.atlas import ENOUGH, Cell, Plan, evaluate
from identifiability.sweep.outcome import Arrays, Outcome
from identifiability.sweep.run import sweep

OWN = "this package"
BASE = "emcee, stretch move"
"""What the others are compared with."""

_STIFFNESSES, _DAMPINGS = (10.0, 60.0, 200.0), (2.0, 8.0, 30.0)
_BATCH, _CALLS = 512, 20
_FINE = 2.0  # times the nodes of the quadrature that widths are judged by
_REPEATS = 3  # of which the quickest counts
FEW, _MANY = 50, 200
"""Cells by which it is told what one more takes."""


@dataclass(frozen=True)
class Timed:
    """One sampler on one posterior.

    Attributes
    ----------
    ess : float
        Effective draws, of the parameter that has fewest.
    seconds : float
        Of a processor; nothing was compiled in them.
    apart : float
        Largest difference of a standard deviation from the quadrature's, over its Monte Carlo
        error.
    off : float
        The same difference over the standard deviation itself.
    converged : bool
    """

    ess: float
    seconds: float
    apart: float
    off: float
    converged: bool

    @property
    def rate(self) -> float:
        """Effective draws a second."""
        return self.ess / self.seconds


@dataclass(frozen=True)
class Row:
    """One setting.

    Attributes
    ----------
    name : str
        Of the cell.
    samplers : dict of str to Timed
    stages : dict of str to float
        Seconds of a processor for each part of the cell, and for the ``whole`` as the atlas
        computes it.
    bare : float
        Seconds of a processor for one likelihood, of a batch.
    own_evaluations : int
        Likelihoods that this package's sampler asked for.
    """

    name: str
    samplers: Mapping[str, Timed]
    stages: Mapping[str, float]
    bare: float
    own_evaluations: int

    def times(self, name: str) -> float:
        """Effective draws a second of this package's sampler, over another's."""
        return self.samplers[OWN].rate / self.samplers[name].rate


@dataclass(frozen=True)
class Scaling:
    """The atlas's command on few cells and on many, by one worker and by two.

    Attributes
    ----------
    few, many : int
        Numbers of cells.
    few_by_one, many_by_one, many_by_two : float
        Seconds from when it begins until it is done, workers started.
    memory : float
        Most that a worker took [MiB].
    """

    few: int
    many: int
    few_by_one: float
    many_by_one: float
    many_by_two: float
    memory: float

    @property
    def each(self) -> float:
        """Seconds that one cell more takes one worker."""
        return (self.many_by_one - self.few_by_one) / (self.many - self.few)

    @property
    def start(self) -> float:
        """Seconds that pass without any cell."""
        return self.few_by_one - self.few * self.each

    @property
    def by_two(self) -> float:
        """How many times as many cells two workers do as one, once they have started."""
        return (self.many_by_one - self.start) / (self.many_by_two - self.start)


def scaling(some: Sequence[Cell], few: int) -> Scaling:
    """Compute cells by one worker and by two.

    Parameters
    ----------
    some : sequence of Cell
    few : int
        How many of them are few.
    """

    def seconds(n: int, workers: int) -> float:
        began = time.perf_counter()
        tasks = {cell.name: cell for cell in some[:n]}
        sweep(evaluate, tasks, folder=None, label="scaling", workers=workers)
        return time.perf_counter() - began

    seconds(2, 1)  # what is compiled is kept
    by_one = seconds(few, 1), seconds(len(some), 1)
    by_two = seconds(len(some), 2)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return Scaling(few, len(some), *by_one, by_two, memory)


def many(seed: int) -> list[Cell]:
    """Cells of every kind, in no order, as many as there are for `scaling`."""
    plan = Plan(perturbations=tuple(PERTURBATIONS), readings=READINGS[:1], seed=seed)
    every = list(plan.cells().values())
    order = np.random.default_rng(seed).permutation(len(every))
    return [every[i] for i in order[:_MANY]]


def cells(seed: int) -> list[Cell]:
    """27 cells: three stiffnesses, three dampings, three durations; all else takes turns."""
    found = []
    ways = list(PERTURBATIONS)
    for i, j, k in itertools.product(range(3), repeat=3):
        found.append(
            Cell(
                _STIFFNESSES[i],
                _DAMPINGS[j],
                paper.RATIOS[(i + j + k) % 3],
                WINDOWS[k],
                ways[(i + 2 * j + 3 * k) % len(ways)],
                READINGS[(i + j + k) % 2],
                seed=seed,
            )
        )
    return found


def measure(
    some: Sequence[Cell], *, folder: Any = None, progress: bool = True
) -> tuple[list[Row], list[Outcome]]:
    """Time every sampler on every cell, one after another in this process.

    Parameters
    ----------
    some : sequence of Cell
    folder, progress
        See `sweep`.
    """
    outcomes = sweep(
        _timed,
        {cell.name: (cell, _libraries(i)) for i, cell in enumerate(some)},
        folder=folder,
        label="speed",
        workers=1,
        executor=lambda: ThreadPoolExecutor(1),
        progress=progress,
    )
    found = [o.arrays for o in outcomes.values() if o.arrays is not None]
    return [row_from(json.loads(str(a["row"]))) for a in found], list(outcomes.values())


def _libraries(i: int) -> dict[str, str]:
    """Samplers beside ours on one of the cells: one that is compiled for each, on three of them."""
    return {name: v for name, v in installed().items() if name != NUTS_NAME or i % 13 == 0}


def _timed(task: tuple[Cell, Mapping[str, str]]) -> Arrays:
    """One cell, as a sweep keeps it: JSON in an array of one text."""
    cell, libraries = task
    with threadpool_limits(1):
        return {"row": np.array(json.dumps(asdict(measured(cell, libraries))))}


def row_from(plain: Mapping[str, Any]) -> Row:
    """Row from its plain record."""
    samplers = {name: Timed(**one) for name, one in plain["samplers"].items()}
    return Row(**{**plain, "samplers": samplers})


def measured(cell: Cell, libraries: Mapping[str, str]) -> Row:
    """Time every sampler on one cell's posterior, and the parts of the cell.

    Parameters
    ----------
    cell : Cell
    libraries : mapping of str to str
        The samplers beside ours, by their names in `PEERS`.
    """
    problem = cell.problem()
    best = fit(problem, cell.setting.starts())
    optimum, seed = best.values, cell.own_seed
    fine = quadrature(problem, optimum, local_optima=best.reached, refinement=_FINE)

    def timed(ask: Callable[[], Drawn]) -> Timed:
        began = time.process_time()
        found = ask()
        seconds = time.process_time() - began
        differ = found.sd - fine.sd
        return Timed(
            float(found.ess.min()),
            seconds,
            float(np.max(np.abs(differ / found.sd_mcse))),
            float(np.max(np.abs(differ / fine.sd))),
            found.converged,
        )

    counted = _Counted(problem)
    own(counted, optimum, seed)  # type: ignore[arg-type]
    samplers = {OWN: timed(partial(own, problem, optimum, seed))}
    for name, (_, ask) in PEERS.items():
        if name in libraries:
            samplers[name] = timed(partial(ask, problem, optimum, seed))
    if NUTS_NAME in libraries:
        samplers[NUTS_NAME] = timed(Nuts(problem, optimum, seed))
    return Row(cell.name, samplers, _stages(cell), _bare(problem, fine.mean), counted.points)


def _stages(cell: Cell) -> dict[str, float]:
    """Seconds of a processor for each part of a cell, and for the whole of it."""
    problem, starts, seed = cell.problem(), cell.setting.starts(), cell.own_seed
    best = fit(problem, starts)

    def profiles() -> None:
        shape = curvature(problem, best.values)
        for name in problem.names:
            profile(problem, best.values, name, shape=shape)

    def integral() -> None:
        quadrature(problem, best.values, local_optima=best.reached)

    def draws() -> None:
        sample(problem, best.values, seed=seed, local_optima=best.reached, enough=ENOUGH)

    return {
        "simulation": _quickest(cell.problem),
        "fit": _quickest(lambda: fit(problem, starts)),
        "Hessian and profiles": _quickest(profiles),
        "posterior": _quickest(draws),
        "quadrature": _quickest(integral),
        "whole": _quickest(lambda: evaluate(cell)),
    }


def _quickest(ask: Callable[[], Any]) -> float:
    took = []
    for _ in range(_REPEATS):
        began = time.process_time()
        ask()
        took.append(time.process_time() - began)
    return min(took)


def _bare(problem: Problem, at: np.ndarray) -> float:
    """Seconds of a processor for one likelihood, of many at once."""
    points = np.tile(at, (_BATCH, 1))
    problem.log_likelihood(points)
    began = time.process_time()
    for _ in range(_CALLS):
        problem.log_likelihood(points)
    return (time.process_time() - began) / (_CALLS * _BATCH)


class _Counted:
    """A problem that counts the points whose likelihood it was asked for."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self.points = problem, 0

    def log_posterior(self, points: np.ndarray) -> np.ndarray:
        self.points += len(np.atleast_2d(points))
        return self._problem.log_posterior(points)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._problem, name)


def record(rows: Sequence[Row], scaled: Scaling, *, seed: int) -> dict[str, Any]:
    """Plain record, for JSON."""
    return {
        "schema": 1,
        **stamp(__name__),
        "seed": seed,
        "enough": ENOUGH,
        "libraries": installed(),
        "scaling": asdict(scaled),
        "rows": [asdict(row) for row in rows],
    }
