"""How well each parameter is known, in every usual reading, and whether the quadratic holds."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from identifiability.files import plain
from identifiability.inference.curvature import NORMAL_95, Curvature, curvature
from identifiability.inference.fitting import Fit, explore, fit
from identifiability.inference.problem import Problem
from identifiability.inference.profiles import POINTS, Profile, Side, profile
from identifiability.inference.quadrature import Moments, quadrature
from identifiability.inference.sampling import Posterior, Sampler, sample
from identifiability.joint.programs import THREADS

Verdict = Literal[
    "agrees", "truncated", "curved", "heavy-tailed", "non-identifiable", "not converged"
]
# From good news to bad; a problem's verdict is the worst of its parameters'.
VERDICTS: tuple[Verdict, ...] = (
    "agrees",
    "curved",
    "heavy-tailed",
    "truncated",
    "non-identifiable",
    "not converged",
)

# Conventions: widths are quoted to a tenth of their size, and interval ends to a quarter of a
# standard deviation. A Gaussian's 95 % interval is 1.97 times as long as its 68.27 % one, a t
# with five degrees of freedom's 2.33 times; heavy tails begin half-way between.
WIDTH_TOLERANCE = 0.10
END_TOLERANCE = 0.25
HEAVY_TAIL = 2.15
_P68, _P95 = 0.6827, 0.95
_FEW_EVALUATIONS, _FEW_POINTS = 60, 5
_MOST_TAKEN_UP = 3  # times that a fit is taken up from a better point met on the way


@dataclass(frozen=True)
class Width:
    """Widths of one parameter, in its unit, and the verdict on the quadratic one.

    Attributes
    ----------
    name, unit : str
    optimum : float
    slice : float
        Standard deviation with all other parameters held at the optimum.
    quadratic : float
        From the full Hessian: the paper's estimate. NaN where the Hessian has no maximum.
    gauss_newton : float
        From J'J.
    sandwich : float
        ``H^-1 J'J H^-1``: scatter of the optimum over repeated measurements.
    profile : float
        Half the 68 % profile interval.
    profile_68, profile_95 : (float, float)
    profile_sides : (str, str)
        How the 95 % interval ends below and above: "closed", "bound" or "open".
    pinned : tuple of str
        Other parameters on a bound within the 95 % profile interval.
    posterior_mean, posterior_sd, posterior_sd_mcse : float
    posterior_68, posterior_95 : (float, float)
        Equal-tailed intervals.
    quadrature_mean, quadrature_sd : float
        From deterministic integration; NaN where that was not done.
    rhat, rhat_nested, ess_bulk, ess_tail : float
    verdict : str
    reason : str
    """

    name: str
    unit: str
    optimum: float
    slice: float
    quadratic: float
    gauss_newton: float
    sandwich: float
    profile: float
    profile_68: tuple[float, float]
    profile_95: tuple[float, float]
    profile_sides: tuple[Side, Side]
    pinned: tuple[str, ...]
    posterior_mean: float
    posterior_sd: float
    posterior_sd_mcse: float
    posterior_68: tuple[float, float]
    posterior_95: tuple[float, float]
    quadrature_mean: float
    quadrature_sd: float
    rhat: float
    rhat_nested: float
    ess_bulk: float
    ess_tail: float
    verdict: Verdict
    reason: str


@dataclass(frozen=True, eq=False)
class Widths:
    """Everything that was learnt about the widths of a problem's parameters.

    Attributes
    ----------
    rows : tuple of Width
        One a parameter.
    fit : Fit
    curvature : Curvature
    profiles : tuple of Profile
    posterior : Posterior
    moments : Moments or None
        The quadrature's, where there were at most three parameters.
    taken_up : tuple of str
        Parameters whose profile met a better point than the fit, one for each time that the fit
        was taken up from there; everything above is of the last fit.
    """

    rows: tuple[Width, ...]
    fit: Fit
    curvature: Curvature
    profiles: tuple[Profile, ...]
    posterior: Posterior
    moments: Moments | None
    taken_up: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Width:
        """Widths of a parameter by name."""
        return self.rows[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(row.name for row in self.rows)

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of any parameter."""
        return max((row.verdict for row in self.rows), key=VERDICTS.index)

    @property
    def reason(self) -> str:
        """Reason of that verdict."""
        return next(row.reason for row in self.rows if row.verdict == self.verdict)

    def to_dict(self) -> dict[str, Any]:
        """Plain record of all widths, for JSON; what is not finite becomes ``None``."""
        sampler = self.posterior
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "parameters": {row.name: plain(asdict(row)) for row in self.rows},
            "optimum": {
                "cost": self.fit.cost,
                "at_bound": list(self.fit.at_bound),
                "starts": len(self.fit.costs),
                "starts_agreeing": self.fit.n_agreeing,
                "taken_up": list(self.taken_up),
            },
            "sampler": {
                "step": sampler.step,
                "reason": sampler.reason,
                "acceptance": sampler.acceptance,
                "ensembles": sampler.draws.shape[0],
                "draws": int(np.prod(sampler.draws.shape[:2])),
                "converged": sampler.converged,
                "unmet": list(sampler.unmet),
                "seed": sampler.seed,
            },
            "quadrature": None
            if self.moments is None
            else {
                "log_evidence": plain(self.moments.log_evidence),
                "error": self.moments.error,
                "evaluations": self.moments.n_evaluations,
            },
        }


