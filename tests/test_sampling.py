"""The sampler against deterministic integration, its repeatability, and whether it owns up."""

import dataclasses

import numpy as np
import pytest
import scipy.stats
import xarray
from cases import SPREAD, Case, fit_of, moments_of, problem_of, seed_of, widths_of

from identifiability.inference import convergence, sampling
from identifiability.inference import problem as problem_module
from identifiability.inference.convergence import diagnose, nested_ratio, rhat_nested
from identifiability.inference.curvature import curvature
from identifiability.inference.proposals import StudentMixture, laplace_t
from identifiability.inference.sampling import sample

# Truncated by a bound and curved, so that a wrong sampler has something to get wrong.
REFERENCE = Case(32, 3.2, 100, 0.1)
GAUSSIAN = Case(32, 3.2, 100, 0.1, "energy")
BENT = Case(32, 3.2, 100, 0.003)  # far from any t


def scores(posterior, moments):
    """Differences from the quadrature, in Monte Carlo errors: of the means, then of the sds."""
    mean_mcse = posterior.sd / np.sqrt(posterior.ess_bulk)
    of_mean = (posterior.mean - moments.mean) / mean_mcse
    of_sd = (posterior.sd - moments.sd) / posterior.sd_mcse
    return np.concatenate([of_mean, of_sd])


def check(posterior, moments):
    """The one check that right samplers pass and the wrong ones below must fail."""
    assert np.all(np.abs(scores(posterior, moments)) < 4)


def drawn(case, seed=None, **options):
    found = fit_of(case)
    seed = seed_of(case) if seed is None else seed
    options = {"local_optima": found.reached} | options
    return sample(problem_of(case), found.values, seed=seed, **options)


# Right


@pytest.mark.parametrize("case", SPREAD, ids=str)
def test_sampler_agrees_with_quadrature(case):
    posterior, moments = widths_of(case).posterior, widths_of(case).moments
    assert posterior.converged
    assert np.all(posterior.sd_mcse < 0.02 * posterior.sd)
    assert moments.error < 0.05
    check(posterior, moments)


STEPS = {
    "laplace-t": (0.25, 1.0),
    # Limits that the proposals of the earlier steps cannot meet.
    "mixture-t": (1.11, 1.0),
    "differential evolution": (2.4, 0.2),
}


@pytest.mark.parametrize("step", STEPS)
def test_every_step_of_the_ladder_agrees_with_quadrature(step, monkeypatch):
    limit, effort = STEPS[step]
    monkeypatch.setattr(sampling, "EFFICIENCY_LIMIT", limit)
    posterior = drawn(REFERENCE, effort=effort)
    assert posterior.step == step
    assert posterior.converged
    check(posterior, moments_of(REFERENCE))
    if step != "laplace-t":
        assert "Laplace t reaches an importance efficiency of only" in posterior.reason


@pytest.mark.parametrize(
    "case",
    [Case(32, 3.2, 100, 0.05, bounded=False), Case(10, 2, 20, 0.05, bounded=False)],
    ids=str,
)
def test_long_tails_are_sampled_or_owned_up_to(case):
    """Without bounds these posteriors reach far beyond the Laplace approximation on one side."""
    for seed in range(2):
        posterior = drawn(case, seed)
        if posterior.converged:
            check(posterior, moments_of(case))


def test_a_box_that_cuts_most_of_the_proposal_off():
    """A cell of the paper's grid: the box holds a twentieth of the Laplace approximation."""
    case = Case(10, 2, 20, 0.05)
    for seed in range(3):
        posterior = drawn(case, seed)
        assert posterior.converged
        check(posterior, moments_of(case))


def test_a_second_mode_is_sampled_when_the_fit_has_met_it():
    """A stiff and hardly damped joint far from the best one holds 1 % of the posterior."""
    case = Case(100, 30, 1000, 0.2)
    assert np.ptp(fit_of(case).reached[:, 0]) > 300
    check(drawn(case), moments_of(case))
    with pytest.raises(AssertionError):
        check(drawn(case, local_optima=None), moments_of(case))


