"""A model and the noise of its recordings, estimated in turn until neither moves the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from identifiability.inference.curvature import curvature
from identifiability.inference.fitting import Fit, explore, fit
from identifiability.inference.likelihood.carried import by_admittance, by_impedance
from identifiability.inference.likelihood.coloured import Colour, excess_of
from identifiability.inference.likelihood.estimate import (
    Contender,
    NoiseEstimate,
    Stretch,
    contenders,
    estimate_noise,
)
from identifiability.inference.likelihood.processes import Process
from identifiability.inference.problem import Problem

_ROUNDS, _CHOICES = 20, 3
_AHEAD, _LEAP = 30.0, 100.0  # rounds that one may stand for, widths that it may go
_SETTLED = 0.1  # standard deviations that a round may still move a parameter
_EVALUATIONS = 60  # of a model with effects, in each round


@dataclass(frozen=True, eq=False)
class NoisyFit:
    """A model fitted together with its noise.

    Attributes
    ----------
    problem : Problem
        With the noise in its likelihood.
    fit : Fit
    noises : tuple of NoiseEstimate
        One for each sampling interval, the shortest first.
    which, trial : tuple of int
        Number of each observation's noise, and of the observation among those of that noise.
    rounds : int
    settled : bool
        Whether the last round moved every parameter by less than a tenth of its width.
    corrected : bool
        Whether the attenuation by noise of the imposed angle was taken off.
    drowned : bool
        Whether that noise is so large beside the motion that it could not be.
    """

    problem: Problem
    fit: Fit
    noises: tuple[NoiseEstimate, ...]
    which: tuple[int, ...]
    trial: tuple[int, ...]
    rounds: int
    settled: bool
    corrected: bool
    drowned: bool

    @property
    def log_likelihood(self) -> float:
        """In nats but for a constant, the stretches' levels marginalised, without corrections."""
        colour = self.problem.colour
        assert colour is not None
        total = -float(self.fit.cost)
        for row, of_one in enumerate(colour.stretches):
            noise = colour.noises[colour.which[row]]
            level = float(noise.levels[colour.trial[row]])
            for samples in of_one:
                whitening = noise.noise.whitening(samples.size)
                length = np.linalg.norm(whitening(np.ones((samples.size, 1)))) / level
                total -= 0.5 * whitening.log_determinant(samples.size)
                total -= samples.size * np.log(level) + np.log(length)
        return total


def fit_noisy(
    problem: Problem,
    stretches: Sequence[Sequence[np.ndarray]],
    start: np.ndarray,
    known: Sequence[float] = (),
) -> NoisyFit:
    """Fit a model and the noise of what it is compared with.

    Parameters
    ----------
    problem : Problem
        With white noise of standard deviation 1, K, B and I free.
    stretches : sequence of sequence of array of int
        For each observation the samples of each stretch of time that is compared. Within one the
        noise is correlated, between them it is not, and each has an unknown level.
    start : array, shape (n_free,)
        Such as the least squares estimate.
    known : sequence of float
        For each observation the white noise that its other channel has at least [rad or Nm]; none
        is known of by default.

    Returns
    -------
    NoisyFit

    Raises
    ------
    InputError
        Where the model has no finite response.
    """
    intervals = [o.drive.interval for o in problem.observations]
    rates = sorted({round(interval, 9) for interval in intervals})
    which = tuple(rates.index(round(interval, 9)) for interval in intervals)
    trial = tuple(which[:i].count(w) for i, w in enumerate(which))
    carry = _carrier(problem)
    squares = np.square(known) if known else np.zeros(len(which))
    least = np.sqrt([np.mean(squares[np.equal(which, i)]) for i in range(len(rates))])
    counts = [
        sum(s.size for row, of_one in enumerate(stretches) if which[row] == i for s in of_one)
        for i in range(len(rates))
    ]
    # An ARMA can look like noise of an imposed angle. But only that attenuates the fit, and at an
    # attenuated fit looks do not tell: there the angle is taken to be noisy in any case.
    every = contenders(carried=(True,) if _angle_imposed(problem) else (False, True))
    x, orders = np.asarray(start, float), [every] * len(rates)
    settled, before, moved_before = False, x, x
    for rounds in range(1, _ROUNDS + 1):
        # The order is chosen at the start, among the best at two fits that it led to, then kept.
        asked = orders if rounds <= _CHOICES else [best[:1] for best in orders]
        noises, orders = _noises(problem, stretches, x, which, trial, carry, asked, least)
        joint = problem.complete(x)[:3]
        excess = excess_of(noises, counts, rates) if _angle_imposed(problem) else None
        colour = Colour(noises, which, trial, stretches, excess, joint)
        weighed, drowned = _with_colour(problem, colour, x)
        best = _descend(weighed, x)
        width = 1 / np.linalg.norm(weighed.jacobian(best.values), axis=0)
        move = (best.values - x) / width
        settled = rounds > _CHOICES and bool(np.all(np.abs(move) <= _SETTLED))
        if settled:
            break
        x = best.values
        if rounds > _CHOICES + 1:
            x = _ahead(x, move, before, moved_before, width, problem)
        before, moved_before = best.values, move
    corrected = weighed.colour is not None and weighed.colour.excess is not None
    return NoisyFit(weighed, best, tuple(noises), which, trial, rounds, settled, corrected, drowned)


