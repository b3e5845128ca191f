"""Posterior samples by emcee, on a ladder of proposals, with the evidence that they converged.

1. A fixed multivariate t from the Laplace approximation, cut to the prior's box.
2. Where importance weights show that this is not the posterior's shape: a pilot run by
   differential evolution, and a mixture of t densities fitted to it.
3. Where that does not fit either: differential evolution itself.

On the first two steps the proposal does not depend on the other walkers, so each walker is an
independent chain. Every run consists of four independent ensembles, each of which begins at a
point of its own, and convergence is judged across them: see `convergence`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import emcee
import numpy as np

from identifiability.inference.convergence import convergence
from identifiability.inference.curvature import curvature
from identifiability.inference.modes import modes_of
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
# What a t reaches on the posterior over what it would on a Gaussian: what is much lower has a
# shape, or a tail, that the t does not know, and walkers that have not met it yet agree with each
# other all the same. In three dimensions, where a Gaussian gives 0.89, this is 0.75.
EFFICIENCY_LIMIT = 0.84

_TRIALS = 8  # points of a proposal to judge it by, for each walker
_WALKERS, _FEW_WALKERS, _STEPS = 512, 64, 25
# All walkers of an ensemble begin at one point, and the burn-in must take them away from it: all
# but so many, if they are accepted as often as the proposal is efficient.
_LEFT, _LEAST_BURN, _MOST_BURN = 1e-4, 4, 10
_WORTH = 0.5  # effective draws that a draw is expected to be worth, before any is seen
_PILOT_WALKERS, _PILOT_STEPS, _FEW_STEPS = 128, 400, 80
_DE_WALKERS, _DE_STEPS = 64, 2000
_CLOUD = 0.1  # extent of an ensemble that begins to evolve, in that of the pilot run
_HOPELESS = 0.05  # efficiency from which a short pilot run does not lead to a mixture that fits


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior samples and their diagnostics.

    Attributes
    ----------
    names : tuple of str
    draws : array, shape (n_ensembles, n_draws, k)
        Walker after walker within each ensemble where they are independent, else in time order.
    log_probability : array, shape (n_ensembles, n_draws)
    rhat, rhat_nested, ess_bulk, ess_tail, sd_mcse : array, shape (k,)
        Across the ensembles: see `Convergence`.
    unmet : tuple of str
        Every limit of convergence that is not met, with the figure.
    step : str
        Step of the ladder that was used, or the name of another sampler.
    reason : str
        Why that step, with the figures that decided.
    acceptance : float
        Mean acceptance fraction.
    seed : int
    """

    names: tuple[str, ...]
    draws: np.ndarray
    log_probability: np.ndarray
    rhat: np.ndarray
    rhat_nested: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    sd_mcse: np.ndarray
    unmet: tuple[str, ...]
    step: str
    reason: str
    acceptance: float
    seed: int

    @classmethod
    def judged(
        cls,
        names: tuple[str, ...],
        draws: np.ndarray,
        log_probability: np.ndarray,
        *,
        independent: bool,
        step: str,
        reason: str,
        acceptance: float,
        seed: int,
    ) -> Posterior:
        """Posterior with its diagnostics, from the draws of any sampler.

        Parameters
        ----------
        names : tuple of str
        draws : array, shape (n_ensembles, n_walkers, n_steps, k)
            Ensembles that know nothing of each other, each begun at a point of its own.
        log_probability : array, shape (n_ensembles, n_walkers, n_steps)
        independent : bool
            Whether the walkers of an ensemble move independently of each other.
        step, reason, acceptance, seed
            See `Posterior`.
        """
        found = convergence(draws, names, independent=independent)
        if not independent:
            draws, log_probability = draws.swapaxes(1, 2), log_probability.swapaxes(1, 2)
        return cls(
            names,
            draws.reshape(len(draws), -1, len(names)),
            log_probability.reshape(len(draws), -1),
            found.rhat,
            found.rhat_nested,
            found.ess_bulk,
            found.ess_tail,
            found.sd_mcse,
            found.unmet,
            step,
            reason,
            acceptance,
            seed,
        )

    @property
    def converged(self) -> bool:
        """Whether every limit is met for every parameter."""
        return not self.unmet

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


class Sampler(Protocol):
    """What draws from the posterior of a problem; `sample` is one."""

    def __call__(
        self,
        problem: Problem,
        optimum: np.ndarray,
        /,
        *,
        seed: int,
        local_optima: np.ndarray | None,
        quick: bool,
    ) -> Posterior:
        """Draw, and judge the draws: arguments as of `sample`, result by `Posterior.judged`."""
        ...