def test_draws_lie_within_the_bounds_and_carry_their_density():
    problem, posterior = problem_of(REFERENCE), drawn(REFERENCE)
    assert np.all(posterior.flat >= problem.lower)
    assert np.all(posterior.flat <= problem.upper)
    some = posterior.draws[2, ::200]
    expected = problem.log_posterior(some)
    np.testing.assert_allclose(posterior.log_probability[2, ::200], expected, rtol=1e-9)
    assert posterior.draws.shape[0] == sampling.N_ENSEMBLES
    assert 0 < posterior.acceptance <= 1
    low, high = posterior.interval(0.9)
    inside = np.mean((posterior.flat >= low) & (posterior.flat <= high), axis=0)
    np.testing.assert_allclose(inside, 0.9, atol=2e-3)


# Repeatable


def test_same_seed_same_bytes_and_numpys_generator_is_left_alone():
    posteriors = []
    for disturbance in (1, 2):
        np.random.seed(disturbance)  # noqa: NPY002 -- the global generator is what is tested
        before = np.random.get_state()  # noqa: NPY002
        posteriors.append(drawn(REFERENCE))
        after = np.random.get_state()  # noqa: NPY002
        assert all(np.array_equal(b, a) for b, a in zip(before, after, strict=True))
    one, other = posteriors
    assert one.draws.tobytes() == other.draws.tobytes()
    assert one.log_probability.tobytes() == other.log_probability.tobytes()


def test_the_pilot_and_differential_evolution_are_repeatable(monkeypatch):
    monkeypatch.setattr(sampling, "EFFICIENCY_LIMIT", 2.4)
    posteriors = []
    for disturbance in (1, 2):
        np.random.seed(disturbance)  # noqa: NPY002
        before = np.random.get_state()[1].tobytes()  # noqa: NPY002
        posteriors.append(drawn(REFERENCE, effort=0.02))
        assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002
    assert posteriors[0].step == "differential evolution"
    assert posteriors[0].draws.tobytes() == posteriors[1].draws.tobytes()


def test_another_seed_gives_other_draws_of_the_same_posterior():
    one = drawn(REFERENCE)
    other = drawn(REFERENCE, one.seed + 1)
    assert not np.array_equal(one.draws, other.draws)
    # Ensembles do not repeat each other either.
    assert not np.array_equal(one.draws[0], one.draws[1])
    error = np.hypot(one.sd_mcse, other.sd_mcse)
    assert np.all(np.abs(one.sd - other.sd) < 4 * error)


# Wrong: what must fail the check above


def test_a_noise_10_percent_too_large_is_noticed():
    louder = dataclasses.replace(GAUSSIAN, dE=1.21 * GAUSSIAN.dE)
    check(drawn(GAUSSIAN), moments_of(GAUSSIAN))
    check(drawn(louder), moments_of(louder))
    with pytest.raises(AssertionError):
        check(drawn(louder), moments_of(GAUSSIAN))


@pytest.mark.parametrize("case", [REFERENCE, GAUSSIAN], ids=str)
def test_a_missing_proposal_ratio_is_noticed(case, monkeypatch):
    check(drawn(case), moments_of(case))
    original = sampling.emcee.moves.MHMove

    def uncorrected(propose):
        return original(lambda coords, random: (propose(coords, random)[0], np.zeros(len(coords))))

    monkeypatch.setattr(sampling.emcee.moves, "MHMove", uncorrected)
    wrong = drawn(case)
    assert wrong.step == "laplace-t"
    # It looks converged to every diagnostic, and is wrong.
    assert wrong.converged
    with pytest.raises(AssertionError):
        check(wrong, moments_of(case))


# Owning up


