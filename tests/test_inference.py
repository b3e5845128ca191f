"""Optima, curvature, profiles, quadrature and noise against SciPy, dense algebra and brute force.

The reference case is that of an independent study: the impulse response of the musculoskeletal
model K_CE = 32, B_CE = 3.2, K_SE = 100, I = 0.1 at 1 kHz, noise in the contour reading of
dE = 0.001, prior uniform over the physical bounds.
"""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
import scipy.stats
from oracles import (
    agree,
    central_difference,
    impulse_by_residues,
    kbi_impulse,
    msm_transfer,
)

from identifiability.errors import InputError
from identifiability.inference.conditional import conditional_optima
from identifiability.inference.curvature import curvature, largest_change
from identifiability.inference.fitting import explore, fit, fit_simplex, starting_points
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.inference.profiles import DROPS, profile
from identifiability.inference.quadrature import quadrature
from identifiability.inference.starts import plain_values
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.model import KBI
from identifiability.joint.response import drive_arrays, exact_response
from identifiability.measurement.noise import Noise, matched_noise
from identifiability.measurement.perturbations import Impulse, imposed_motion
from identifiability.study.setting import Setting, error_problem, measured_problem

SETTING = Setting(32.0, 3.2, 100.0, 0.1)
WINDOWS = (50, 100, 200)  # ms
DE = 1e-3
LOWER, UPPER = np.array([0.0, 0.0, 0.005]), np.array([2000.0, 50.0, 1.0])

# From 250³ Gauss-Legendre nodes, printed to four digits.
MODES = {50: (54.73, 0.3601, 0.09860), 100: (38.18, 0.8130, 0.09402), 200: (27.94, 1.340, 0.08202)}
MEANS = {50: (36.51, 0.8115, 0.09483), 100: (34.59, 0.9711, 0.09264), 200: (28.30, 1.336, 0.08351)}
SDS = {50: (23.39, 0.5304, 0.009137), 100: (13.16, 0.5803, 0.01231), 200: (1.963, 0.1286, 0.007489)}
CORRELATIONS = {
    50: (-0.683, 0.085, -0.714),
    100: (-0.974, 0.794, -0.854),
    200: (-0.682, 0.852, -0.640),
}
LOG_EVIDENCE = {50: -11.807, 100: -13.249, 200: -16.562}


# The same posterior without the package


@cache
def target(ms):
    time = np.arange(ms + 1) * 1e-3
    return time, impulse_by_residues(msm_transfer(32.0, 3.2, 0.1, 100.0), time)


def whitened(x, ms, dE=DE):
    """Residuals over the noise's standard deviation, shape (..., n)."""
    time, measured = target(ms)
    K, B, I = (np.asarray(x, float)[..., i, None] for i in range(3))
    return (kbi_impulse(time, K, B, I) - measured) / np.sqrt(dE * np.sum(measured**2))


def cost(x, ms, dE=DE):
    return 0.5 * np.sum(whitened(x, ms, dE) ** 2, axis=-1)


def polished(ms, held=None, lower=LOWER, upper=UPPER, start=None):
    """Optimum by SciPy, some parameters held at given values."""
    held = held or {}
    free = [i for i in range(3) if i not in held]
    whole = np.array(MODES[ms] if start is None else start, float)
    whole[list(held)] = list(held.values())
    size = np.array([50.0, 1.0, 0.1])[free]

    def residuals(z):
        whole[free] = z * size
        return whitened(whole, ms)

    result = scipy.optimize.least_squares(
        residuals,
        np.clip(whole[free], lower[free] + 1e-6, upper[free] - 1e-6) / size,
        jac="3-point",
        bounds=(lower[free] / size, upper[free] / size),
        ftol=1e-15,
        xtol=1e-15,
        gtol=1e-15,
        max_nfev=500,
    )
    whole[free] = result.x * size
    return whole.copy(), float(result.cost)


@cache
def problem(ms=100, reading="contour"):
    return measured_problem(SETTING, Impulse(), ms / 1000, reading=reading, dE=DE)


@cache
def optimum(ms=100, reading="contour"):
    return fit(problem(ms, reading), SETTING.starts())


# The likelihood


