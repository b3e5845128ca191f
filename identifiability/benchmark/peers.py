"""Samplers that one could use in the place of this package's own, on the same posterior.

Every one is set up as its documentation begins, and knows the optimum, as ours does. What they
draw is counted alike; libraries that are not installed are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from io import StringIO
from typing import Any

import emcee
import numpy as np

from identifiability.inference.convergence import convergence, diagnose
from identifiability.inference.problem import Problem
from identifiability.inference.sampling import N_ENSEMBLES, sample
from identifiability.joint.response import drive_arrays, exact_response

_WALKERS = 32
_STEPS, _FEW_STEPS = 1500, 400  # of each ensemble, of which the first quarter is forgotten
_CHAINS, _ITERATIONS = 4, 4000
_WARM_UP, _DRAWS, _FEW_CHAINS = 250, 250, 2
_LIVE = 500
_BALL = 1e-3  # of the range of a parameter, about the optimum, in which walkers begin


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a sampler found.

    Attributes
    ----------
    ess : array, shape (k,)
        Effective draws of each parameter.
    sd, sd_mcse : array, shape (k,)
        Standard deviations and their Monte Carlo errors.
    converged : bool
        Whether the limits are met that this package's own draws have to meet; of nested sampling,
        whether it came to its own end.
    """

    ess: np.ndarray
    sd: np.ndarray
    sd_mcse: np.ndarray
    converged: bool


Peer = Callable[[Problem, np.ndarray, int], Drawn]


def own(problem: Problem, optimum: np.ndarray, seed: int) -> Drawn:
    """Draw by this package: independent walkers on a proposal of the posterior's shape."""
    found = sample(problem, optimum, seed=seed)
    return Drawn(found.ess_bulk, found.sd, found.sd_mcse, found.converged)