@pytest.mark.parametrize("effort", [0.004, 0.01])
def test_too_few_steps_do_not_pass_for_convergence(effort, monkeypatch):
    # A handful of steps of dependent walkers cannot show how fast they forget where they began.
    monkeypatch.setattr(sampling, "EFFICIENCY_LIMIT", 2.4)
    posterior = drawn(REFERENCE, effort=effort)
    assert posterior.step == "differential evolution"
    assert not posterior.converged


def test_walkers_that_begin_far_away_do_not_pass_for_convergence(monkeypatch):
    far = np.random.default_rng(0).uniform([800, 30, 0.5], [900, 40, 0.6], (5000, 3))
    monkeypatch.setattr(sampling, "EFFICIENCY_LIMIT", 2.4)
    monkeypatch.setattr(sampling, "_pilot", lambda *_: far)
    posterior = drawn(REFERENCE, effort=0.05)
    assert not posterior.converged
    assert posterior.rhat.max() > convergence.RHAT_LIMIT
    assert posterior.rhat_nested.max() > convergence.RHAT_LIMIT
    assert posterior.ess_bulk.min() < convergence.ESS_LIMIT


def test_walkers_that_stay_where_they_begin_do_not_pass_for_convergence(monkeypatch):
    # A proposal far from the posterior and narrow: a few of its draws outweigh all others, every
    # ensemble begins at one of them, and hardly a walker is ever moved.
    problem, best = problem_of(GAUSSIAN), fit_of(GAUSSIAN).values
    off = laplace_t(
        best * 1.2, 1e6 * curvature(problem, best).hessian, problem.lower, problem.upper
    )
    monkeypatch.setattr(sampling, "_laplace", lambda *_: off)
    # How far apart the ensembles begin is chance: the middle of five.
    posteriors = [drawn(GAUSSIAN, seed, quick=True) for seed in range(1, 6)]
    assert np.median([posterior.rhat_nested.min() for posterior in posteriors]) > 2
    assert not any(posterior.converged for posterior in posteriors)


def test_a_response_that_takes_long_is_sampled_by_few_draws_that_own_up_to_it(monkeypatch):
    usual = drawn(BENT, quick=True)
    assert usual.step == "mixture-t"
    monkeypatch.setattr(problem_module, "_LONG", 0)
    monkeypatch.setattr(sampling, "_pilot", None)
    few = drawn(BENT, quick=True)
    assert "one response takes long" in few.reason
    assert few.draws.size < 0.2 * usual.draws.size
    assert not few.converged
    # At full effort there is no such limit: then it would have to make a pilot run.
    with pytest.raises(TypeError, match="not callable"):
        drawn(BENT)


def narrow_run(begin_apart):
    """Ensembles under a proposal 24 times too narrow, from one point or from points of their own.

    Returns the posterior and its sd in that of the quadrature.
    """
    problem, best = problem_of(GAUSSIAN), fit_of(GAUSSIAN).values
    hessian = 24.0**2 * curvature(problem, best).hessian
    proposal = laplace_t(best, hessian, problem.lower, problem.upper)
    seeds = np.random.SeedSequence(0).spawn(2)
    start = sampling._try(problem, proposal, seeds[0], 4096)
    if not begin_apart:
        start = start._replace(apart=best[None].repeat(sampling.N_ENSEMBLES, axis=0))
    budget = sampling._Budget(walkers=512, most_steps=25)
    found = sampling._independent(problem, proposal, start, "laplace-t", "", 0, seeds[1], budget)
    return found, found.sd / moments_of(GAUSSIAN).sd