def test_likelihood_is_that_of_the_closed_forms():
    rng = np.random.default_rng(0)
    points = np.array(MODES[100]) * rng.uniform(0.3, 3, (50, 3))
    np.testing.assert_allclose(problem().log_likelihood(points), -cost(points, 100), rtol=1e-8)
    agree(problem().residuals(points[0]), whitened(points[0], 100), 1e-9)
    agree(problem().responses(points[0])[0], kbi_impulse(target(100)[0], *points[0]), 1e-10)


def test_posterior_ends_at_the_bounds():
    inside, outside = np.array(MODES[100]), np.array([-1e-9, 0.8, 0.09])
    found = problem().log_posterior(np.stack([inside, outside, [40.0, 0.8, 1.1]]))
    assert found[0] == pytest.approx(-cost(inside, 100), rel=1e-8)
    assert np.all(found[1:] == -np.inf)
    assert np.isfinite(problem().log_posterior(np.stack([LOWER, UPPER]))).all()


def test_batches_of_any_size_give_the_same_numbers():
    rng = np.random.default_rng(0)
    points = np.array(MODES[100]) * rng.uniform(0.3, 3, (4200, 3))
    whole = problem().log_likelihood(points)
    np.testing.assert_allclose(whole[:100], problem().log_likelihood(points[:100]), rtol=1e-12)
    np.testing.assert_allclose(whole[-7:], problem().log_likelihood(points[-7:]), rtol=1e-12)


# The optimum


@pytest.mark.parametrize("ms", WINDOWS)
def test_optimum_is_that_of_scipy(ms):
    found = optimum(ms)
    np.testing.assert_allclose(found.values, MODES[ms], rtol=3e-4)
    size = np.array(MODES[ms])
    simplex = scipy.optimize.minimize(
        lambda z: float(cost(z * size, ms)),
        np.full(3, 1.05),
        method="Nelder-Mead",
        options={"xatol": 1e-11, "fatol": 1e-16, "maxiter": 4000, "maxfev": 4000},
    )
    squares, least = polished(ms)
    np.testing.assert_allclose(found.values, squares, rtol=1e-6)
    np.testing.assert_allclose(found.values, simplex.x * size, rtol=1e-4)
    assert found.cost <= least * (1 + 1e-9)
    assert found.cost <= simplex.fun * (1 + 1e-9)
    assert found.at_bound == ()
    assert found.n_agreeing == len(found.costs) == 4
    assert found["K"] == found.values[0]


def test_poor_starts_lead_to_the_same_optimum():
    starts = starting_points(problem(), np.array([300.0, 10.0, 0.3]), 8, seed=3)
    assert np.all((starts > LOWER) & (starts < UPPER))
    assert np.array_equal(starts, starting_points(problem(), [300.0, 10.0, 0.3], 8, seed=3))
    assert not np.array_equal(starts, starting_points(problem(), [300.0, 10.0, 0.3], 8, seed=4))
    found = fit(problem(), starts)
    np.testing.assert_allclose(found.values, optimum().values, rtol=1e-6)
    assert found.n_agreeing >= 4


def test_simplex_reaches_the_optimum_when_it_is_told_to():
    start = SETTING.starts()[:1]
    loose = fit_simplex(problem(), start)
    tight = fit_simplex(problem(), start, xatol=1e-9, fatol=1e-14)
    np.testing.assert_allclose(tight.values, optimum().values, rtol=1e-4)
    assert tight.cost <= loose.cost
    assert tight.cost == pytest.approx(optimum().cost, rel=1e-6)


def test_optimum_on_a_bound():
    prior = Prior.physical(KBI(), K=(0.0, 30.0))
    found = fit(problem().with_prior(prior), SETTING.starts())
    upper = np.array([30.0, 50.0, 1.0])
    expected, least = polished(100, held={0: 30.0}, upper=upper)
    assert found.at_bound == ("K",)
    assert found["K"] == 30.0
    np.testing.assert_allclose(found.values, expected, rtol=1e-6)
    assert found.cost == pytest.approx(least, rel=1e-9)


def test_a_known_parameter_stays_out_of_the_fit():
    base = problem()
    known = Problem(base.model, base.observations, base.prior, {"I": 0.1})
    assert known.names == ("K", "B")
    expected, least = polished(100, held={2: 0.1})
    found = fit(known, SETTING.starts()[:, :2])
    np.testing.assert_allclose(found.values, expected[:2], rtol=1e-6)
    assert found.cost == pytest.approx(least, rel=1e-9)
    np.testing.assert_allclose(known.complete(found.values), expected, rtol=1e-6)
    whole = base.hessian(known.complete(found.values))
    np.testing.assert_allclose(known.hessian(found.values), whole[:2, :2], rtol=1e-8)


