"""Whitened residuals, likelihoods and conditional optima by machine code, for many points.

`Problem` puts together what is compared; the loops here ask the joint for its responses at one
point after the other, and whiten what they leave as `Observation` or `likelihood.coloured` say.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from identifiability.inference.likelihood.banded import whitened_without_level
from identifiability.inference.likelihood.coloured import LEAST, Colour
from identifiability.joint.native.calls import run
from identifiability.joint.native.duals import solved
from identifiability.joint.native.responding import respond
from identifiability.joint.native.response import Responses
from identifiability.joint.programs import THREADS
from identifiability.joint.response import Traced
from identifiability.loops import compiled_loop

_ITERATIONS = 72
CONVERGED = 1e-7
"""Decrease of the cost that a step promises, from which on an optimum is one; in nats."""
# Samples, in those of an exact response, from which on threads are worth their start.
_WORTH_THREADS, _INTEGRATED, _DESCENDED = 200_000, 20, 10


class Compared(NamedTuple):
    """What responses are compared with, all observations in one row.

    Attributes
    ----------
    measured, scale, constant : array, shape (n,)
    previous, segment : array of int, shape (n,)
        See `Observation`; rows and segments are counted through.
    echo, target : array, shape (n,)
        Times the carry, the scale; the whitened measurement.
    rows : array of int, shape (n,)
        Of the whitened residuals, where each sample belongs.
    n_rows, n_segments : int
    columns : int
        Of the responses, that are more than room: the value and its derivatives.
    samples, stretches : array of int
        Where noise has a colour: the samples of all stretches one after the other, and where each
        stretch starts, the last one's end included.
    which : array of int, shape (n_stretches,)
        Noise of each.
    level : array, shape (n_stretches,)
        Its standard deviation over the noise's.
    ar, factor : array, shape (n_noises, ...)
        See `Whitening`, padded to one size.
    sizes : array of int, shape (n_noises, 2)
        Sizes of both without the padding.
    excess : array, shape (3, 3)
    ceiling : float
        See `Colour`; the latter is 0 where nothing is taken off.
    """

    measured: np.ndarray
    scale: np.ndarray
    echo: np.ndarray
    target: np.ndarray
    constant: np.ndarray
    previous: np.ndarray
    segment: np.ndarray
    rows: np.ndarray
    n_rows: int
    n_segments: int
    columns: int
    samples: np.ndarray
    stretches: np.ndarray
    which: np.ndarray
    level: np.ndarray
    ar: np.ndarray
    factor: np.ndarray
    sizes: np.ndarray
    excess: np.ndarray
    ceiling: float


class Observed(Protocol):
    """What is needed of an `Observation`."""

    @property
    def measured(self) -> np.ndarray:
        """Response."""

    @property
    def previous(self) -> np.ndarray:
        """The compared sample before each sample."""


def compared(
    observations: Sequence[Observed],
    segments: Sequence[np.ndarray],
    n_segments: int,
    colour: Colour | None,
) -> Compared:
    """Put together what responses are compared with.

    Parameters
    ----------
    observations : sequence of Observation
    segments : sequence of array of int
        Segment of each of their samples, counted through.
    n_segments : int
        Of those with an unknown constant.
    colour : Colour or None
        Noise that whitens in the place of that of the observations.
    """
    sizes = [o.measured.size for o in observations]
    starts = np.cumsum([0, *sizes])
    longest = max(sizes)
    rows = [i * longest + np.arange(n) for i, n in enumerate(sizes)]
    n_rows = len(sizes) * longest
    samples, level, which = [np.empty(0, np.int64)], [], []
    ar, factor, lengths = np.ones((1, 1)), np.ones((1, 1, 1)), np.ones((1, 2), np.int64)
    excess, ceiling = np.zeros((3, 3)), 0.0
    if colour is not None:
        for i, of_one in enumerate(colour.stretches):
            noise = colour.which[i]
            samples += [starts[i] + s for s in of_one]
            which += [noise] * len(of_one)
            level += [colour.noises[noise].levels[colour.trial[i]]] * len(of_one)
        whitenings = colour.whitenings
        ar = _padded([w.ar for w in whitenings])
        factor = _padded([w.factor for w in whitenings])
        lengths = np.array([(w.ar.size, len(w.factor)) for w in whitenings])
        n_rows = sum(map(len, samples))
        if colour.excess is not None:
            excess, ceiling, n_rows = colour.excess, colour.ceiling, n_rows + 1

    def row(name: str) -> np.ndarray:
        return np.concatenate([getattr(o, name) for o in observations]).astype(float)

    measured, scale, echo = row("measured"), row("scale"), row("scale") * row("carry")
    previous = np.concatenate([o.previous + a for o, a in zip(observations, starts, strict=False)])
    return Compared(
        measured,
        scale,
        echo,
        scale * measured - echo * measured[previous],
        row("constant"),
        previous,
        np.concatenate(segments),
        np.concatenate(rows),
        n_rows,
        n_segments,
        1,
        np.concatenate(samples),
        np.cumsum([0, *map(len, samples[1:])]),
        np.array(which, np.int64),
        np.array(level, float),
        ar,
        factor,
        lengths,
        np.ascontiguousarray(excess, float),
        ceiling,
    )


def _padded(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays one upon the other, filled up with zeros."""
    shape = np.max([a.shape for a in arrays], axis=0)
    found = np.zeros((len(arrays), *shape))
    for out, a in zip(found, arrays, strict=True):
        out[tuple(slice(size) for size in a.shape)] = a
    return found


