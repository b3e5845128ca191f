"""Noise that is sought beside another of known size: its likelihood, and where that is highest."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

from identifiability.inference.likelihood import carried
from identifiability.inference.likelihood.beside import (
    Left,
    change_beside,
    deviance,
    most_likely,
    whitened_beside,
    whitened_beside_of_four,
)
from identifiability.inference.likelihood.estimate import (
    Contender,
    Order,
    Stretch,
    contenders,
    estimate_noise,
)
from identifiability.inference.likelihood.processes import Process
from identifiability.inference.likelihood.profiled import polynomial

JOINT, INTERVAL = np.array([40.0, 0.5, 0.05]), 0.01
LENGTHS = (80, 120, 100)


def came_in():
    """Noise that a joint carried over, of variance 1."""
    found = carried.by_impedance(JOINT, INTERVAL)
    return replace(found, sd=1 / np.sqrt(found.autocovariance(0)[0]))


def recorded(seed=4, k=2):
    """Residuals, derivatives and known variances of three stretches."""
    random = np.random.default_rng(seed)
    own, moved = Process(np.array([1.0, -0.6]), np.array([1.0, 0.3]), 0.5), came_in()
    out = []
    for n in LENGTHS:
        variances = np.where(random.random(n) < 0.3, 4.0, 0.0)
        residual = own.draw(n, random) + 0.7 * moved.draw(n, random)
        residual += np.sqrt(variances) * random.standard_normal(n)
        out.append((residual, np.cumsum(random.standard_normal((n, k)), axis=0), variances))
    return out


def left_in(stretches, k):
    rows = [np.column_stack([r, j])[:, : 1 + k].ravel() for r, j, _ in stretches]
    moved = came_in()
    return Left(
        1,
        1,
        (moved.ar, moved.sd * moved.ma),
        np.concatenate(rows),
        np.array(LENGTHS),
        np.concatenate([v for _, _, v in stretches]),
        k,
    )


def dense(values, stretches, k):
    """Minus twice the restricted log likelihood by full matrices, but for a constant."""
    own = Process(*(polynomial(np.tanh(values[i : i + 1])) for i in (0, 1)), np.exp(values[2]))
    moved = replace(came_in(), sd=came_in().sd * np.exp(values[3]))
    blocks, residuals, taken = [], [], []
    for i, (residual, jacobian, variances) in enumerate(stretches):
        n = residual.size
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        blocks.append(sum(p.autocovariance(n - 1)[lag] for p in (own, moved)) + np.diag(variances))
        residuals.append(residual)
        level = np.zeros((n, len(stretches)))
        level[:, i] = 1.0
        taken.append(np.column_stack([level, jacobian[:, :k]]))
    covariance, residual = scipy.linalg.block_diag(*blocks), np.concatenate(residuals)
    taken = np.concatenate(taken)
    levels = taken[:, : len(stretches)]
    within = np.linalg.solve(covariance, taken)
    # The fit has taken its share of the residual already: only levels are left to fit.
    solved = np.linalg.solve(covariance, np.column_stack([residual, levels]))
    offset = np.linalg.solve(levels.T @ solved[:, 1:], levels.T @ solved[:, 0])
    centred = residual - levels @ offset
    squares = centred @ np.linalg.solve(covariance, centred)
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(taken.T @ within)[1]
    return squares + determinants


@pytest.mark.parametrize("k", [0, 2])
def test_the_deviance_is_that_of_full_matrices(k):
    stretches = recorded()
    points = np.array([[-0.5, 0.3, -0.7, -0.4], [-1.2, 0.1, 0.2, 0.6], [0.3, -0.8, -1.5, -3.0]])
    banded = np.array([deviance(point, left_in(stretches, k)) for point in points])
    full = np.array([dense(point, stretches, k) for point in points])
    np.testing.assert_allclose(np.diff(banded), np.diff(full), rtol=1e-7)


@pytest.mark.parametrize("k", [0, 2])
@pytest.mark.parametrize("last", [-0.4, -3.0, -40.0])
def test_four_noises_at_a_time_are_what_each_is_alone(k, last):
    """In the last, little is the instrument's own, and less and less is carried."""
    left, points = left_in(recorded(), k), np.array([-0.5, 0.3, -0.7, -0.4]) + np.zeros((4, 1))
    points[1:, 0], points[2:, 2], points[3, 3] = -1.2, [0.2, -4.0], last
    white, diagonal, rest = whitened_beside_of_four(points, left)
    for i, point in enumerate(points):
        alone = whitened_beside(point, left)
        np.testing.assert_allclose(white[i], alone[0], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(diagonal[i], alone[1], rtol=1e-9)
        assert rest[i] == pytest.approx(alone[2], rel=1e-9)


def test_four_noises_of_which_one_is_none_are_what_each_is_alone():
    left = left_in(recorded(), 2)
    points = np.array([[-0.5, 0.3, 0.0, -0.4]] * 4)
    points[1, 2] = 800.0  # beyond the largest number
    white, _, rest = whitened_beside_of_four(points, left)
    assert np.isfinite(white[:, 0]).tolist() == [True, False, True, True]
    for i in (0, 2, 3):
        alone = whitened_beside(points[i], left)
        np.testing.assert_allclose(white[i], alone[0], rtol=1e-9, atol=1e-12)
        assert rest[i] == pytest.approx(alone[2], rel=1e-12)


@pytest.mark.parametrize("held", [False, True])
def test_the_slope_of_the_deviance_is_that_of_its_differences(held):
    left, point = left_in(recorded(), 2), np.array([-0.5, 0.3, -0.7, -0.4])
    n = 4 - held
    gradient, products = change_beside(point, *whitened_beside(point, left), left, n)
    for i in range(n):
        away = np.zeros(4)
        away[i] = 1e-4
        slope = (deviance(point + away, left) - deviance(point - away, left)) / 2e-4
        assert gradient[i] == pytest.approx(0.5 * slope, rel=1e-3, abs=1e-3)
    assert np.all(np.linalg.eigvalsh(products) > 0)


@pytest.mark.parametrize("held", [False, True])
def test_what_is_found_is_most_likely(held):
    stretches = recorded()
    left, start = left_in(stretches, 2), np.array([-0.2, 0.0, 0.0, -2.0])
    n_free = 4 - held
    found, ended = most_likely(start, left, np.full(n_free, -8.0), np.full(n_free, 8.0))
    best = scipy.optimize.minimize(
        lambda free: dense(np.append(free, start[n_free:]), stretches, 2),
        start[:n_free],
        method="Nelder-Mead",
        options={"maxfev": 2000},
    )
    assert ended
    np.testing.assert_array_equal(found[n_free:], start[n_free:])
    assert deviance(start, left) - deviance(found, left) > 10
    assert dense(found, stretches, 2) < best.fun + 0.02


def test_a_known_part_is_held_at_its_size_and_the_rest_is_most_likely():
    """With less of the carried noise in the record than there is known to be."""
    stretches = [Stretch(r, j, i, v) for i, (r, j, v) in enumerate(recorded())]
    moved = replace(came_in(), sd=1.0)
    tried = [Contender(Order(1, 1, True))]
    free, _ = estimate_noise(stretches, moved, tried)
    known = 1.5 * free.carried_sd
    held, _ = estimate_noise(stretches, moved, tried, known)
    assert held.carried_sd == pytest.approx(known, rel=0.02)
    assert held.own.sd < free.own.sd
    for estimate in (free, held):
        values = [
            *np.arctanh([estimate.own.ar[1], estimate.own.ma[1]]),
            np.log(estimate.own.sd),
            np.log(estimate.carried_sd / came_in().sd),
        ]
        here = dense(np.array(values), recorded(), 2)
        for i in range(3):
            for step in (-0.05, 0.05):
                moved_by = np.array(values) + step * np.eye(4)[i]
                assert dense(moved_by, recorded(), 2) > here - 1e-2


def test_levels_are_right_whatever_is_beside():
    """Without the known part in its covariance the own noise would be three times as loud."""
    random = np.random.default_rng(6)
    stretches, without = [], []
    for i in range(8):
        variances = np.where(random.random(200) < 0.5, 16.0, 0.0)
        residual = random.standard_normal(200)
        residual += np.sqrt(variances) * random.standard_normal(200)
        stretches.append(Stretch(residual, np.zeros((200, 0)), i, variances))
        without.append(Stretch(residual, np.zeros((200, 0)), i))
    orders = contenders(carried=(False,))
    found, control = (estimate_noise(one, None, orders)[0] for one in (stretches, without))
    assert found.own.sd == pytest.approx(1.0, rel=0.1)
    assert control.own.sd > 2.5