class _Budget(NamedTuple):
    """What a run of independent walkers may spend: see `sample`."""

    walkers: int
    most_steps: int
    enough: float | None = None

    def first(self) -> int:
        """Steps after which the draws are looked at for the first time."""
        if self.enough is None:
            return self.most_steps
        needed = self.enough / (_WORTH * N_ENSEMBLES * self.walkers)
        return min(self.most_steps, max(2, math.ceil(needed)))

    def suffices(self, found: Posterior) -> bool:
        """Whether nothing more need be spent."""
        if self.enough is None or not found.converged:
            return False
        return bool(min(found.ess_bulk.min(), found.ess_tail.min()) >= self.enough)


class _Start(NamedTuple):
    """Points to begin from, and how well the proposal that they are from fits (Kish, 0 to 1)."""

    points: np.ndarray
    apart: np.ndarray
    efficiency: float


def sample(
    problem: Problem,
    optimum: np.ndarray,
    *,
    seed: int,
    local_optima: np.ndarray | None = None,
    effort: float = 1.0,
    quick: bool = False,
    enough: float | None = None,
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
    effort : float
        Factor on the number of steps.
    quick : bool
        Whether to do with fewer walkers, and without the last step of the ladder, which takes the
        longest.
    enough : float, optional
        Effective draws with which independent walkers may stop, bulk and tail of every parameter;
        by default they take all their steps.

    Returns
    -------
    Posterior
        Its `converged` says whether it may be used.
    """
    seeds = np.random.SeedSequence(seed).spawn(4)
    walkers = most = _FEW_WALKERS if quick else _WALKERS
    if enough is not None:
        walkers = int(np.clip(enough / 5, _FEW_WALKERS, most))
    budget = _Budget(walkers, max(2, round(_STEPS * effort * most / walkers)), enough)
    optimum = np.asarray(optimum, float)
    proposal = _laplace(problem, optimum, local_optima)
    why: list[str] = []
    start = _try(problem, proposal, seeds[0], _TRIALS * walkers)
    efficiency = start.efficiency
    ideal = efficiency_on_gaussian(len(problem.names), proposal.df)
    # What is spent on other optima cannot serve the best one.
    limit = EFFICIENCY_LIMIT * ideal * float(proposal.weights[0])
    if efficiency >= limit:
        reason = f"the Laplace t reaches an importance efficiency of {efficiency:.2f}"
        result = _independent(problem, proposal, start, "laplace-t", reason, seed, seeds[1], budget)
        if result.converged:
            return result
        why.append(f"the Laplace t did not converge ({result.unmet[0]})")
    else:
        why.append(
            f"the Laplace t reaches an importance efficiency of only {efficiency:.2f}, "
            f"below {limit:.2f}"
        )
    if quick and (efficiency < _HOPELESS or problem.takes_long):
        # A short run that shows by its own diagnostics that it cannot be used.
        why += ["one response takes long"] if problem.takes_long else []
        reason = "; ".join([*why, "no pilot run was made at this effort"])
        few = _Budget(walkers, max(2, round(0.1 * _STEPS * effort)))
        return _independent(problem, proposal, start, "laplace-t", reason, seed, seeds[1], few)
    pilot = _pilot(problem, start.points, seeds[2], _FEW_STEPS if quick else _PILOT_STEPS)
    mixture = fitted_mixture(
        pilot, problem.lower, problem.upper, seed=int(seeds[2].generate_state(1)[0])
    )
    start = _try(problem, mixture, seeds[2].spawn(1)[0], _TRIALS * walkers)
    efficiency = start.efficiency
    if efficiency >= EFFICIENCY_LIMIT * ideal / 2 or quick:
        reason = "; ".join([*why, f"a mixture fitted to a pilot run reaches {efficiency:.2f}"])
        result = _independent(problem, mixture, start, "mixture-t", reason, seed, seeds[1], budget)
        if result.converged or quick:
            return result
        why.append(f"the mixture did not converge ({result.unmet[0]})")
    else:
        why.append(f"a mixture fitted to a pilot run reaches only {efficiency:.2f}")
    return _evolution(problem, pilot, start.apart, "; ".join(why), seed, seeds[3], effort)


def _laplace(
    problem: Problem, optimum: np.ndarray, local_optima: np.ndarray | None
) -> StudentMixture:
    """Laplace t about the optimum, with smaller ones about other optima that could hold mass."""

    def about(point: np.ndarray) -> StudentMixture:
        hessian = curvature(problem, point).hessian
        return laplace_t(point, hessian, problem.lower, problem.upper)

    modes = modes_of(problem, optimum, local_optima)
    shares = [1.0] if len(modes) == 1 else [0.8, *[0.2 / (len(modes) - 1)] * (len(modes) - 1)]
    return combined([about(mode) for mode in modes], shares)


def _state(points: np.ndarray, seed: np.random.SeedSequence) -> emcee.State:
    # Without a state of its own emcee copies numpy's global one, the same in every worker.
    random = np.random.RandomState(np.random.MT19937(seed))
    return emcee.State(points, random_state=random.get_state())


def _try(
    problem: Problem, proposal: StudentMixture, seed: np.random.SeedSequence, n: int
) -> _Start:
    """Points from the proposal, drawn by their importance, and its efficiency.

    Those that the ensembles begin from are drawn without repetition: where one point outweighs
    all others, because the proposal hardly reaches where it lies, not all ensembles begin there.
    """
    random = np.random.RandomState(np.random.MT19937(seed))
    try:
        points = proposal.draw(n, random)
    except RuntimeError:
        where = np.clip(proposal.means[:1], proposal.lower, proposal.upper)
        return _Start(where.repeat(n, axis=0), where.repeat(N_ENSEMBLES, axis=0), 0.0)
    log_weights = problem.log_posterior(points) - proposal.log_density(points)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    resampled = points[random.choice(n, n, p=weights)]
    # The largest of log weights with Gumbel noise are a draw without repetition, in which weights
    # too small to be told from 0 keep their order.
    order = np.argsort(-(log_weights + random.gumbel(size=n)), kind="stable")
    return _Start(resampled, points[order[:N_ENSEMBLES]], float(1 / np.sum(weights**2) / n))


def _independent(
    problem: Problem,
    proposal: StudentMixture,
    start: _Start,
    step: Step,
    reason: str,
    seed: int,
    seeds: np.random.SeedSequence,
    budget: _Budget,
) -> Posterior:
    """Independence Metropolis-Hastings: every walker is a chain of its own."""

    def propose(coords: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        new = proposal.draw(len(coords), random)
        return new, proposal.log_density(coords) - proposal.log_density(new)

    left = np.log(_LEFT) / np.log1p(-min(start.efficiency, 0.999))
    burn = int(np.clip(np.ceil(left), _LEAST_BURN, _MOST_BURN)) if start.efficiency else _MOST_BURN
    # No walker sees another, so the ensembles, each from a point of its own, are run as one.
    sampler = emcee.EnsembleSampler(
        N_ENSEMBLES * budget.walkers,
        len(problem.names),
        problem.log_posterior,
        moves=emcee.moves.MHMove(propose),
        vectorize=True,
    )
    state = _state(start.apart.repeat(budget.walkers, axis=0), seeds)
    state = sampler.run_mcmc(state, burn, skip_initial_state_check=True)
    sampler.reset()
    n_steps, taken = budget.first(), 0
    while True:
        state = sampler.run_mcmc(state, n_steps, skip_initial_state_check=True)
        taken += n_steps
        apart = N_ENSEMBLES, budget.walkers, taken
        found = Posterior.judged(
            problem.names,
            sampler.get_chain().swapaxes(0, 1).reshape(*apart, -1),
            sampler.get_log_prob().T.reshape(apart),
            independent=True,
            step=step,
            reason=reason,
            acceptance=float(sampler.acceptance_fraction.mean()),
            seed=seed,
        )
        n_steps = min(2 * taken, budget.most_steps - taken)
        if not n_steps or budget.suffices(found):
            return found


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
    apart: np.ndarray,
    reason: str,
    seed: int,
    seeds: np.random.SeedSequence,
    effort: float,
) -> Posterior:
    """Differential evolution with snooker updates, from small clouds about points of their own."""
    n_steps = max(4, round(_DE_STEPS * effort))
    chains, scores, accepted = [], [], []
    for point, child in zip(apart, seeds.spawn(N_ENSEMBLES), strict=True):
        pick = np.random.default_rng(child).choice(len(pilot), _DE_WALKERS, replace=False)
        cloud = point + _CLOUD * (pilot[pick] - pilot.mean(axis=0))
        sampler = _evolving_sampler(problem, _DE_WALKERS)
        first = _scatter(problem, cloud, child)
        sampler.run_mcmc(_state(first, child), n_steps, skip_initial_state_check=True)
        chains.append(sampler.get_chain(discard=n_steps // 4).swapaxes(0, 1))
        scores.append(sampler.get_log_prob(discard=n_steps // 4).T)
        accepted.append(sampler.acceptance_fraction.mean())
    return Posterior.judged(
        problem.names,
        np.stack(chains),
        np.stack(scores),
        independent=False,
        step="differential evolution",
        reason=reason,
        acceptance=float(np.mean(accepted)),
        seed=seed,
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
