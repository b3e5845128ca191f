"""Delays are profiled: the others of a model are fitted at delays over their whole range.

The cost is wavy along a delay, as what is delayed falls into step with the motion or out of it,
with ripples from sample to sample; least squares from a few starts ends in the wave and the ripple
where it began.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from identifiability.inference.conditional import one_by_one
from identifiability.inference.fitting import Fit, explore
from identifiability.inference.problem import Problem
from identifiability.joint.programs import THREADS

_POINTS = 12  # 20 % apart for a reflex
_NEAR = np.array([0.5, 1.0, 1.5, 2.0])  # samples from the best
_POLISHED = 2
_GLANCE, _HOPEFUL = 10, 10.0  # evaluations, after which a top this much worse [nats] is given up


def delays_profiled(problem: Problem, best: Fit, *, evaluations: int) -> Fit:
    """Fit taken up from the best places of each delay's profile.

    Parameters
    ----------
    problem : Problem
    best : Fit
    evaluations : int
        Most evaluations from each of these places.

    Returns
    -------
    Fit
        The better of what was given and what was found; its `costs` and `reached` have both, and
        `n_agreeing` says how many of the given starts had reached it.
    """
    given = best.costs
    for index, name in enumerate(problem.names):
        if problem.model.parameters[name].is_delay:
            best = _profiled(problem, best, index, evaluations)
    agreeing = int(np.sum(given <= best.cost * (1 + 1e-3) + 1e-14))
    return replace(best, n_agreeing=agreeing)


def _profiled(problem: Problem, best: Fit, index: int, evaluations: int) -> Fit:
    lower, upper = problem.lower[index], problem.upper[index]
    space = np.geomspace if lower > 0 else np.linspace
    best = _taken_up(problem, best, index, space(lower, upper, _POINTS), evaluations)
    # Then about the best: from sample to sample the cost has ripples too.
    here = best.values[index]
    near = here + problem.observations[0].drive.interval * np.concatenate([-_NEAR[::-1], _NEAR])
    return _taken_up(problem, best, index, np.clip(near, lower, upper), evaluations)


def _along(
    problem: Problem, point: np.ndarray, index: int, delays: np.ndarray
) -> list[tuple[np.ndarray, float]]:
    """The others' best values at one delay after the other, and the log likelihood there."""
    found = []
    for value in delays:
        start = point.copy()
        start[index] = value
        try:
            solved = one_by_one(problem, (index,), start[None])
        except (ValueError, np.linalg.LinAlgError):  # no finite response at this delay
            break
        point = solved.points[0]
        found.append((point, float(solved.log_likelihood[0])))
    return found


def _taken_up(problem: Problem, best: Fit, index: int, grid: np.ndarray, evaluations: int) -> Fit:
    """The fit, or a better one from the best places of the profile over a grid."""
    here = best.values[index]
    points, heights = [best.values], [-best.cost]
    with ThreadPoolExecutor(THREADS) as pool:
        sides = (grid[grid > here], grid[grid < here][::-1])
        for side in pool.map(lambda one: _along(problem, best.values, index, one), sides):
            points += [point for point, _ in side]
            heights += [height for _, height in side]
    order = np.argsort([point[index] for point in points])
    height = np.array(heights)[order]
    height = np.where(np.isfinite(height), height, -np.inf)
    beside = np.concatenate([[-np.inf], height, [-np.inf]])
    tops = np.flatnonzero((height >= beside[:-2]) & (height >= beside[2:]) & np.isfinite(height))
    # The fit itself, first of the points, has been carried to its end.
    others = [i for i in tops[np.argsort(-height[tops])] if order[i] != 0][:_POLISHED]
    if not others:
        return best
    starts = np.array([points[order[i]] for i in others])
    found = explore(problem, starts, evaluations=_GLANCE)
    costs = np.concatenate([best.costs, found.costs])
    reached = np.concatenate([best.reached, found.reached])
    nats = 0.5 * problem.n_samples * (found.costs / best.cost - 1)  # with the noise as it is left
    hopeful = found.reached[nats < _HOPEFUL]
    if hopeful.size:
        found = explore(problem, hopeful, evaluations=evaluations, further=evaluations)
        costs = np.concatenate([costs, found.costs])
        reached = np.concatenate([reached, found.reached])
    better = found if found.cost < best.cost else best
    return replace(better, costs=costs, reached=reached)