def test_an_sd_six_times_too_small_does_not_pass_for_convergence():
    fooled, share = narrow_run(begin_apart=False)
    assert np.all(share < 1 / 6)
    # From one point everything agrees: which is why each ensemble begins at a point of its own.
    assert fooled.rhat.max() < convergence.RHAT_LIMIT
    assert min(fooled.ess_bulk.min(), fooled.ess_tail.min()) > convergence.ESS_LIMIT
    caught, _ = narrow_run(begin_apart=True)
    assert caught.rhat_nested.min() > 1.1
    assert not caught.converged
    assert any("nested R-hat" in reason for reason in caught.unmet)
    # The control: the right proposal, from points of their own.
    right = drawn(GAUSSIAN)
    assert right.step == "laplace-t"
    assert right.rhat_nested.max() < 1.001
    assert right.unmet == ()


def test_the_smallest_effort_still_takes_a_step():
    assert drawn(REFERENCE, effort=1e-3).draws.shape[1] > 0


def test_failed_steps_are_named(monkeypatch):
    monkeypatch.setattr(convergence, "RHAT_LIMIT", 0.5)
    posterior = drawn(REFERENCE, effort=0.04)
    assert posterior.step == "differential evolution"
    assert "the Laplace t did not converge" in posterior.reason
    assert "the mixture did not converge" in posterior.reason
    assert not posterior.converged


# The proposal


def test_proposal_density_is_that_of_scipy():
    problem, best = problem_of(GAUSSIAN), fit_of(GAUSSIAN).values
    hessian = curvature(problem, best).hessian
    proposal = laplace_t(best, hessian, problem.lower, problem.upper)
    shape = np.linalg.inv(hessian)
    np.testing.assert_allclose(proposal.factors[0] @ proposal.factors[0].T, shape, rtol=1e-6)
    points = proposal.draw(500, np.random.RandomState(0))
    expected = scipy.stats.multivariate_t(best, shape, df=5).logpdf(points)
    np.testing.assert_allclose(proposal.log_density(points), expected, rtol=1e-6)


def test_proposal_of_several_components():
    rng = np.random.default_rng(0)
    factors = np.stack([np.tril(rng.uniform(0.5, 1.5, (2, 2))) for _ in range(3)])
    weights, means = np.array([0.2, 0.5, 0.3]), rng.normal(size=(3, 2))
    wide = np.full(2, 1e9)
    mixture = StudentMixture(weights, means, factors, 8.0, -wide, wide)
    points = rng.normal(size=(50, 2))
    parts = [
        w * scipy.stats.multivariate_t(m, f @ f.T, df=8).pdf(points)
        for w, m, f in zip(weights, means, factors, strict=True)
    ]
    np.testing.assert_allclose(np.exp(mixture.log_density(points)), np.sum(parts, axis=0))
    sampled = mixture.draw(200_000, np.random.RandomState(0))
    np.testing.assert_allclose(sampled.mean(axis=0), weights @ means, atol=0.02)


def test_a_proposal_keeps_to_its_box():
    eye = np.eye(2)[None]
    box = StudentMixture(
        np.ones(1), np.zeros((1, 2)), eye, 5.0, np.array([0.0, -1.0]), np.array([3.0, 2.0])
    )
    points = box.draw(20_000, np.random.RandomState(0))
    assert np.all((points >= box.lower) & (points <= box.upper))
    # Cut, not clipped: the share above a level is that of the density inside.
    t = scipy.stats.multivariate_t(np.zeros(2), np.eye(2), df=5)
    whole = t.cdf([3.0, 2.0], lower_limit=[0.0, -1.0])
    part = t.cdf([3.0, 2.0], lower_limit=[1.0, -1.0])
    assert np.mean(points[:, 0] > 1) == pytest.approx(part / whole, abs=0.015)


# Diagnostics on chains whose properties are known


def autoregressive(rho, chains=4, draws=10_000, seed=0):
    shocks = np.random.default_rng(seed).standard_normal((chains, draws)) * np.sqrt(1 - rho**2)
    chain = np.empty_like(shocks)
    chain[:, 0] = shocks[:, 0] / np.sqrt(1 - rho**2)
    for i in range(1, draws):
        chain[:, i] = rho * chain[:, i - 1] + shocks[:, i]
    return chain