def test_unknown_names_are_refused():
    base = problem()
    with pytest.raises(InputError, match=r"found fixed parameters \['J'\], expected some of"):
        Problem(base.model, base.observations, base.prior, {"J": 0.1})
    with pytest.raises(InputError, match="found bounds for 'J', expected one of"):
        Prior.physical(KBI(), J=(0.0, 1.0))
    with pytest.raises(InputError, match="expected lower < upper"):
        Prior.physical(KBI(), K=(3.0, 2.0))
    with pytest.raises(InputError, match="expected one of"):
        measured_problem(SETTING, Impulse(), 0.1, reading="sharp")
    with pytest.raises(InputError, match="expected a number above 0"):
        Setting(32.0, -3.2, 100.0)


def test_torque_and_angle_driven_records_do_not_mix():
    time = np.linspace(0, 0.1, 101)
    drives = [Impulse().drive(time), imposed_motion(time, np.zeros(101))]
    observations = [observe(d, np.zeros(101), Noise(1.0)) for d in drives]
    with pytest.raises(InputError, match="driven alike"):
        Problem(KBI(), observations, Prior.physical(KBI()))


# Curvature


@pytest.mark.parametrize("ms", WINDOWS)
def test_hessian_is_that_of_differences(ms):
    x = optimum(ms).values
    size = np.array([50.0, 1.0, 0.1])

    def gradient(point):
        return central_difference(lambda y: cost(y, ms), point, size, 1e-3)

    expected = central_difference(gradient, x, size, 1e-3) * np.outer(size, size)
    found = curvature(problem(ms), x)
    agree(found.hessian * np.outer(size, size), expected, 1e-5)
    # Its weakest direction, which sets the widths, to the same accuracy.
    np.testing.assert_allclose(
        np.linalg.eigvalsh(found.hessian * np.outer(size, size)),
        np.linalg.eigvalsh(expected),
        rtol=1e-4,
    )
    np.testing.assert_allclose(found.slice_sd, np.diag(found.hessian) ** -0.5)


@pytest.mark.parametrize("ms", WINDOWS)
def test_hessian_is_that_of_automatic_differentiation(ms):
    one, x = problem(ms), optimum(ms).values
    (seen,) = one.observations

    def negative_log_likelihood(x):
        rest = exact_response(one.model, x, drive_arrays(seen.drive)) - seen.measured
        white = seen.scale * (rest - seen.carry * rest[seen.previous])
        return 0.5 * white @ white

    expected = np.asarray(jax.jit(jax.jacfwd(jax.jacfwd(negative_log_likelihood)))(x))
    unit = np.sqrt(np.diag(expected))
    agree(one.hessian(x) / np.outer(unit, unit), expected / np.outer(unit, unit), 1e-10)


def test_a_quick_fit_ends_where_the_thorough_one_does():
    found = explore(problem(50), optimum(50).values[None] * 1.3, evaluations=60)
    np.testing.assert_allclose(found.values, optimum(50).values, rtol=1e-3)


def test_starts_that_descend_side_by_side_end_where_they_end_alone():
    starts = optimum(50).values * np.array([[1.3], [0.5], [3.0], [0.8]])
    together = explore(problem(50), starts, evaluations=12)
    alone = [explore(problem(50), start[None], evaluations=12) for start in starts]
    np.testing.assert_array_equal(together.costs, [fit.costs[0] for fit in alone])
    np.testing.assert_array_equal(together.reached, [fit.reached[0] for fit in alone])


def test_a_quick_fit_ends_on_the_bound_that_it_is_pushed_to():
    exact = problem(50)
    floor = 1.5 * optimum(50).values[1]
    bounded = replace(exact, prior=Prior.physical(KBI(), B=(floor, 50.0)))
    found = explore(bounded, np.array([[50.0, 2.0, 0.1]]), evaluations=60)
    assert found.values[1] == floor
    assert found.at_bound == ("B",)


