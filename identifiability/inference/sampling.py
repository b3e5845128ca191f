"""Posterior samples by emcee, on a ladder of proposals, with the evidence that they converged.

1. A fixed multivariate t from the Laplace approximation, cut to the prior's box.
2. Where importance weights show that this is not the posterior's shape: a pilot run by
   differential evolution, and a mixture of t densities fitted to it.
3. Where that does not fit either: differential evolution itself.

On the first two steps the proposal does not depend on the other walkers, so each walker is an
independent chain. Every run consists of at least four independent ensembles, and convergence is
judged across them: rank-normalised R-hat below 1.01, bulk and tail effective sample sizes of 400.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Literal

import emcee
import numpy as np

from identifiability.inference.curvature import curvature
from identifiability.inference.problem import Problem
from identifiability.inference.proposals import (
    StudentMixture,
    combined,
    efficiency_on_gaussian,
    fitted_mixture,
    laplace_t,
)

Step = Literal["laplace-t", "mixture-t", "differential evolution"]

N_ENSEMBLES = 4
RHAT_LIMIT = 1.01
ESS_LIMIT = 400.0
# What a t reaches on the posterior over what it would on a Gaussian: what is much lower has a
# shape, or a tail, that the t does not know, and walkers that have not met it yet agree with each
# other all the same. In three dimensions, where a Gaussian gives 0.89, this is 0.75.
EFFICIENCY_LIMIT = 0.84

# An optimum this far below the best, in log likelihood, holds no mass that matters.
_NEGLIGIBLE = 15.0
_TRIALS = 8  # points of a proposal to judge it by, for each walker
WALKERS, _STEPS, _BURN = 512, 25, 5
_PILOT_WALKERS, _PILOT_STEPS, _FEW_STEPS = 128, 400, 80
_DE_WALKERS, _DE_STEPS = 64, 2000
_HOPELESS = 0.05  # efficiency from which a short pilot run does not lead to a mixture that fits
_FEWEST_STEPS = 200


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior samples and their diagnostics.

    Attributes
    ----------
    names : tuple of str
    draws : array, shape (n_ensembles, n_draws, k)
        Walker after walker within each ensemble.
    log_probability : array, shape (n_ensembles, n_draws)
    rhat, ess_bulk, ess_tail, sd_mcse : array, shape (k,)
        Across the ensembles; the last is the Monte Carlo error of the standard deviation.
    step : str
        Step of the ladder that was used.
    reason : str
        Why that step, with the figures that decided.
    acceptance : float
        Mean acceptance fraction.
    converged : bool
        Whether R-hat and effective sample sizes meet their limits for every parameter.
    seed : int
    """

    names: tuple[str, ...]
    draws: np.ndarray
    log_probability: np.ndarray
    rhat: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    sd_mcse: np.ndarray
    step: Step
    reason: str
    acceptance: float
    converged: bool
    seed: int

    @property
    def flat(self) -> np.ndarray:
        """All draws, shape (n, k)."""
        return self.draws.reshape(-1, self.draws.shape[-1])

    @property
    def mean(self) -> np.ndarray:
        """Posterior means, shape (k,)."""
        return self.flat.mean(axis=0)

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations, shape (k,)."""
        return self.flat.std(axis=0, ddof=1)

    def interval(self, probability: float) -> np.ndarray:
        """Equal-tailed intervals, shape (2, k)."""
        tail = 0.5 * (1 - probability)
        return np.quantile(self.flat, [tail, 1 - tail], axis=0)


def sample(
    problem: Problem,
    optimum: np.ndarray,
    *,
    seed: int,
    local_optima: np.ndarray | None = None,
    walkers: int = WALKERS,
    effort: float = 1.0,
    evolve: bool = True,
) -> Posterior:
    """Sample the posterior, climbing the ladder of proposals as far as needed.

    Parameters
    ----------
    problem : Problem
    optimum : array, shape (k,)
        Maximum of the posterior, from `fit`.
    seed : int
        Every random number follows from it.
    local_optima : array, shape (n, k), optional
        Where other starts of the fit ended. Those that could hold mass get a component of their
        own in the proposal: no walker would find them from the best one.
    walkers : int
        Number of walkers in each ensemble.
    effort : float
        Factor on the number of steps.
    evolve : bool
        Whether to climb to the last step of the ladder, which takes the longest.

    Returns
    -------
    Posterior
        Its `converged` says whether it may be used.
    """
    seeds = np.random.SeedSequence(seed).spawn(4)
    optimum = np.asarray(optimum, float)
    proposal = _laplace(problem, optimum, local_optima)
    why: list[str] = []
    start, efficiency = _try(problem, proposal, seeds[0], _TRIALS * walkers)
    ideal = efficiency_on_gaussian(len(problem.names), proposal.df)
    # What is spent on other optima cannot serve the best one.
    limit = EFFICIENCY_LIMIT * ideal * float(proposal.weights[0])
    if efficiency >= limit:
        reason = f"the Laplace t reaches an importance efficiency of {efficiency:.2f}"
        result = _independent(
            problem, proposal, start, "laplace-t", reason, seed, seeds[1], walkers, effort
        )
        if result.converged:
            return result
        why.append(f"the Laplace t did not converge (largest R-hat {result.rhat.max():.3f})")
    else:
        why.append(
            f"the Laplace t reaches an importance efficiency of only {efficiency:.2f}, "
            f"below {limit:.2f}"
        )
    if not evolve and efficiency < _HOPELESS:
        # A short run that shows by its own diagnostics that it cannot be used.
        reason = "; ".join([*why, "no pilot run was made at this effort"])
        return _independent(
            problem, proposal, start, "laplace-t", reason, seed, seeds[1], walkers, 0.1 * effort
        )
    pilot = _pilot(problem, start, seeds[2], _PILOT_STEPS if walkers >= WALKERS else _FEW_STEPS)
    mixture = fitted_mixture(
        pilot, problem.lower, problem.upper, seed=int(seeds[2].generate_state(1)[0])
    )
    start, efficiency = _try(problem, mixture, seeds[2].spawn(1)[0], _TRIALS * walkers)
    if efficiency >= EFFICIENCY_LIMIT * ideal / 2 or not evolve:
        reason = "; ".join([*why, f"a mixture fitted to a pilot run reaches {efficiency:.2f}"])
        result = _independent(
            problem, mixture, start, "mixture-t", reason, seed, seeds[1], walkers, effort
        )
        if result.converged or not evolve:
            return result
        why.append(f"the mixture did not converge (largest R-hat {result.rhat.max():.3f})")
    else:
        why.append(f"a mixture fitted to a pilot run reaches only {efficiency:.2f}")
    return _evolution(problem, pilot, "; ".join(why), seed, seeds[3], effort)


def diagnose(
    draws: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rank R-hat, bulk and tail effective sample size, and Monte Carlo error of the sd.

    Parameters
    ----------
    draws : array, shape (n_chains, n_draws, k)
    names : tuple of str

    Returns
    -------
    tuple of four arrays, shape (k,)
    """
    import xarray

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # 0.x announces 1.x at every import
        import arviz

    data = xarray.Dataset(
        {name: (("chain", "draw"), draws[:, :, i]) for i, name in enumerate(names)}
    )

    def column(statistic: xarray.Dataset) -> np.ndarray:
        return np.array([float(statistic[name]) for name in names])

    return (
        column(arviz.rhat(data, method="rank")),
        column(arviz.ess(data, method="bulk")),
        column(arviz.ess(data, method="tail", prob=(0.05, 0.95))),
        column(arviz.mcse(data, method="sd")),
    )