def rank_rhat(chains):
    """Rank-normalised split R-hat, the larger of bulk and folded (Vehtari et al. 2021)."""
    half = chains.shape[1] // 2
    split = np.concatenate([chains[:, :half], chains[:, -half:]])

    def normal_scores(x):
        ranks = scipy.stats.rankdata(x).reshape(x.shape)
        return scipy.stats.norm.ppf((ranks - 0.375) / (x.size + 0.25))

    def plain(x):
        within = x.var(axis=1, ddof=1).mean()
        between = x.mean(axis=1).var(ddof=1)
        return np.sqrt(((half - 1) / half * within + between) / within)

    folded = np.abs(split - np.median(split))
    return max(plain(normal_scores(split)), plain(normal_scores(folded)))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_diagnostics_of_autoregressive_chains(rho):
    chains = autoregressive(rho)
    rhat, bulk, tail, mcse = (float(x[0]) for x in diagnose(chains[:, :, None]))
    assert rhat == pytest.approx(rank_rhat(chains), abs=1e-6)
    assert rhat < 1.01
    assert bulk == pytest.approx(chains.size * (1 - rho) / (1 + rho), rel=0.1)
    assert tail < 1.3 * chains.size
    # Squares of the chain have the autocorrelation rho².
    squares = chains.size * (1 - rho**2) / (1 + rho**2)
    assert mcse == pytest.approx(np.sqrt(1 / (2 * squares)), rel=0.15)


def test_diagnostics_of_chains_that_disagree():
    apart = autoregressive(0.5)
    apart[0] += 1.0
    wider = autoregressive(0.5)
    wider[0] *= 2.0
    rhat, bulk, _, _ = diagnose(np.stack([apart, wider], axis=-1))
    np.testing.assert_allclose(rhat, [rank_rhat(apart), rank_rhat(wider)], atol=1e-6)
    assert np.all(rhat > 1.03)
    assert bulk[0] < 100


def test_diagnostics_are_those_of_arviz():
    import arviz

    chains = np.stack([autoregressive(0.3, draws=500), autoregressive(0.8, draws=500)], axis=-1)
    names = ("one", "two")
    data = xarray.Dataset({n: (("chain", "draw"), chains[..., i]) for i, n in enumerate(names)})
    rhat, bulk, tail, mcse = diagnose(chains)
    for i, name in enumerate(names):
        assert rhat[i] == float(arviz.rhat(data)[name])
        assert bulk[i] == float(arviz.ess(data)[name])
        assert tail[i] == float(arviz.ess(data, method="tail", prob=(0.05, 0.95))[name])
        assert mcse[i] == float(arviz.mcse(data, method="sd")[name])


# Nested R-hat, on ensembles whose properties are known


def test_nested_rhat_of_a_case_worked_by_hand():
    beat = np.array([-1.0, 1.0, -1.0, 1.0])
    x = beat + np.array([[[0.0], [2.0]], [[4.0], [6.0]]])
    # Within: 4/3 in a walker's time and 2 between walkers; between the ensembles' means 8.
    assert nested_ratio(x) == pytest.approx(np.sqrt(1 + 8 / (4 / 3 + 2)))
    assert nested_ratio(x[:, :, :1]) == pytest.approx(np.sqrt(1 + 8 / 2))
    assert nested_ratio(x[:, :1]) == pytest.approx(np.sqrt(1 + 8 / (4 / 3)))
    assert nested_ratio(np.zeros((2, 2, 4))) == np.inf


def test_nested_rhat_is_one_of_ranks():
    x = np.random.default_rng(0).standard_normal((4, 32, 8))
    both = rhat_nested(np.stack([x, np.exp(3 * x)], axis=-1))
    squares = np.abs(x - np.median(x))
    assert both[0] == pytest.approx(max(nested_ratio(x), nested_ratio(squares)), abs=0.01)
    # Folding is about the median, which the exponential distorts; ranks are the same.
    assert both[1] < 1.01
    assert rhat_nested(np.stack([2 * x - 5], axis=-1))[0] == pytest.approx(both[0], abs=1e-9)