def by_emcee(problem: Problem, optimum: np.ndarray, seed: int) -> Drawn:
    """Draw by emcee's default, the stretch move, all walkers in one call."""
    chains = []
    for child in np.random.SeedSequence(seed).spawn(N_ENSEMBLES):
        sampler = emcee.EnsembleSampler(
            _WALKERS, optimum.size, problem.log_posterior, vectorize=True
        )
        sampler.run_mcmc(_state(problem, optimum, child), _STEPS)
        chains.append(sampler.get_chain(discard=_STEPS // 4).swapaxes(0, 1))
    return _of_walkers(np.stack(chains), problem.names)


def by_lmfit(problem: Problem, optimum: np.ndarray, seed: int) -> Drawn:
    """Draw by lmfit's ``Minimizer.emcee``, which asks for one point at a time."""
    import lmfit

    parameters = lmfit.Parameters()
    for name, value, low, high in zip(
        problem.names, optimum, problem.lower, problem.upper, strict=True
    ):
        parameters.add(name, value=float(value), min=float(low), max=float(high))

    def log_posterior(these: Any) -> float:
        return float(problem.log_posterior(np.array([these[n].value for n in problem.names]))[0])

    chains = []
    for child in np.random.SeedSequence(seed).spawn(N_ENSEMBLES):
        start = _ball(problem, optimum, np.random.default_rng(child))
        with redirect_stdout(StringIO()):  # it prints its advice
            found = lmfit.Minimizer(log_posterior, parameters).emcee(
                steps=_FEW_STEPS,
                nwalkers=_WALKERS,
                burn=_FEW_STEPS // 4,
                pos=start,
                float_behavior="posterior",
                progress=False,
                seed=np.random.RandomState(np.random.MT19937(child)),
            )
        chains.append(found.chain.swapaxes(0, 1))
    return _of_walkers(np.stack(chains), problem.names)


def by_pints(problem: Problem, optimum: np.ndarray, seed: int) -> Drawn:
    """Draw by PINTS, adaptive covariance (Haario-Bardenet), its default."""
    import pints

    class Posterior(pints.LogPDF):
        def __call__(self, x: np.ndarray) -> float:
            return float(problem.log_posterior(np.asarray(x))[0])

        def n_parameters(self) -> int:
            return optimum.size

    rng = np.random.default_rng(seed)
    before = np.random.get_state()  # noqa: NPY002
    # PINTS knows the global generator alone.
    np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002
    try:
        controller = pints.MCMCController(
            Posterior(), _CHAINS, _ball(problem, optimum, rng, _CHAINS)
        )
        controller.set_max_iterations(_ITERATIONS)
        controller.set_log_to_screen(False)
        chains = controller.run()[:, _ITERATIONS // 4 :]
    finally:
        np.random.set_state(before)  # noqa: NPY002
    return _of_chains(chains)


class Nuts:
    """NumPyro's no-U-turn sampler, two chains, one after another; compiled where it is made."""

    def __init__(self, problem: Problem, optimum: np.ndarray, seed: int) -> None:
        import jax
        import jax.numpy as jnp
        import numpyro
        from numpyro.infer import MCMC, NUTS, init_to_value

        (observed,) = problem.observations
        arrays, lower, upper = drive_arrays(observed.drive), problem.lower, problem.upper

        def joint() -> None:
            box = numpyro.distributions.Uniform(jnp.array(lower), jnp.array(upper))
            x = numpyro.sample("x", box.to_event(1))
            missed = exact_response(problem.model, x, arrays) - observed.measured
            numpyro.factor("misfit", -0.5 * jnp.sum((observed.scale * missed) ** 2))

        inner = lower + np.clip((optimum - lower) / (upper - lower), 1e-4, 1 - 1e-4) * (
            upper - lower
        )
        # An exponential of a matrix takes as many squarings as it needs: no reverse mode.
        kernel = NUTS(
            joint,
            init_strategy=init_to_value(values={"x": jnp.array(inner)}),
            forward_mode_differentiation=True,
        )
        self._mcmc = MCMC(
            kernel,
            num_warmup=_WARM_UP,
            num_samples=_DRAWS,
            num_chains=_FEW_CHAINS,
            chain_method="sequential",
            progress_bar=False,
        )
        self._key = jax.random.PRNGKey(seed + 1)
        self._mcmc.run(jax.random.PRNGKey(seed))

    def __call__(self) -> Drawn:
        """Draw once more, with nothing left to compile."""
        self._mcmc.run(self._key)
        return _of_chains(np.asarray(self._mcmc.get_samples(group_by_chain=True)["x"]))


def by_dynesty(problem: Problem, optimum: np.ndarray, seed: int) -> Drawn:
    """Draw by dynesty's static nested sampler: it starts from the prior, not from the optimum."""
    import dynesty

    sampler = dynesty.NestedSampler(
        lambda x: float(problem.log_posterior(x)[0]),
        lambda u: problem.lower + u * (problem.upper - problem.lower),
        optimum.size,
        nlive=_LIVE,
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False)
    found = sampler.results
    weights = found.importance_weights()
    kish = float(1 / np.sum(weights**2))
    mean = weights @ found.samples
    sd = np.sqrt(weights @ (found.samples - mean) ** 2)
    return Drawn(np.full(optimum.size, kish), sd, sd / np.sqrt(2 * kish), bool(np.all(sd > 0)))


PEERS: Mapping[str, tuple[str, Peer]] = {
    "emcee, stretch move": ("emcee", by_emcee),
    "lmfit, Minimizer.emcee": ("lmfit", by_lmfit),
    "PINTS, Haario-Bardenet": ("pints", by_pints),
    "dynesty, static": ("dynesty", by_dynesty),
}
"""By its name, the library that each needs, and how it is asked."""

NUTS_NAME = "NumPyro, NUTS"


def installed() -> dict[str, str]:
    """Versions of the libraries that are there, by the name of what is made with each."""
    needed = {name: library for name, (library, _) in PEERS.items()} | {NUTS_NAME: "numpyro"}
    return {name: version(one) for name, one in needed.items() if find_spec(one) is not None}


def _ball(
    problem: Problem, optimum: np.ndarray, rng: np.random.Generator, n: int = _WALKERS
) -> np.ndarray:
    size = _BALL * np.maximum(np.abs(optimum), 1e-3 * (problem.upper - problem.lower))
    points = optimum + size * rng.standard_normal((n, optimum.size))
    # At a bound half of them would begin outside; reflected, they do not.
    inside = np.where(points < problem.lower, 2 * problem.lower - points, points)
    return np.where(inside > problem.upper, 2 * problem.upper - inside, inside)


def _state(problem: Problem, optimum: np.ndarray, child: np.random.SeedSequence) -> emcee.State:
    random = np.random.RandomState(np.random.MT19937(child))
    start = _ball(problem, optimum, np.random.default_rng(child))
    return emcee.State(start, random_state=random.get_state())


def _of_walkers(draws: np.ndarray, names: tuple[str, ...]) -> Drawn:
    """Walkers of several ensembles, shape (n_ensembles, n_walkers, n_steps, k)."""
    found = convergence(draws, names, independent=False)
    sd = draws.reshape(-1, draws.shape[-1]).std(axis=0, ddof=1)
    return Drawn(found.ess_bulk, sd, found.sd_mcse, not found.unmet)


def _of_chains(chains: np.ndarray) -> Drawn:
    """Chains that know nothing of each other, shape (n_chains, n_draws, k)."""
    _, bulk, _, mcse = diagnose(chains)
    found = convergence(chains[:, None], tuple("x" * chains.shape[-1]), independent=True)
    sd = chains.reshape(-1, chains.shape[-1]).std(axis=0, ddof=1)
    return Drawn(bulk, sd, mcse, not found.unmet)