def _laplace(
    problem: Problem, optimum: np.ndarray, local_optima: np.ndarray | None
) -> StudentMixture:
    """Laplace t about the optimum, with smaller ones about other optima that could hold mass."""

    def about(point: np.ndarray) -> StudentMixture:
        hessian = curvature(problem, point).hessian
        return laplace_t(point, hessian, problem.lower, problem.upper)

    modes = [optimum]
    top = float(problem.log_likelihood(optimum[None])[0])
    for point in [] if local_optima is None else local_optima:
        height = float(problem.log_likelihood(point[None])[0])
        size = np.maximum(np.abs(point), 1e-3)
        apart = all(np.max(np.abs(point - mode) / size) > 0.02 for mode in modes)
        if apart and top - _NEGLIGIBLE < height < top - 1e-2:
            modes.append(point)
    shares = [1.0] if len(modes) == 1 else [0.8, *[0.2 / (len(modes) - 1)] * (len(modes) - 1)]
    return combined([about(mode) for mode in modes], shares)


def _state(points: np.ndarray, seed: np.random.SeedSequence) -> emcee.State:
    # Without a state of its own emcee copies numpy's global one, the same in every worker.
    random = np.random.RandomState(np.random.MT19937(seed))
    return emcee.State(points, random_state=random.get_state())