def widths(
    problem: Problem,
    *,
    starts: np.ndarray,
    seed: int,
    referee: bool = True,
    quick: bool = False,
    sampler: Sampler = sample,
) -> Widths:
    """Fit, differentiate, profile, sample, integrate and judge.

    Where a profile meets a better point than the fit, the fit is taken up from there, and the
    result says so.

    Parameters
    ----------
    problem : Problem
    starts : array, shape (n_starts, k)
        Starts of the fit.
    seed : int
        Of the sampler.
    referee : bool
        Whether to integrate by quadrature too, for at most three parameters.
    quick : bool
        Whether to do with a fit of limited length, a coarser profile, fewer draws, and no
        differential evolution: for models whose response takes long. What then does not
        converge is said not to.
    sampler : callable
        What draws from the posterior: see `Sampler`.

    Returns
    -------
    Widths
    """
    best = _fitted(problem, starts, quick)
    shape, profiles = _profiles(problem, best, quick)
    taken_up: list[str] = []
    # A profile that met a better point is of another optimum: the fit is taken up from there.
    while len(taken_up) < _MOST_TAKEN_UP:
        lowest = min(profiles, key=lambda path: path.drops.min())
        if not lowest.improved:
            break
        again = _fitted(problem, lowest.paths[[int(np.argmin(lowest.drops))]], quick)
        if again.cost >= best.cost:
            break
        taken_up.append(lowest.name)
        reached = np.concatenate([again.reached, best.reached])
        best = replace(again, costs=np.concatenate([again.costs, best.costs]), reached=reached)
        shape, profiles = _profiles(problem, best, quick)
    posterior = sampler(problem, best.values, seed=seed, local_optima=best.reached, quick=quick)
    moments = None
    if referee and len(problem.names) <= 3:
        moments = quadrature(problem, best.values, local_optima=best.reached)
    rows = tuple(
        _row(problem, i, best, shape, profiles[i], posterior, moments)
        for i in range(len(problem.names))
    )
    return Widths(rows, best, shape, profiles, posterior, moments, tuple(taken_up))


def _fitted(problem: Problem, starts: np.ndarray, quick: bool) -> Fit:
    return explore(problem, starts, evaluations=_FEW_EVALUATIONS) if quick else fit(problem, starts)


def _profiles(problem: Problem, best: Fit, quick: bool) -> tuple[Curvature, tuple[Profile, ...]]:
    shape = curvature(problem, best.values)
    points = _FEW_POINTS if quick else POINTS

    def follow(name: str) -> Profile:
        return profile(problem, best.values, name, points=points, shape=shape)

    with ThreadPoolExecutor(THREADS if quick else 1) as pool:
        return shape, tuple(pool.map(follow, problem.names))


def _row(
    problem: Problem,
    i: int,
    best: Fit,
    shape: Curvature,
    path: Profile,
    posterior: Posterior,
    moments: Moments | None,
) -> Width:
    def sd(covariance: np.ndarray) -> float:
        return float(np.sqrt(covariance[i, i])) if covariance[i, i] > 0 else float("nan")

    def ends(pair: np.ndarray) -> tuple[float, float]:
        return float(pair[0]), float(pair[1])

    name = problem.names[i]
    half, full = ends(posterior.interval(_P68)[:, i]), ends(posterior.interval(_P95)[:, i])
    quadratic = sd(shape.covariance)
    verdict, reason = judge(
        name=name,
        optimum=float(best.values[i]),
        quadratic=quadratic,
        posterior_sd=float(posterior.sd[i]),
        posterior_68=half,
        posterior_95=full,
        sides=path.sides["95"],
        bounds=(float(problem.lower[i]), float(problem.upper[i])),
        pinned=path.pinned,
        at_bound=best.at_bound,
        unmet=posterior.unmet,
        referee=_disagreement(posterior, moments, i),
    )
    return Width(
        name=name,
        unit=problem.model.parameters[name].unit,
        optimum=float(best.values[i]),
        slice=float(shape.slice_sd[i]),
        quadratic=quadratic,
        gauss_newton=sd(shape.gauss_newton_covariance),
        sandwich=sd(shape.sandwich_covariance),
        profile=path.half_width,
        profile_68=path.intervals["68"],
        profile_95=path.intervals["95"],
        profile_sides=path.sides["95"],
        pinned=path.pinned,
        posterior_mean=float(posterior.mean[i]),
        posterior_sd=float(posterior.sd[i]),
        posterior_sd_mcse=float(posterior.sd_mcse[i]),
        posterior_68=half,
        posterior_95=full,
        quadrature_mean=float("nan") if moments is None else float(moments.mean[i]),
        quadrature_sd=float("nan") if moments is None else float(moments.sd[i]),
        rhat=float(posterior.rhat[i]),
        rhat_nested=float(posterior.rhat_nested[i]),
        ess_bulk=float(posterior.ess_bulk[i]),
        ess_tail=float(posterior.ess_tail[i]),
        verdict=verdict,
        reason=reason,
    )