def wandering(rng, begin, step, steps, walkers=128):
    """Random walks on a standard normal: four ensembles, each from one point; the last 25 steps."""
    x = np.repeat(begin[:, None], walkers, axis=1)
    kept = []
    for _ in range(steps):
        new = x + step * rng.standard_normal(x.shape)
        accept = np.log(rng.uniform(size=x.shape)) < 0.5 * (x**2 - new**2)
        x = np.where(accept, new, x)
        kept.append(x)
    return np.stack(kept[-25:], axis=-1)


def test_many_short_chains_that_have_not_left_their_start_are_caught():
    rng = np.random.default_rng(3)
    for _ in range(20):
        own = rng.standard_normal(4)
        # Forty steps of 0.03: ensembles a sixth as wide as the normal that they walk on.
        caught = wandering(rng, own, 0.03, 40)
        assert np.mean(caught.std(axis=(1, 2))) < 1 / 6
        assert rhat_nested(caught[..., None])[0] > 1.1
        # The controls: walks that have forgotten where they began, and exact draws.
        assert rhat_nested(wandering(rng, own, 2.4, 60)[..., None])[0] < convergence.RHAT_LIMIT
        exact = rng.standard_normal((4, 128, 25, 1))
        assert rhat_nested(exact)[0] < convergence.RHAT_LIMIT
    # From one point the same walks agree, and are just as wrong.
    fooled = wandering(rng, np.zeros(4), 0.03, 40)
    assert np.mean(fooled.std(axis=(1, 2))) < 1 / 6
    assert rhat_nested(fooled[..., None])[0] < convergence.RHAT_LIMIT


def test_walkers_that_depend_on_each_other_need_no_other_limit():
    """Common wander makes an ensemble worth less: nested R-hat grows as the mean's variance."""
    rng = np.random.default_rng(5)
    own, common = rng.standard_normal((40, 4, 64, 25)), rng.standard_normal((40, 4, 1, 1))
    ratios = [nested_ratio(x) for x in own + 0.2 * common]
    # Ensembles worth 25 draws each, on average over the ensembles' own chance.
    assert np.mean(np.square(ratios)) - 1 == pytest.approx(0.04, rel=0.3)


# Calibration of the Monte Carlo errors, over many seeds


@pytest.mark.long
@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("case", [REFERENCE, GAUSSIAN], ids=str)
def test_monte_carlo_errors_are_calibrated(case, step, monkeypatch):
    limit, effort = STEPS[step]
    monkeypatch.setattr(sampling, "EFFICIENCY_LIMIT", limit)
    runs = [scores(drawn(case, seed, effort=effort), moments_of(case)) for seed in range(20)]
    spread = np.sqrt(np.mean(np.square(runs), axis=0))
    assert np.all(spread < 1.6)
    assert np.all(spread > 0.4)
    assert np.all(np.abs(np.mean(runs, axis=0)) < 1.0)


GRID = [
    (K_CE, B_CE, factor * K_CE)
    for K_CE in (10.0, 100.0, 200.0)
    for B_CE in (2.0, 16.0, 30.0)
    for factor in (2, 5, 10)
]


@pytest.mark.long
@pytest.mark.parametrize("values", GRID, ids=str)
@pytest.mark.parametrize("window", [0.05, 0.1, 0.2])
def test_sampler_agrees_with_quadrature_over_the_papers_grid(values, window):
    for reading in ("contour", "energy"):
        case = Case(*values, window, reading)
        posterior = drawn(case)
        assert posterior.converged
        # A thousand comparisons: a wider margin than elsewhere.
        assert np.all(np.abs(scores(posterior, moments_of(case))) < 5)