def _try(
    problem: Problem, proposal: StudentMixture, seed: np.random.SeedSequence, n: int
) -> tuple[np.ndarray, float]:
    """Importance-resampled points from the proposal, and its efficiency (Kish, 0 to 1)."""
    random = np.random.RandomState(np.random.MT19937(seed))
    try:
        points = proposal.draw(n, random)
    except RuntimeError:
        return proposal.means[:1].repeat(n, axis=0), 0.0
    log_weights = problem.log_posterior(points) - proposal.log_density(points)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    return points[random.choice(n, n, p=weights)], float(1 / np.sum(weights**2) / n)


def _independent(
    problem: Problem,
    proposal: StudentMixture,
    start: np.ndarray,
    step: Step,
    reason: str,
    seed: int,
    seeds: np.random.SeedSequence,
    walkers: int,
    effort: float,
) -> Posterior:
    """Independence Metropolis-Hastings: every walker is a chain of its own."""

    def propose(coords: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        new = proposal.draw(len(coords), random)
        return new, proposal.log_density(coords) - proposal.log_density(new)

    n_steps = max(2, round(_STEPS * effort))
    chains, scores, accepted = [], [], []
    for member, child in enumerate(seeds.spawn(N_ENSEMBLES)):
        sampler = emcee.EnsembleSampler(
            walkers,
            len(problem.names),
            problem.log_posterior,
            moves=emcee.moves.MHMove(propose),
            vectorize=True,
        )
        first = start[member * walkers : (member + 1) * walkers]
        state = sampler.run_mcmc(_state(first, child), _BURN, skip_initial_state_check=True)
        sampler.reset()
        sampler.run_mcmc(state, n_steps, skip_initial_state_check=True)
        # Walker after walker, so that neighbours in the chain are neighbours in a walker's time.
        chains.append(sampler.get_chain().transpose(1, 0, 2).reshape(-1, len(problem.names)))
        scores.append(sampler.get_log_prob().T.ravel())
        accepted.append(sampler.acceptance_fraction.mean())
    return _judge(problem, chains, scores, step, reason, float(np.mean(accepted)), seed)


def _pilot(
    problem: Problem, start: np.ndarray, seed: np.random.SeedSequence, n_steps: int
) -> np.ndarray:
    """Draws from a short run of differential evolution."""
    sampler = _evolving_sampler(problem, _PILOT_WALKERS)
    first = _scatter(problem, start[:_PILOT_WALKERS], seed)
    sampler.run_mcmc(_state(first, seed), n_steps, skip_initial_state_check=True)
    return sampler.get_chain(discard=n_steps // 2, thin=n_steps // _FEW_STEPS, flat=True)


def _evolution(
    problem: Problem,
    pilot: np.ndarray,
    reason: str,
    seed: int,
    seeds: np.random.SeedSequence,
    effort: float,
) -> Posterior:
    """Differential evolution with snooker updates, from points of the pilot run."""
    n_steps = max(4, round(_DE_STEPS * effort))
    chains, scores, accepted = [], [], []
    for child in seeds.spawn(N_ENSEMBLES):
        pick = np.random.default_rng(child).choice(len(pilot), _DE_WALKERS, replace=False)
        sampler = _evolving_sampler(problem, _DE_WALKERS)
        first = _scatter(problem, pilot[pick], child)
        sampler.run_mcmc(_state(first, child), n_steps, skip_initial_state_check=True)
        # Walkers depend on each other: in time order, one ensemble counts as one chain.
        chain = sampler.get_chain(discard=n_steps // 4)
        chains.append(chain.reshape(-1, len(problem.names)))
        scores.append(sampler.get_log_prob(discard=n_steps // 4).ravel())
        accepted.append(sampler.acceptance_fraction.mean())
    acceptance = float(np.mean(accepted))
    return _judge(
        problem, chains, scores, "differential evolution", reason, acceptance, seed, _DE_WALKERS
    )


def _evolving_sampler(problem: Problem, walkers: int) -> emcee.EnsembleSampler:
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    return emcee.EnsembleSampler(
        walkers, len(problem.names), problem.log_posterior, moves=moves, vectorize=True
    )


def _scatter(problem: Problem, points: np.ndarray, seed: np.random.SeedSequence) -> np.ndarray:
    """Points with repeats moved apart a little: differential evolution needs distinct walkers."""
    size = np.maximum(points.std(axis=0), 1e-6 * np.maximum(np.abs(points.mean(axis=0)), 1e-6))
    noise = np.random.default_rng(seed).standard_normal(points.shape)
    return np.clip(points + 0.05 * size * noise, problem.lower, problem.upper)


def _judge(
    problem: Problem,
    chains: list[np.ndarray],
    scores: list[np.ndarray],
    step: Step,
    reason: str,
    acceptance: float,
    seed: int,
    dependent_walkers: int = 0,
) -> Posterior:
    draws = np.stack(chains)
    rhat, bulk, tail, mcse = diagnose(draws, problem.names)
    long_enough = True
    if dependent_walkers:
        bulk, tail, mcse = _of_dependent_walkers(draws, dependent_walkers, bulk, tail)
        # In a few steps walkers cannot show how slowly they forget where they began.
        long_enough = draws.shape[1] >= _FEWEST_STEPS * dependent_walkers
    # Walkers that start from one point and stay there agree with each other perfectly: as many
    # independent draws as are claimed must at least differ.
    different = np.unique(draws[..., 0]).size
    converged = bool(
        long_enough
        and different >= ESS_LIMIT
        and np.all(rhat < RHAT_LIMIT)
        and np.all(bulk >= ESS_LIMIT)
        and np.all(tail >= ESS_LIMIT)
    )
    return Posterior(
        problem.names,
        draws,
        np.stack(scores),
        rhat,
        bulk,
        tail,
        mcse,
        step,
        reason,
        acceptance,
        converged,
        seed,
    )


def _of_dependent_walkers(
    draws: np.ndarray, walkers: int, bulk: np.ndarray, tail: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Effective sample sizes that count walkers as dependent.

    From the series of ensemble means, whose variance is that of one draw divided by the number of
    draws that each ensemble is worth; the tail's size is lowered in the same proportion.
    """
    n_chains, n, k = draws.shape
    means = draws.reshape(n_chains, n // walkers, walkers, k).mean(axis=2)
    names = tuple(str(i) for i in range(k))
    series = diagnose(means, names)[1]
    worth = draws.reshape(-1, k).var(axis=0) / means.reshape(-1, k).var(axis=0)
    honest = np.minimum(series * worth, bulk)
    sd = draws.reshape(-1, k).std(axis=0)
    return honest, tail * honest / bulk, sd / np.sqrt(2 * honest)