def judge(
    *,
    name: str,
    optimum: float,
    quadratic: float,
    posterior_sd: float,
    posterior_68: tuple[float, float],
    posterior_95: tuple[float, float],
    sides: tuple[Side, Side],
    bounds: tuple[float, float],
    pinned: tuple[str, ...],
    at_bound: tuple[str, ...],
    unmet: tuple[str, ...],
    referee: str = "",
) -> tuple[Verdict, str]:
    """Judge whether the quadratic width of one parameter describes its posterior, and why not.

    The quadratic width agrees if the posterior's standard deviation lies within a tenth of it and
    both ends of the 95 % interval within a quarter of it from where a Gaussian's would be. If not,
    the first of these that holds is the reason: the likelihood closes the profile on neither side
    (non-identifiable); a bound cuts it, the parameter's own or another's (truncated); the tails
    are heavy; or the likelihood is not quadratic over the width of the posterior (curved).
    Where the sampler did not converge, as `unmet` says, or the quadrature contradicts it, as
    `referee` says, there is nothing to judge by.

    Returns
    -------
    (verdict, reason)
    """
    if unmet:
        return (
            "not converged",
            f"the sampler did not converge ({unmet[0]}), so there is no posterior to judge by",
        )
    if referee:
        return "not converged", referee
    ratio = posterior_sd / quadratic
    size = f"the posterior sd of {name} is {ratio:.2f} times the quadratic width"
    if not np.isfinite(quadratic):
        size = f"the Hessian gives no width for {name}"
    shifts = np.abs(np.array(posterior_95) - (optimum + NORMAL_95 * quadratic * np.array([-1, 1])))
    if abs(ratio - 1) <= WIDTH_TOLERANCE and np.all(shifts <= END_TOLERANCE * quadratic):
        return "agrees", f"{size} and its 95 % interval lies where a Gaussian's would"
    if np.isfinite(quadratic) and abs(ratio - 1) <= WIDTH_TOLERANCE:
        size += ", but its 95 % interval is shifted"
    open_sides = [side != "closed" for side in sides]
    if all(open_sides):
        return "non-identifiable", f"{size}: the data bound {name} neither below nor above"
    if any(open_sides):
        below = open_sides[0]
        if sides[0 if below else 1] == "open":
            end = "below" if below else "above"
            return "non-identifiable", f"{size}: the data do not bound {name} {end}"
        sign, bound = (">=", bounds[0]) if below else ("<=", bounds[1])
        return "truncated", f"{size}: the bound {name} {sign} {bound:g} cuts its 95 % interval"
    others = [other for other in at_bound if other != name]
    if others:
        return "truncated", f"{size}: the optimum lies on a bound of {' and '.join(others)}"
    if pinned:
        return (
            "truncated",
            f"{size}: within its 95 % interval {' and '.join(pinned)} runs into a bound",
        )
    stretch = (posterior_95[1] - posterior_95[0]) / (posterior_68[1] - posterior_68[0])
    if stretch > HEAVY_TAIL:
        return (
            "heavy-tailed",
            f"{size}: its 95 % interval is {stretch:.2f} times its 68 % one, a Gaussian's "
            f"{NORMAL_95:g}",
        )
    return "curved", f"{size}: the likelihood is not quadratic over the width of the posterior"


def _disagreement(posterior: Posterior, moments: Moments | None, i: int) -> str:
    """Say where sampler and quadrature differ by more than chance and more than a twentieth."""
    if moments is None:
        return ""
    sampled, integrated = float(posterior.sd[i]), float(moments.sd[i])
    if abs(sampled - integrated) <= max(5 * posterior.sd_mcse[i], 0.05 * integrated):
        return ""
    return (
        f"sampling gives {posterior.names[i]} a standard deviation of {sampled:.3g}, quadrature "
        f"{integrated:.3g}: one of them misses part of the posterior"
    )