def _ahead(
    x: np.ndarray,
    move: np.ndarray,
    before: np.ndarray,
    moved_before: np.ndarray,
    width: np.ndarray,
    problem: Problem,
) -> np.ndarray:
    """Where rounds that each go a little further lead to (Anderson 1965, J ACM 12:547-560)."""
    change = move - moved_before
    share = float(move @ change) / max(float(change @ change), 1e-300)
    ahead = x - np.clip(share, -_AHEAD, _AHEAD) * (x - before)
    # A step beyond the bounds, or one that leaps, is none to take.
    lies_inside = np.all((ahead > problem.lower) & (ahead < problem.upper))
    return ahead if lies_inside and np.all(np.abs(ahead - x) <= _LEAP * width) else x


def _angle_imposed(problem: Problem) -> bool:
    return problem.observations[0].drive.imposed == "angle"


def _carrier(problem: Problem) -> Callable[[np.ndarray, float], Process]:
    return by_impedance if _angle_imposed(problem) else by_admittance


def _noises(
    problem: Problem,
    stretches: Sequence[Sequence[np.ndarray]],
    x: np.ndarray,
    which: Sequence[int],
    trial: Sequence[int],
    carry: Callable[[np.ndarray, float], Process],
    orders: Sequence[tuple[Contender, ...]],
    least: np.ndarray,
) -> tuple[list[NoiseEstimate], list[tuple[Contender, ...]]]:
    rows = len(problem.observations)
    residuals = problem.residuals(x).reshape(rows, -1)
    jacobians = problem.jacobian(x).reshape(*residuals.shape, -1)
    joint = problem.complete(x)[:3]
    found = []
    with threadpool_limits(1):  # many small systems: threads only get in each other's way
        for i, tried in enumerate(orders):
            mine = [
                Stretch(residuals[row, samples], jacobians[row, samples], trial[row])
                for row, of_one in enumerate(stretches)
                if which[row] == i
                for samples in of_one
            ]
            interval = problem.observations[which.index(i)].drive.interval
            found.append(estimate_noise(mine, carry(joint, interval), tried, float(least[i])))
    return [noise for noise, _ in found], [best for _, best in found]


def _with_colour(problem: Problem, colour: Colour, x: np.ndarray) -> tuple[Problem, bool]:
    """The problem with this noise; without its correction where no information would be left."""
    weighed = replace(problem, colour=colour)
    if colour.excess is None:
        return weighed, False
    information = curvature(weighed, x).hessian
    size = np.sqrt(np.abs(np.diag(information))) + 1e-300
    if np.linalg.eigvalsh(information / np.outer(size, size))[0] > 0:
        return weighed, False
    return replace(weighed, colour=replace(colour, excess=None)), True


def _descend(problem: Problem, x: np.ndarray) -> Fit:
    if not problem.model.effects:
        return fit(problem, x[None])
    return explore(problem, x[None], evaluations=_EVALUATIONS)