def test_gauss_newton_lacks_the_curvature_of_the_model():
    x, size = optimum(200).values, np.array([50.0, 1.0, 0.1])
    found = curvature(problem(200), x)
    jacobian = central_difference(lambda y: whitened(y, 200), x, size, 1e-4)
    unit = np.outer(size, size)
    agree(found.gauss_newton * unit, jacobian.T @ jacobian * unit, 1e-7)

    def slopes(point):
        return central_difference(lambda y: whitened(y, 200), point, size, 1e-3)

    second = np.einsum("n,nij->ij", whitened(x, 200), central_difference(slopes, x, size, 1e-3))
    agree((found.hessian - found.gauss_newton) * unit, second * unit, 1e-4)
    # It matters here, and it does not where the model can fit.
    assert np.abs(found.hessian / found.gauss_newton - 1).max() > 0.05
    able = Problem(
        KBI(),
        [observe(Impulse().drive(target(200)[0]), kbi_impulse(target(200)[0], *x), Noise(1e-3))],
        Prior.physical(KBI()),
    )
    shape = curvature(able, x)
    np.testing.assert_allclose(shape.hessian, shape.gauss_newton, rtol=1e-6)
    np.testing.assert_allclose(shape.sandwich_covariance, shape.covariance, rtol=1e-4)


@pytest.mark.parametrize("ms", WINDOWS)
def test_one_posterior_sd_is_the_papers_largest_change(ms):
    """Contour reading: sqrt(v' cov v) along v_min is the length of Eq. 15."""
    x, size = optimum(ms).values, np.array([50.0, 1.0, 0.1])
    _, measured = target(ms)

    def error(point):
        return 2 * DE * cost(point, ms)

    assert error(x) == pytest.approx(
        np.sum((kbi_impulse(target(ms)[0], *x) - measured) ** 2) / np.sum(measured**2), rel=1e-9
    )

    def gradient(point):
        return central_difference(error, point, size, 1e-3)

    hessian = central_difference(gradient, x, size, 1e-3)
    change = largest_change(hessian, DE)
    assert change[0] >= 0
    assert 0.5 * change @ hessian @ change == pytest.approx(DE, rel=1e-9)
    direction = change / np.linalg.norm(change)
    covariance = curvature(problem(ms), x).covariance
    assert np.sqrt(direction @ covariance @ direction) == pytest.approx(
        np.linalg.norm(change), rel=1e-4
    )
    np.testing.assert_allclose(
        change, largest_change(2 * DE * curvature(problem(ms), x).hessian, DE), rtol=1e-4
    )


def test_a_hessian_without_a_minimum_gives_no_width():
    shape = curvature(problem(), np.array([300.0, 0.1, 0.05]))
    assert np.linalg.eigvalsh(shape.hessian)[0] < 0
    assert np.isnan(shape.covariance).all()
    assert np.all(shape.slice_sd[np.diag(shape.hessian) <= 0] == np.inf)


# The paper's criterion


@pytest.mark.parametrize(
    ("values", "ms", "expected", "error"),
    [
        ((32.0, 3.2, 100.0), 50, (54.98, 0.355, 0.0986), 7.0e-7),
        ((32.0, 3.2, 100.0), 100, (38.28, 0.809, 0.0941), 2.4e-5),
        ((32.0, 10.0, 320.0), 100, (96.05, 3.051, 0.0739), 5.12e-3),
    ],
)
def test_error_criterion(values, ms, expected, error):
    setting = Setting(*values)
    criterion = error_problem(setting, Impulse(), ms / 1000)
    found = fit(criterion, setting.starts())
    np.testing.assert_allclose(found.values, expected, rtol=2e-3)
    assert 2 * found.cost == pytest.approx(error, rel=0.02)
    K_CE, B_CE, K_SE = values
    system = msm_transfer(K_CE, B_CE, 0.1, K_SE)

    def by_quad(x):
        def squares(t):
            true = impulse_by_residues(system, np.array(t))
            return np.array([(kbi_impulse(t, *x) - true) ** 2, true**2])

        integrals = scipy.integrate.quad_vec(squares, 0, ms / 1000, epsabs=0, epsrel=1e-12)[0]
        return integrals[0] / integrals[1]

    elsewhere = found.values * [1.1, 0.9, 1.02]
    for x in (found.values, elsewhere):
        twice = np.sum(criterion.residuals(x) ** 2)
        assert twice == pytest.approx(by_quad(x), rel=1e-5)


# Conditional optima and profiles


