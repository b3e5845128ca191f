"""Evidence of linear Gaussian models, against covariances written out and against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from identifiability.investigation.unexplained.likeliest import likeliest
from identifiability.investigation.unexplained.linear_gaussian import (
    Columns,
    Posterior,
    TrialNoise,
    log_evidence_slope,
    renewed,
)
from identifiability.investigation.unexplained.terms import Term

SIZES = ((50, 4), (70, 6), (40, 0))  # samples and local weights of each trial
N_COMMON = 3
NOISE = TrialNoise(np.array([0.7, 1.2, 0.9]), 0.3)


@pytest.fixture(scope="module")
def made():
    """Columns, residuals and roots of priors of three trials, drawn at random."""
    rng = np.random.default_rng(0)
    local = [rng.normal(size=size) for size in SIZES]
    common = [rng.normal(size=(n, N_COMMON)) for n, _ in SIZES]
    residuals = [2 * rng.normal(size=n) for n, _ in SIZES]
    roots = [rng.normal(size=(k, k)) for _, k in SIZES]
    return local, common, residuals, roots, rng.normal(size=(N_COMMON, N_COMMON))


@pytest.fixture(scope="module")
def columns(made):
    return [Columns.of(*one) for one in zip(*made[:3], strict=True)]


def log_evidence(*of):
    return log_evidence_slope(*of).value


def covariance(made, noise):
    """Of all residuals, one trial after the other."""
    local, common, _, roots, root = made
    own = [
        sd**2 * toeplitz(noise.rho ** np.arange(len(a))) + a @ r @ r.T @ a.T
        for a, r, sd in zip(local, roots, noise.sds, strict=True)
    ]
    shared = np.vstack(common) @ root
    return block_diag(*own) + shared @ shared.T


def test_evidence_is_that_of_the_whole_covariance(made, columns):
    whole = multivariate_normal(cov=covariance(made, NOISE))
    expected = whole.logpdf(np.concatenate(made[2]))
    assert log_evidence(columns, NOISE, *made[3:]) == pytest.approx(expected, rel=1e-10)


def test_weights_are_those_of_the_whole_covariance(made, columns):
    local, common, residuals, roots, root = made
    gains = np.linalg.solve(covariance(made, NOISE), np.concatenate(residuals))
    posterior = Posterior(columns, NOISE, roots, root)
    assert posterior.common.mean == pytest.approx(root @ root.T @ np.vstack(common).T @ gains)
    ends = np.cumsum([n for n, _ in SIZES])[:-1]
    for a, r, g, found in zip(local, roots, np.split(gains, ends), posterior.local, strict=True):
        assert found.mean == pytest.approx(r @ r.T @ a.T @ g)


def differences(function, at, step=1e-5):
    """Derivatives by every entry of an array, from both sides."""
    out = np.zeros_like(at)
    for place in np.ndindex(*at.shape):
        moved = np.zeros_like(at)
        moved[place] = step
        out[place] = (function(at + moved) - function(at - moved)) / (2 * step)
    return out


def test_derivatives_are_those_of_differences(made, columns):
    roots, root = made[3:]
    found = log_evidence_slope(columns, NOISE, roots, root)

    def by_sds(log_sds):
        return log_evidence(columns, replace(NOISE, sds=np.exp(log_sds)), roots, root)

    def by_rho(rho):
        return log_evidence(columns, replace(NOISE, rho=float(rho[0])), roots, root)

    close = {"rel": 1e-6, "abs": 1e-6}
    assert found.log_sds == pytest.approx(differences(by_sds, np.log(NOISE.sds)), **close)
    assert [found.rho] == pytest.approx(differences(by_rho, np.array([NOISE.rho])), **close)
    expected = differences(lambda r: log_evidence(columns, NOISE, roots, r), root)
    assert found.common == pytest.approx(expected, **close)
    for i, own in enumerate(roots):
        expected = differences(
            lambda r, i=i: log_evidence(columns, NOISE, [*roots[:i], r, *roots[i + 1 :]], root), own
        )
        assert found.local[i] == pytest.approx(expected, **close)


def test_a_step_of_expectation_maximisation_does_not_go_down(made, columns):
    noise, evidences = replace(NOISE, sds=np.array([1e-3, 1.0, 50.0])), []
    for _ in range(6):
        evidences.append(log_evidence(columns, noise, *made[3:]))
        noise = renewed(columns, noise, *made[3:])
    assert np.all(np.diff(evidences) > 0)


def wave(shared, n_trials=2, n=200, *, seed=1):
    """A term of two weights, and trials that hold it, in white noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / n
    own = tuple(
        np.column_stack([np.sin(2 * np.pi * (i + 1) * time), time]) for i in range(n_trials)
    )
    residuals = [3.0 * c[:, 0] - 2.0 * c[:, 1] + 0.5 * rng.standard_normal(n) for c in own]

    def roots(h):
        return [h[0] * np.diag([1.0, h[1]])] * (1 if shared else n_trials)

    bounds = np.log([[1e-3, 1e3], [1e-2, 1e2]])
    start = np.array([1.0, 1.0])
    term = Term("wave", "static", shared, own, None, roots, ("size", "ratio"), start, bounds)
    nothing = np.zeros((n, 0))
    columns = [
        Columns.of(*((nothing, c) if shared else (c, nothing)), r)
        for c, r in zip(own, residuals, strict=True)
    ]

    def both(values):
        made, none = term.roots(values[0]), np.zeros((0, 0))
        return ([none] * n_trials, made[0]) if shared else (made, none)

    return term, columns, both


@pytest.mark.parametrize("shared", [True, False])
def test_what_is_found_is_likeliest(shared):
    """Against a search that knows no slope, from where the first one ended and from elsewhere."""
    term, columns, roots = wave(shared)
    noise = TrialNoise(np.array([5.0, 0.01]), 0.0)
    found = likeliest([term], columns, roots, [term.start], noise)
    assert found.noise.sds == pytest.approx([0.5, 0.5], rel=0.2)
    assert found.log_evidence == pytest.approx(
        log_evidence(columns, found.noise, *roots(found.values)), abs=1e-6
    )

    def cost(x):
        if not 0 <= x[4] < 0.99:
            return np.inf
        return -log_evidence(columns, TrialNoise(np.exp(x[2:4]), x[4]), *roots([np.exp(x[:2])]))

    for start in (
        [*np.log(found.values[0]), *np.log(found.noise.sds), found.noise.rho],
        [0.0, 0.0, 0.0, 0.0, 0.1],
    ):
        other = minimize(cost, start, method="Nelder-Mead", options={"maxfev": 4000})
        assert found.log_evidence > -other.fun - 0.05


def test_shapes_are_held_where_that_is_asked_for():
    term, columns, roots = wave(True)
    noise = TrialNoise(np.array([0.5, 0.5]), 0.0)
    found = likeliest([term], columns, roots, [np.array([0.1, 5.0])], noise, sizes_only=True)
    assert found.values[0][1] == pytest.approx(5.0)
    assert found.values[0][0] > 0.2
