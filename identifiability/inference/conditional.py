"""Optima with some parameters held, for a whole batch of held values at once.

Profiles follow such optima, and the quadrature is laid along them. SciPy solves one problem at a
time; here thousands of small ones are solved together, by Levenberg-Marquardt steps within the
bounds, compiled once. Tests compare it with SciPy.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax import Array

from identifiability.inference.fitting import inside
from identifiability.inference.problem import Data, Problem, Program, pad, whitened
from identifiability.joint.programs import compiled

_ITERATIONS, _MOST_ROUNDS = 6, 12
_SIZES = (32, 64, 512)
_FEW_EVALUATIONS = 5
_CONVERGED = 1e-7  # predicted decrease of the cost, in units of log likelihood


class _State(NamedTuple):
    x: Array
    cost: Array
    gradient: Array
    information: Array
    damping: Array
    iterations: Array
    done: Array


class Conditional(NamedTuple):
    """Optima of the free parameters that are not held.

    Attributes
    ----------
    points : array, shape (n, k)
        All free parameters, held ones included.
    log_likelihood : array, shape (n,)
    gradient : array, shape (n, k)
        Of the negative log likelihood.
    information : array, shape (n, k, k)
        J'J of the whitened residuals.
    """

    points: np.ndarray
    log_likelihood: np.ndarray
    gradient: np.ndarray
    information: np.ndarray


def conditional_optima(problem: Problem, held: tuple[int, ...], points: np.ndarray) -> Conditional:
    """Maximise the likelihood over the parameters that are not held.

    Parameters
    ----------
    problem : Problem
    held : tuple of int
        Positions, among the free parameters, of those that keep their value in `points`.
    points : array, shape (n, k)
        Held values, and starts for the others.

    Returns
    -------
    Conditional
    """
    points = np.clip(np.asarray(points, float), problem.lower, problem.upper)
    n, k = points.shape
    found = Conditional(points.copy(), np.empty(n), np.empty((n, k)), np.empty((n, k, k)))
    damping = np.full(n, 1e-3)
    moves = np.array([i not in held for i in range(k)])
    undone = np.arange(n)
    sizes = tuple(size for size in _SIZES if size <= problem.batches[-1])
    largest = sizes[-1]
    # A few stubborn points must not keep thousands of finished ones in the batch.
    for _ in range(_MOST_ROUNDS):
        for first in range(0, undone.size, largest):
            chunk = undone[first : first + largest]
            padded = pad(chunk, sizes)
            solved, strength, done = _solve(
                problem.program,
                moves,
                found.points[padded],
                damping[padded],
                problem.lower,
                problem.upper,
                problem.template,
                problem.data,
            )
            for target, values in zip(found, solved, strict=True):
                target[chunk] = np.asarray(values)[: chunk.size]
            damping[chunk] = np.asarray(strength)[: chunk.size]
            undone[first : first + largest] = np.where(np.asarray(done)[: chunk.size], -1, chunk)
        undone = undone[undone >= 0]
        if undone.size == 0:
            break
    return found


def one_by_one(problem: Problem, held: tuple[int, ...], points: np.ndarray) -> Conditional:
    """The same as `conditional_optima`, by SciPy, to a thousandth of a unit of log likelihood.

    For few points and responses that take long, and need no further compilation.
    """
    points = np.clip(np.asarray(points, float), problem.lower, problem.upper)
    n, k = points.shape
    rest = [i for i in range(k) if i not in held]
    found = Conditional(points.copy(), np.empty(n), np.empty((n, k)), np.empty((n, k, k)))
    for i, point in enumerate(inside(problem, points)):
        # What is held keeps its value even on a bound.
        point = np.where(np.isin(np.arange(k), held), points[i], point)

        def whole(moved: np.ndarray, point: np.ndarray = point) -> np.ndarray:
            full = point.copy()
            full[rest] = moved
            return full

        best = point
        if rest:
            solved = scipy.optimize.least_squares(
                lambda moved: problem.residuals(whole(moved)),
                point[rest],
                jac=lambda moved: problem.jacobian(whole(moved))[:, rest],
                bounds=(problem.lower[rest], problem.upper[rest]),
                x_scale="jac",
                ftol=1e-3 / max(problem.n_samples, 1),
                xtol=1e-9,
                gtol=1e-12,
                max_nfev=_FEW_EVALUATIONS,
            )
            best = whole(solved.x)
        white, jacobian = problem.residuals(best), problem.jacobian(best)
        found.points[i] = best
        found.log_likelihood[i] = -0.5 * white @ white
        found.gradient[i] = jacobian.T @ white
        found.information[i] = jacobian.T @ jacobian
    return found


@compiled
def _solve(
    program: Program,
    moves: Array,
    points: Array,
    dampings: Array,
    lower: Array,
    upper: Array,
    template: Array,
    data: Data,
) -> tuple[tuple[Array, ...], Array, Array]:
    def linearise(x: Array) -> tuple[Array, Array, Array]:
        def along(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda y: whitened(program, y, template, data), (x,), (direction,))

        white, tangents = jax.vmap(along, out_axes=(None, 0))(jnp.eye(x.size))
        cost = 0.5 * white @ white
        information = jnp.sum(tangents[:, None, :] * tangents[None, :, :], axis=-1)
        return jnp.where(jnp.isnan(cost), jnp.inf, cost), tangents @ white, information

    def iterate(state: _State) -> _State:
        x, gradient, information = state.x, state.gradient, state.information
        blocked = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)) | ~moves
        diagonal = jnp.where(blocked, 1.0, jnp.maximum(jnp.diag(information), 1e-300))
        size = 1 / jnp.sqrt(diagonal)
        scaled = information * size[:, None] * size[None, :]
        scaled = jnp.where(blocked[:, None] | blocked[None, :], 0.0, scaled)
        scaled = scaled + jnp.diag(jnp.where(blocked, 1.0, state.damping))
        descent = jnp.where(blocked, 0.0, size * gradient)
        step = -jnp.linalg.solve(scaled, descent)
        trial = jnp.clip(x + size * step, lower, upper)
        cost, trial_gradient, trial_information = linearise(trial)
        better = cost <= state.cost
        # Where residuals are large the Gauss-Newton step overshoots; the damping that cures this
        # must be kept, not relaxed after every success: Marquardt's gain ratio decides.
        predicted = -descent @ step - 0.5 * step @ (scaled @ step)
        gain = (state.cost - cost) / jnp.maximum(predicted, 1e-300)
        factor = jnp.where(gain > 0.75, 0.2, jnp.where(gain < 0.25, 4.0, 1.0))
        begun = jnp.isfinite(state.cost)
        finished = begun & ((-descent @ step < _CONVERGED) | (state.damping > 1e9))

        def pick(new: Array, old: Array) -> Array:
            return jnp.where(better, new, old)

        return _State(
            pick(trial, x),
            pick(cost, state.cost),
            pick(trial_gradient, gradient),
            pick(trial_information, information),
            jnp.where(begun, jnp.clip(state.damping * factor, 1e-12, 1e12), state.damping),
            state.iterations + 1,
            finished,
        )

    def solve(start: Array, damping: Array) -> tuple[tuple[Array, ...], Array, Array]:
        # The first iteration only evaluates the start: the response is compiled once, not twice.
        unknown = (jnp.asarray(jnp.inf), jnp.zeros(start.size), jnp.eye(start.size))
        state = _State(start, *unknown, damping, jnp.asarray(0), jnp.asarray(False))
        state = jax.lax.while_loop(lambda s: ~s.done & (s.iterations < _ITERATIONS), iterate, state)
        found = (state.x, -state.cost, state.gradient, state.information)
        return found, state.damping, state.done

    return jax.vmap(solve)(points, dampings)