@pytest.mark.parametrize("ms", [100, 200])
@pytest.mark.parametrize("held", [(0,), (1,), (2,), (0, 1), (0, 2)])
def test_conditional_optima_are_those_of_scipy(held, ms):
    best = optimum(ms).values
    points = np.tile(best, (4, 1))
    for position in held:
        points[:, position] *= np.array([0.6, 0.9, 1.1, 1.5])
    found = conditional_optima(problem(ms), held, points)
    for i, point in enumerate(points):
        expected, least = polished(ms, held={j: point[j] for j in held}, start=best)
        assert np.array_equal(found.points[i, list(held)], point[list(held)])
        assert -found.log_likelihood[i] == pytest.approx(least, abs=1e-6)
        np.testing.assert_allclose(found.points[i] / best, expected / best, atol=1e-3)
        jacobian = problem(ms).jacobian(found.points[i])
        residuals = problem(ms).residuals(found.points[i])
        agree(found.information[i], jacobian.T @ jacobian, 1e-8)
        size = np.sqrt(np.diag(jacobian.T @ jacobian))
        gradient = jacobian.T @ residuals
        np.testing.assert_allclose(found.gradient[i] / size, gradient / size, atol=1e-7)


@pytest.mark.parametrize(("ms", "name"), [(100, "K"), (100, "B"), (200, "I")])
def test_profile_is_that_of_brute_force(ms, name):
    best, index = optimum(ms), "KBI".index(name)
    result = profile(problem(ms), best.values, name)
    top = cost(best.values, ms)

    def drop(value):
        return polished(ms, held={index: value}, start=best.values)[1] - top

    width = curvature(problem(ms), best.values).covariance[index, index] ** 0.5
    for level, depth in DROPS.items():
        for end, side, bound in zip(
            result.intervals[level],
            result.sides[level],
            (problem(ms).lower[index], problem(ms).upper[index]),
            strict=True,
        ):
            if side == "bound":
                assert end == bound
                assert drop(max(bound, 1e-9)) < depth
                continue
            assert side == "closed"
            far = best.values[index] + 1.3 * (end - best.values[index])
            expected = scipy.optimize.brentq(
                lambda v, depth=depth: drop(v) - depth, best.values[index], far, xtol=1e-7 * width
            )
            assert abs(end - expected) < 2e-3 * width
    assert result.half_width == pytest.approx(np.diff(result.intervals["68"])[0] / 2)
    assert not result.improved
    assert np.all(np.diff(result.values) >= 0)
    # Every point of the path is what it says it is.
    some = slice(None, None, max(1, len(result.values) // 6))
    for path, fell in zip(result.paths[some], result.drops[some], strict=True):
        assert cost(path, ms) - top == pytest.approx(fell, abs=1e-7)
        assert drop(path[index]) == pytest.approx(fell, abs=1e-5 + 1e-4 * fell)


def test_drops_are_quantiles_of_chi_squared():
    half = scipy.stats.chi2.ppf([scipy.stats.chi2.cdf(1, 1), 0.95], 1) / 2
    np.testing.assert_allclose([DROPS["68"], DROPS["95"]], half, rtol=1e-4)


def test_profile_cut_by_a_bound_says_so():
    result = profile(problem(50), optimum(50).values, "K")
    assert result.sides["95"] == ("bound", "closed")
    assert result.intervals["95"][0] == 0.0
    # Where B is largest, K has run into its bound.
    assert "K" in profile(problem(50), optimum(50).values, "B").pinned


def test_a_parameter_without_bounds_may_stay_open():
    """With the torque of an inertia alone nothing is learnt about an MSM's tendon."""
    model = KBI() + SeriesTendon()
    time = np.linspace(0, 0.1, 101)
    drive = Impulse().drive(time)
    values = model.vector({"K": 32.0, "B": 3.2, "I": 0.1, "series_tendon.stiffness": 20000.0})
    prior = Prior.physical(model, **{"series_tendon.stiffness": (1.0, 1e7)})
    measured = kbi_impulse(time, 32.0, 3.2, 0.1)
    noise = matched_noise(measured, "contour")
    base = Problem(
        model,
        [observe(drive, measured, noise)],
        prior,
        plain_values(model) | {"K": 32.0, "B": 3.2, "I": 0.1},
    )
    result = profile(base, values[3:4], "series_tendon.stiffness")
    assert result.sides["95"][0] == "closed"
    assert result.sides["95"][1] in {"bound", "open"}


# Quadrature


@cache
def moments(ms):
    return quadrature(problem(ms), optimum(ms).values)


@pytest.mark.parametrize("ms", WINDOWS)
def test_quadrature_is_that_of_a_dense_rule_elsewhere(ms):
    found = moments(ms)
    np.testing.assert_allclose(found.mean, MEANS[ms], rtol=5e-4)
    np.testing.assert_allclose(found.sd, SDS[ms], rtol=5e-4)
    assert found.log_evidence == pytest.approx(LOG_EVIDENCE[ms], abs=1e-3)
    correlation = found.covariance / np.outer(found.sd, found.sd)
    pairs = correlation[[0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(pairs, CORRELATIONS[ms], atol=2e-3)
    assert found.error < 5e-3


def dense(log_density, low, high, nodes):
    """Means, sds and log integral over a box, by a plain tensor rule."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    middle, half = (np.asarray(high) + low) / 2, (np.asarray(high) - low) / 2
    points = np.stack(np.meshgrid(*(m + h * x for m, h in zip(middle, half, strict=True))), -1)
    weights = np.prod(np.stack(np.meshgrid(*(h * w for h in half)), -1), -1).ravel()
    points = points.reshape(-1, middle.size)
    chunks = np.array_split(points, 1 + len(points) // 4000)
    values = np.concatenate([log_density(chunk) for chunk in chunks])
    mass = weights * np.exp(values - values.max())
    mean = mass @ points / mass.sum()
    covariance = (mass[:, None] * (points - mean)).T @ (points - mean) / mass.sum()
    return mean, covariance, np.log(mass.sum()) + values.max()


def test_quadrature_in_three_dimensions():
    best = optimum(100, "energy").values
    found = quadrature(problem(100, "energy"), best)
    # Along the axes of the Hessian, for the posterior is a narrow ridge.
    factor = np.linalg.cholesky(curvature(problem(100, "energy"), best).covariance)

    def log_density(z):
        points = best + z @ factor.T
        inside = np.all((points >= LOWER) & (points <= UPPER), axis=1)
        return np.where(inside, -cost(points, 100, DE / 101), -np.inf)

    mean, covariance, integral = dense(log_density, [-7] * 3, [7] * 3, 40)
    np.testing.assert_allclose(found.mean, best + factor @ mean, rtol=1e-4)
    sd = np.sqrt(np.diag(factor @ covariance @ factor.T))
    np.testing.assert_allclose(found.sd, sd, rtol=1e-4)
    log_evidence = integral + np.linalg.slogdet(factor)[1] - np.log(UPPER - LOWER).sum()
    assert found.log_evidence == pytest.approx(log_evidence, abs=1e-3)


def test_quadrature_in_two_dimensions():
    base = problem()
    known = Problem(base.model, base.observations, base.prior, {"I": 0.1})
    found = quadrature(known, fit(known, SETTING.starts()[:, :2]).values)

    def log_density(points):
        return -cost(np.insert(points, 2, 0.1, axis=1), 100)

    mean, covariance, integral = dense(log_density, [0.0, 0.0], [80.0, 4.0], 200)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-4)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-3)
    assert found.log_evidence == pytest.approx(integral - np.log(2000 * 50), abs=1e-4)


def test_quadrature_in_one_dimension():
    base = problem()
    known = Problem(base.model, base.observations, base.prior, {"I": 0.1, "B": 0.6})
    found = quadrature(known, fit(known, np.array([[40.0]])).values)

    def log_density(points):
        return -cost(np.insert(points, [1, 1], [0.6, 0.1], axis=1), 100)

    mean, covariance, integral = dense(log_density, [0.0], [200.0], 400)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-6)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6)
    assert found.log_evidence == pytest.approx(integral - np.log(2000), abs=1e-6)


def test_quadrature_is_for_three_parameters_at_most():
    model = KBI() + SeriesTendon()
    fixed = plain_values(model)
    base = Problem(model, problem().observations, Prior.physical(model), fixed)
    with pytest.raises(InputError, match="takes one to three free parameters, found 4"):
        quadrature(
            base, base.free_vector(dict(zip(model.parameter_names, model.nominal, strict=True)))
        )


# Noise


def correlated(n, noise, gaps=None):
    times = np.arange(n) * 1e-3 if gaps is None else gaps * 1e-3
    lags = np.abs(times[:, None] - times)
    return noise.sd**2 * np.exp(-lags / noise.correlation_time)


TIME_100 = np.arange(101) * 1e-3
COLOURED = Noise(0.03, 0.004)
POINT = np.array([40.0, 1.0, 0.09])


def coloured_problem(**options):
    drive = Impulse().drive(TIME_100)
    observation = observe(drive, target(100)[1], COLOURED, **options)
    return Problem(KBI(), [observation], Prior.physical(KBI()))


def difference(x):
    return kbi_impulse(TIME_100, *x) - target(100)[1]


def test_whitening_is_that_of_a_dense_covariance():
    factor = np.linalg.cholesky(correlated(101, COLOURED))
    expected = scipy.linalg.solve_triangular(factor, difference(POINT), lower=True)
    np.testing.assert_allclose(coloured_problem().residuals(POINT), expected, rtol=1e-7, atol=1e-9)


def test_whitening_over_gaps():
    select = np.array([2, 3, 4, 10, 11, 30, 31, 32, 33, 90, 100])
    factor = np.linalg.cholesky(correlated(select.size, COLOURED, select))
    expected = scipy.linalg.solve_triangular(factor, difference(POINT)[select], lower=True)
    found = coloured_problem(select=select).residuals(POINT)
    np.testing.assert_allclose(found[select], expected, rtol=1e-7, atol=1e-9)
    assert np.all(np.delete(found, select) == 0)


def test_weights_multiply_squared_residuals():
    weights = np.linspace(0.5, 2, 101)
    drive = Impulse().drive(TIME_100)
    observation = observe(drive, target(100)[1], Noise(0.03), weights=weights)
    found = Problem(KBI(), [observation], Prior.physical(KBI())).residuals(POINT)
    np.testing.assert_allclose(found**2, weights * (difference(POINT) / 0.03) ** 2, rtol=1e-7)


SEGMENTS = (np.arange(5, 95), np.repeat([0, 1], [40, 50]))


def dense_offsets(x, offsets):
    """Whitened residuals of two segments, independent of each other, each with its offset."""
    select, segment = SEGMENTS
    parts = []
    for number, offset in enumerate(offsets):
        chosen = select[segment == number]
        factor = np.linalg.cholesky(correlated(chosen.size, COLOURED, chosen))
        raw = difference(x)[chosen] + offset
        parts.append(scipy.linalg.solve_triangular(factor, raw, lower=True))
    return np.concatenate(parts)


def test_profiled_offsets_are_explicit_ones_at_their_optimum():
    select, segment = SEGMENTS
    found = coloured_problem(select=select, segment=segment)

    def best(x):
        return scipy.optimize.least_squares(lambda c: dense_offsets(x, c), [0.0, 0.0], xtol=1e-15)

    for x in (POINT, POINT * 1.3):
        assert found.log_likelihood(x[None])[0] == pytest.approx(-best(x).cost, rel=1e-8)
        np.testing.assert_allclose(
            found.residuals(x)[select], dense_offsets(x, best(x).x), rtol=1e-6, atol=1e-7
        )
    # The fit, and the widths: the joint Hessian's inverse has the profiled one's as a block.
    size = np.array([50.0, 1.0, 0.1, 1.0, 1.0])
    joint = scipy.optimize.least_squares(
        lambda z: dense_offsets(z[:3] * size[:3], z[3:]),
        [0.8, 0.8, 0.9, 0.0, 0.0],
        jac="3-point",
        ftol=1e-15,
        xtol=1e-15,
        gtol=1e-15,
    )
    fitted = fit(found, SETTING.starts())
    np.testing.assert_allclose(fitted.values, joint.x[:3] * size[:3], rtol=1e-5)
    assert fitted.cost == pytest.approx(joint.cost, rel=1e-8)
    information = joint.jac.T @ joint.jac
    block = np.linalg.inv(information)[:3, :3] * np.outer(size[:3], size[:3])
    shape = curvature(found, fitted.values)
    np.testing.assert_allclose(shape.gauss_newton_covariance, block, rtol=1e-4)


def test_an_offset_in_the_data_does_no_harm():
    select, segment = SEGMENTS
    drive = Impulse().drive(TIME_100)
    shifted = target(100)[1].copy()
    shifted[select[segment == 0]] += 0.2
    shifted[select[segment == 1]] -= 0.1
    observation = observe(drive, shifted, COLOURED, select=select, segment=segment)
    moved = Problem(KBI(), [observation], Prior.physical(KBI()))
    plain = coloured_problem(select=select, segment=segment)
    agree(moved.residuals(POINT), plain.residuals(POINT), 1e-9)


def test_trials_of_different_lengths_add_up():
    short = TIME_100[:51]
    select, segment = SEGMENTS
    long_one = coloured_problem(select=select, segment=segment)
    other = observe(Impulse().drive(short), target(50)[1], Noise(0.02), segment=np.zeros(51, int))
    alone = Problem(KBI(), [other], Prior.physical(KBI()))
    both = Problem(KBI(), [*long_one.observations, other], Prior.physical(KBI()))
    points = POINT * np.random.default_rng(0).uniform(0.5, 2, (20, 3))
    np.testing.assert_allclose(
        both.log_likelihood(points),
        long_one.log_likelihood(points) + alone.log_likelihood(points),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        both.hessian(POINT), long_one.hessian(POINT) + alone.hessian(POINT), rtol=1e-8
    )
    assert both.n_samples == 90 + 51
    assert [r.size for r in both.responses(POINT)] == [101, 51]


def test_readings_of_dE():
    _, response = target(100)
    energy = np.sum(response**2)
    assert matched_noise(response, "contour").sd ** 2 == pytest.approx(1e-3 * energy)
    assert matched_noise(response, "energy").sd ** 2 == pytest.approx(1e-3 * energy / 101)
    # In the energy reading the noise itself has an error E of dE.
    noise = matched_noise(response, "energy").draw(101, 1e-3, seed=1)
    assert np.sum(noise**2) / energy == pytest.approx(1e-3, rel=0.5)
    contour, sharp = problem(100), problem(100, "energy")
    np.testing.assert_allclose(sharp.hessian(POINT), 101 * contour.hessian(POINT), rtol=1e-9)
    np.testing.assert_allclose(optimum(100, "energy").values, optimum(100).values, rtol=1e-6)


def test_drawn_noise_has_the_correlation_it_says():
    series = COLOURED.draw(100_000, 1e-3, seed=5)
    assert series.std() == pytest.approx(COLOURED.sd, rel=0.02)
    rho = np.exp(-1 / 4)
    for lag in (1, 4, 8):
        found = np.mean(series[lag:] * series[:-lag]) / np.mean(series**2)
        assert found == pytest.approx(rho**lag, abs=0.02)
    assert np.array_equal(COLOURED.draw(50, 1e-3, 5), COLOURED.draw(50, 1e-3, 5))
    assert not np.array_equal(COLOURED.draw(50, 1e-3, 5), COLOURED.draw(50, 1e-3, 6))
    # Stationary from the first sample on.
    firsts = [COLOURED.draw(2, 1e-3, seed)[0] for seed in range(2000)]
    assert np.std(firsts) == pytest.approx(COLOURED.sd, rel=0.06)


def test_how_far_correlated_noise_goes_towards_the_contour_reading():
    """Widths of the energy reading under AR(1) noise, over those of the contour reading.

    They grow as sqrt((1 + rho) / (1 - rho)) while the correlation time is short against the
    response, and never reach those of the contour reading, for no correlation matrix of n samples
    has an eigenvalue above n. Once it is longer than the window the noise is nearly a constant,
    which the response is not, and they shrink again, below those of white noise.
    """
    x = optimum().values
    contour = curvature(problem(), x).gauss_newton

    def ratios(correlation_time):
        coloured = measured_problem(
            SETTING, Impulse(), 0.1, reading="energy", correlation_time=correlation_time
        )
        information = curvature(coloured, x).gauss_newton
        return np.sqrt(scipy.linalg.eigh(contour, information, eigvals_only=True))

    white = ratios(0.0)
    np.testing.assert_allclose(white, 101**-0.5, rtol=1e-6)
    rising = np.array([ratios(t) for t in (0.0, 0.0005, 0.001, 0.002, 0.005, 0.01)])
    assert np.all(np.diff(rising, axis=0) > 0)
    rho = np.exp(-1.0)
    np.testing.assert_allclose(ratios(0.001) / white, np.sqrt((1 + rho) / (1 - rho)), rtol=0.05)
    everywhere = np.array([ratios(t) for t in (0.02, 0.05, 0.1, 0.5, 10.0)])
    assert np.all(everywhere < 1)
    assert everywhere.max() > 0.5
    assert np.all(everywhere[-1] < white)