class Evaluation:
    """A likelihood at one point or many.

    Attributes
    ----------
    responses : Responses or Traced
    compared : Compared
    template : array, shape (n_parameters,)
        Parameter vector in which the free ones are filled in.
    free : array of int, shape (n_free,)
    lanes : array of int, shape (n_parameters,)
        Which derivative is that by each parameter, from 1; 0 if none.
    native : bool
        Whether machine code gives the responses.
    """

    def __init__(
        self,
        responses: Responses | Traced,
        compared: Compared,
        template: np.ndarray,
        free: Sequence[int],
    ) -> None:
        self.responses = responses
        self.compared = compared._replace(columns=responses.columns)
        self.template, self.free = template, np.array(free, np.int64)
        self.lanes, self.native = responses.lanes, isinstance(responses, Responses)

    def whitened(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals, then their derivatives, shape (n_rows, width)."""
        white = np.zeros((self.compared.n_rows, self.compared.columns))
        theta = self.template.copy()
        theta[self.free] = x
        if isinstance(self.responses, Traced):
            response = np.concatenate(self.responses.at(theta))
        else:
            response = self.responses.all_at(theta)
        self._products_of(response, theta, white)
        return white

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """Minus half the sum of squares at each point, shape (n_points,)."""
        if isinstance(self.responses, Traced):
            thetas = np.tile(self.template, (len(points), 1))
            thetas[:, self.free] = points
            every = zip(self.responses.values(thetas), thetas, strict=True)
            squares = [self._products_of(y[:, None], theta)[0, 0] for y, theta in every]
            return -0.5 * np.array(squares)
        return -0.5 * self._over(points)[1][:, 0, 0]

    def optima(
        self,
        points: np.ndarray,
        moves: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        accuracy: float = CONVERGED,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Least squares from each point on, by Levenberg-Marquardt steps within bounds.

        Parameters
        ----------
        points : array, shape (n_points, n_free)
        moves : array of bool, shape (n_free,)
            Whether each may change.
        lower, upper : array, shape (n_free,)
        accuracy : float
            See `CONVERGED`.

        Returns
        -------
        points : array, shape (n_points, n_free)
        products : array, shape (n_points, 1 + n_free, 1 + n_free)
            Inner products of the whitened residuals and their derivatives there.
        """
        return self._over(points, _ITERATIONS, moves, lower, upper, accuracy)

    def _products_of(
        self, response: np.ndarray, theta: np.ndarray, white: np.ndarray | None = None
    ) -> np.ndarray:
        """Inner products of the whitened residuals of a response, which are kept in `white`."""
        columns = self.compared.columns
        if white is None:
            white = np.zeros((self.compared.n_rows, columns))
        found = np.zeros((columns, columns))
        _compare(np.ascontiguousarray(response), self.compared, theta, self.lanes, white, found)
        return found

    def _over(
        self,
        points: np.ndarray,
        iterations: int = 0,
        moves: np.ndarray | None = None,
        lower: np.ndarray | None = None,
        upper: np.ndarray | None = None,
        accuracy: float = CONVERGED,
    ) -> tuple[np.ndarray, np.ndarray]:
        responses = self.responses
        assert isinstance(responses, Responses)
        found, k = np.array(points, float, order="C"), len(self.free)
        columns = self.compared.columns
        grams = np.zeros((len(found), columns, columns))
        may = np.zeros(k, np.bool_) if moves is None else np.asarray(moves, np.bool_)
        low = np.full(k, -np.inf) if lower is None else np.array(lower, float)
        high = np.full(k, np.inf) if upper is None else np.array(upper, float)

        def some(a: int, b: int) -> None:
            _evaluate(
                respond.address,
                responses.plan,
                self.lanes,
                self.template,
                self.free,
                self.compared,
                responses.width,
                may,
                low,
                high,
                iterations,
                accuracy,
                found[a:b],
                grams[a:b],
            )

        work = len(found) * self.compared.measured.size * (_DESCENDED if iterations else 1)
        if not responses.exact:
            work *= _INTEGRATED
        if work < _WORTH_THREADS or len(found) < THREADS:
            some(0, len(found))
            return found, grams
        ends = np.linspace(0, len(found), THREADS + 1).astype(int)
        with ThreadPoolExecutor(THREADS) as pool:
            for part in [pool.submit(some, int(a), int(b)) for a, b in pairwise(ends)]:
                part.result()
        return found, grams


@compiled_loop
def _evaluate(
    address: int | None,
    plan: np.ndarray,
    lanes: np.ndarray,
    template: np.ndarray,
    free: np.ndarray,
    what: Compared,
    width: int,
    moves: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    iterations: int,
    accuracy: float,
    points: np.ndarray,
    grams: np.ndarray,
) -> None:
    """Inner products at points, which may move to the optimum first."""
    k = free.size
    theta = template.copy()
    response = np.empty((what.measured.size, width))
    # Squares alone need no room for what they are of.
    alone = what.columns == 1 and not what.n_segments and len(what.stretches) == 1
    white = np.zeros((0 if alone else what.n_rows, what.columns))
    trial, there = np.empty(k), np.empty((what.columns, what.columns))
    system, step = np.empty((k, k)), np.empty((k, 1))
    for p in range(len(points)):
        x, here = points[p], grams[p]
        _products(address, plan, lanes, theta, free, x, what, response, white, here)
        damping = 1e-3
        for _ in range(iterations):
            fall = _step(x, here, damping, moves, lower, upper, system, step)
            for i in range(k):
                trial[i] = min(max(x[i] + step[i, 0], lower[i]), upper[i])
            _products(address, plan, lanes, theta, free, trial, what, response, white, there)
            # Where residuals are large the Gauss-Newton step overshoots; the damping that cures
            # this must be kept, not relaxed after every success: Marquardt's gain ratio decides.
            gain = 0.5 * (here[0, 0] - there[0, 0]) / max(fall[1], 1e-300)
            last = fall[0] < accuracy or damping > 1e9
            if there[0, 0] <= here[0, 0]:
                x[:] = trial
                here[:, :] = there
            if last:
                break
            if gain > 0.75:
                damping = max(0.2 * damping, 1e-12)
            elif not gain >= 0.25:
                damping = min(4.0 * damping, 1e12)


@compiled_loop
def _step(
    x: np.ndarray,
    products: np.ndarray,
    damping: float,
    moves: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    system: np.ndarray,
    step: np.ndarray,
) -> tuple[float, float]:
    """A damped step, into `step`; its slope downwards, and the decrease it predicts."""
    k = x.size
    descent, size, whole = np.zeros(k), np.zeros(k), np.zeros((k, k))
    for i in range(k):
        slope = products[1 + i, 0]
        held = (x[i] <= lower[i] and slope > 0) or (x[i] >= upper[i] and slope < 0)
        if moves[i] and not held:
            size[i] = 1 / np.sqrt(max(products[1 + i, 1 + i], 1e-300))
        descent[i] = size[i] * slope
    for i in range(k):
        for j in range(k):
            whole[i, j] = products[1 + i, 1 + j] * size[i] * size[j]
        whole[i, i] += damping if size[i] > 0 else 1.0
        step[i, 0] = -descent[i]
        for j in range(k):
            system[i, j] = whole[i, j]
    solved(system, step)
    slope = curve = 0.0
    for i in range(k):
        slope -= descent[i] * step[i, 0]
        for j in range(k):
            curve += step[i, 0] * whole[i, j] * step[j, 0]
    for i in range(k):
        step[i, 0] *= size[i]
    return slope, slope - 0.5 * curve


@compiled_loop
def _products(
    address: int | None,
    plan: np.ndarray,
    lanes: np.ndarray,
    theta: np.ndarray,
    free: np.ndarray,
    x: np.ndarray,
    what: Compared,
    response: np.ndarray,
    white: np.ndarray,
    out: np.ndarray,
) -> None:
    """Inner products of whitened residuals and their derivatives at a point."""
    for i in range(free.size):
        theta[free[i]] = x[i]
    run(address, plan, theta, 0, response, 0, response, 0)
    _compare(response, what, theta, lanes, white, out)


@compiled_loop
def _compare(
    response: np.ndarray,
    what: Compared,
    theta: np.ndarray,
    lanes: np.ndarray,
    white: np.ndarray,
    out: np.ndarray,
) -> None:
    """Whiten what a response leaves; its inner products, infinite where they are none."""
    width = out.shape[0]
    if len(what.stretches) > 1:
        _coloured(response, what, theta, lanes, white)
    elif not len(white):
        _squares(response, what, out)
        return
    else:
        _plain(response, what, white)
    for s in range(width):
        for t in range(s + 1):
            out[s, t] = 0.0
    for k in range(white.shape[0]):
        for s in range(width):
            for t in range(s + 1):
                out[s, t] += white[k, s] * white[k, t]
    for s in range(width):
        for t in range(s):
            out[t, s] = out[s, t]
    if not out[0, 0] < np.inf:
        out[0, 0] = np.inf


@compiled_loop
def _squares(response: np.ndarray, what: Compared, out: np.ndarray) -> None:
    """Square of what `_plain` leaves of a value alone, without unknown constants."""
    total = 0.0
    for i in range(len(response)):
        before, left = what.previous[i], what.scale[i] * response[i, 0] - what.target[i]
        left -= what.echo[i] * response[before, 0]
        total += left * left
    out[0, 0] = total if total < np.inf else np.inf


@compiled_loop
def _plain(response: np.ndarray, what: Compared, white: np.ndarray) -> None:
    """``scale * (r - carry * r[previous])`` of a residual r, freed of unknown constants."""
    n, width = len(response), what.columns
    for i in range(n):
        before, echo, scale, row = what.previous[i], what.echo[i], what.scale[i], what.rows[i]
        white[row, 0] = scale * response[i, 0] - echo * response[before, 0] - what.target[i]
        for t in range(1, width):
            white[row, t] = scale * response[i, t] - echo * response[before, t]
    if not what.n_segments:
        return
    sums = np.zeros((what.n_segments, width))
    for i in range(n):
        for t in range(width):
            sums[what.segment[i], t] += what.constant[i] * white[what.rows[i], t]
    for i in range(n):
        for t in range(width):
            white[what.rows[i], t] -= what.constant[i] * sums[what.segment[i], t]


@compiled_loop
def _coloured(
    response: np.ndarray, what: Compared, theta: np.ndarray, lanes: np.ndarray, white: np.ndarray
) -> None:
    """Residuals whitened as `likelihood.coloured` says."""
    width = what.columns
    for s in range(len(what.stretches) - 1):
        a, b, noise = what.stretches[s], what.stretches[s + 1], what.which[s]
        residual = np.empty((b - a, width))
        for i in range(b - a):
            sample = what.samples[a + i]
            for t in range(width):
                residual[i, t] = response[sample, t] / what.level[s]
            residual[i, 0] -= what.measured[sample] / what.level[s]
        ar = what.ar[noise, : what.sizes[noise, 0]]
        factor = what.factor[noise, : what.sizes[noise, 1]]
        found, _ = whitened_without_level(ar, factor, residual)
        for i in range(b - a):
            for t in range(width):
                white[a + i, t] = found[i, t]
    if what.ceiling == 0.0:
        return
    last = white[len(white) - 1]
    along = what.excess @ theta[:3]
    left = what.ceiling - np.sum(along * theta[:3])
    least = LEAST * what.ceiling
    last[:] = 0.0
    last[0] = np.sqrt(max(left, least))
    if left > least:
        for i in range(3):
            if lanes[i]:
                last[lanes[i]] = -along[i] / last[0]
