"""What kind of thing a model lacks, and the torque it lacks, without naming an effect.

A candidate's residual is explained by Gaussian processes of several kinds: nothing but noise; a
drift of the sensor; a filter in the sensor; a torque of the present state, of the turning points
of the motion, of the past motion; stiffness that is not the same in every trial; a torque of its
own in every trial. Each has its marginal likelihood in closed form, in which every free parameter
of the candidate may move by 100 % and the noise, first-order autoregressive with a standard
deviation for each trial, is estimated anew.

No such kind is exact. Where a torque of its own in every trial explains more than a kind does, the
kind is therefore tried together with it, and with a second kind; the largest part gives the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from identifiability.investigation.candidates import Candidate, Workbench
from identifiability.investigation.library_free import (
    Background,
    Response,
    Term,
    Terms,
    Trace,
    background,
    bin_width,
    binned,
    follow,
    inner_products,
    traces_of,
)
from identifiability.investigation.linear_gaussian import (
    Columns,
    Posterior,
    TrialNoise,
    eliminate,
    log_evidence,
    side_by_side,
)

DECISIVE = 5.0
"""Difference of log evidence, in nats, that decides between kinds: odds of 150 to 1 where both were
as likely before ("very strong", Kass & Raftery 1995, J Am Stat Assoc 90: 773-795)."""

KINDS = {
    "none": "noise",
    "drift": "a drift of the recording",
    "sensor": "a filter or delay in the recording",
    "static": "a torque of the present angle and velocity",
    "hysteresis": "a torque like dry friction",
    "memory": "a torque of the past motion",
    "unrepeatable": "a torque that differs from trial to trial",
}
"""Kinds of what may be missing, in words."""

NAMES = {
    "none": "noise alone",
    "drift": "drift, its own in each trial",
    "common_drift": "drift, the same in all trials",
    "sensor": "filter or delay in the recording",
    "static": "torque of angle and velocity",
    "hysteresis": "torque like dry friction",
    "memory": "torque of past motion",
    "memory_positive": "torque of past motion, one way (+)",
    "memory_negative": "torque of past motion, one way (−)",
    "variation": "stiffness and damping differ by trial",
    "varying": "stiffness and damping change in time",
    "unrepeatable": "torque of its own in each trial",
}
"""Families by key, in words."""

_MOST = 0.8  # share of the misfit beyond the noise that counts as most of it: a convention
_LEAST_QUIET = 8  # bins that a level of the noise may be read from
_REMAINDER = "unrepeatable"
_MOST_PAIRS = 3
_ROUNDS = 3
_HIGHEST_RHO = 0.99
_CLEAR, _FELT = 0.1, 0.01  # share of the margin, and s, from which a latency is spoken of
_DRAWS = 200
_COARSE_DELAYS = np.arange(0.0, 0.1201, 0.006)
_COARSE_DECAYS = np.array([0.0, 0.008, 0.016, 0.032, 0.064, 0.128])
_FINE_DECAYS = np.geomspace(0.002, 0.4, 25)


@dataclass(frozen=True, eq=False)
class Family:
    """One explanation of the residual.

    Attributes
    ----------
    key : str
        Keys of its terms joined by "+"; a remainder of its own in each trial is not named.
    name : str
    kind : str
        Of `KINDS`: that of the part with the largest share.
    log_evidence : float
        In nats, against noise alone, less half the logarithm of the number of samples for each
        hyperparameter.
    hyperparameters : dict of str to float
        By "term.name"; "noise.rho" is the correlation from one sample to the next.
    shares : dict of str to float
        By term, its share of what the terms explain together; sums to 1.
    remainder : bool
        Whether it needs a torque of its own in each trial besides.
    """

    key: str
    name: str
    kind: str
    log_evidence: float
    hyperparameters: dict[str, float]
    shares: dict[str, float]
    remainder: bool


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """The torque that the model lacks in one trial, positive where it opposes a positive angle.

    It is what K, B and I cannot take over: its projections on angle, velocity and acceleration,
    which a refit would absorb, are removed, over all trials together.

    Attributes
    ----------
    trial : str
    time, mean, sd : array, shape (n,)
        Time [s] as recorded, torque [Nm], and its standard deviation.
    """

    trial: str
    time: np.ndarray
    mean: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class MemoryKernel:
    """Torque that is left at a time after a unit step of angle: the relaxation.

    Values near a lag of 0 are shared with K and B, which take part of them over.

    Attributes
    ----------
    lag, h, sd : array, shape (m,)
        Lag [s], torque per angle [Nm/rad] and its standard deviation.
    """

    lag: np.ndarray
    h: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class DelayReadout:
    """Latency and decay of the torque, if it is that of a motion delayed, then low-passed.

    Attributes
    ----------
    delay, delay_sd : float
        Latency [s] of highest evidence, and its standard deviation.
    decay, decay_sd : float
        Time constant of the low-pass [s], and its standard deviation.
    nats : float
        Evidence for a latency above 0.
    """

    delay: float
    delay_sd: float
    decay: float
    decay_sd: float
    nats: float


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Torque as a function of angle and velocity, less its part linear in both.

    Attributes
    ----------
    angle, velocity : array, shape (m,)
        Grid [rad], [rad/s], dense about rest.
    torque, sd : array, shape (m, m)
        Torque [Nm] by angle and velocity, NaN at states that were not visited.
    """

    angle: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What is left by a model, and of what kind it is.

    Attributes
    ----------
    families : tuple of Family
        Best first: by evidence, but for a family whose functions of the motion serve all trials,
        which comes before those that differ by trial if it explains most of the misfit.
    margin : float
        Nats from the best family to the best of another kind.
    share : float
        Share of the residual's energy beyond the noise that the best family's repeatable part
        explains: all its terms but a torque of its own in each trial.
    torque : tuple of MissingTorque
        One a fitted trial, under the best family that is a torque.
    noise_ratio : float or None
        Standard deviation of the noise under the best family over that of the quiet samples,
        root mean square over trials; ``None`` without quiet samples.
    memory_kernel, delay_readout, static_map : optional
        Where the best family has such a part.
    """

    families: tuple[Family, ...]
    margin: float
    share: float
    torque: tuple[MissingTorque, ...]
    noise_ratio: float | None
    memory_kernel: MemoryKernel | None = None
    delay_readout: DelayReadout | None = None
    static_map: StaticMap | None = None

    @property
    def best(self) -> Family:
        """Family of the highest evidence."""
        return self.families[0]

    @property
    def rival(self) -> Family:
        """Best family of another kind."""
        return _rival(self.families)

    @property
    def decided(self) -> bool:
        """Whether the best family wins over every other kind by `DECISIVE` nats."""
        return self.margin >= DECISIVE

    @property
    def sentence(self) -> str:
        """The finding, in words."""
        if not self.decided:
            return (
                f"What is left could be {KINDS[self.best.kind]} or {KINDS[self.rival.kind]}: "
                "these data do not tell them apart."
            )
        return _sentence(self)


@dataclass(frozen=True, eq=False)
class Explanation:
    """Terms fitted to the residuals.

    Attributes
    ----------
    terms : tuple of Term
    values : tuple of array
        Hyperparameters of each term.
    noise : TrialNoise
    log_evidence : float
        Less half the logarithm of the number of samples for each hyperparameter.
    posterior : Posterior
        Of the weights: local ones are those of the unshared terms in turn, then the background's;
        common ones those of the shared terms, then the candidate's parameters.
    """

    terms: tuple[Term, ...]
    values: tuple[np.ndarray, ...]
    noise: TrialNoise
    log_evidence: float
    posterior: Posterior

    @property
    def key(self) -> str:
        """Keys of the terms, but for that of a remainder."""
        keys = [t.key for t in self.terms if t.key != _REMAINDER or len(self.terms) == 1]
        return "+".join(keys) or "none"

    @property
    def remainder(self) -> bool:
        """Whether there is a torque of its own in each trial besides other terms."""
        return len(self.terms) > 1 and any(t.key == _REMAINDER for t in self.terms)

    @cached_property
    def slices(self) -> list[slice]:
        """For each term, its place among the local weights of trial 0, or the common ones."""
        return self.slices_in(0)

    def slices_in(self, trial: int) -> list[slice]:
        """For each term, its place among the local weights of a trial, or the common ones."""
        used, out = {True: 0, False: 0}, []
        for t in self.terms:
            m = t.columns[trial].shape[1]
            out.append(slice(used[t.shared], used[t.shared] + m))
            used[t.shared] += m
        return out

    @cached_property
    def contributions(self) -> np.ndarray:
        """Inner products of the terms' shares of the residual and of what is left, shape (m, m).

        In units of the noise, freed of what the candidate's parameters can take over; the last row
        is the residual without the terms.
        """
        n_terms, n_free = len(self.terms), len(self._nuisance)
        total = np.zeros((n_terms + 1 + n_free,) * 2)
        for i, (columns, local) in enumerate(
            zip(self.posterior.trials, self.posterior.local, strict=True)
        ):
            h = columns.under(self.noise, i)
            common, k = self.posterior.common.mean, columns.n_local
            z = np.zeros((len(h), n_terms + 1 + n_free))
            for j, (t, s) in enumerate(zip(self.terms, self.slices_in(i), strict=True)):
                if t.shared:
                    z[k + s.start : k + s.stop, j] = common[s]
                else:
                    z[s, j] = local.mean[s]
            # The background's own level and torque noise belong to neither.
            own = sum(t.columns[i].shape[1] for t in self.terms if not t.shared)
            z[own:k, n_terms] = -local.mean[own:]
            z[-1, n_terms] = 1.0
            z[:, n_terms] -= z[:, :n_terms].sum(axis=1)
            z[k + self._nuisance, n_terms + 1 + np.arange(n_free)] = 1.0
            total += z.T @ h @ z
        m = n_terms + 1
        taken = np.linalg.lstsq(total[m:, m:], total[m:, :m], rcond=1e-12)[0]
        return np.asarray(total[:m, :m] - total[:m, m:] @ taken)

    @property
    def _nuisance(self) -> np.ndarray:
        first = sum(t.columns[0].shape[1] for t in self.terms if t.shared)
        return np.arange(first, len(self.posterior.common.mean))

    @property
    def shares(self) -> dict[str, float]:
        """By term, its share of what the terms explain together."""
        inner = self.contributions[:-1, :-1]
        if not self.terms or inner.sum() <= 0:
            return {t.key: 1.0 / len(self.terms) for t in self.terms}
        return {
            t.key: float(s)
            for t, s in zip(self.terms, inner.sum(axis=0) / inner.sum(), strict=True)
        }

    @property
    def kind(self) -> str:
        """Kind of the largest part."""
        by_kind: dict[str, float] = {}
        for t in self.terms:
            by_kind[t.kind] = by_kind.get(t.kind, 0.0) + self.shares[t.key]
        return max(by_kind, key=lambda kind: by_kind[kind]) if by_kind else "none"

    @property
    def explained(self) -> float:
        """Share of the residual's energy beyond the noise that the repeatable terms explain."""
        n = sum(c.n_samples for c in self.posterior.trials)
        ones = np.ones(len(self.contributions))
        kept = np.array([*(t.key == _REMAINDER for t in self.terms), True], float)
        before = ones @ self.contributions @ ones - n
        after = kept @ self.contributions @ kept - n
        return float(np.clip(1 - max(after, 0) / before, 0, 1)) if before > 0 else 0.0

    def family(self, noise_alone: float) -> Family:
        """What is reported of it."""
        hyper = {
            f"{t.key}.{name}": float(v)
            for t, values in zip(self.terms, self.values, strict=True)
            for name, v in zip(t.names, values, strict=True)
        }
        words = [NAMES[key] for key in self.key.split("+")]
        return Family(
            self.key,
            ", and ".join(words),
            self.kind,
            self.log_evidence - noise_alone,
            hyper | {"noise.rho": self.noise.rho},
            self.shares,
            self.remainder,
        )


@dataclass(frozen=True, eq=False)
class Explainer:
    """Fits explanations to the residuals of one candidate.

    Attributes
    ----------
    traces : sequence of Trace
    background : Background
    terms : dict of str to Term
    """

    traces: Sequence[Trace]
    background: Background
    terms: dict[str, Term]
    _places: dict[str, np.ndarray] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _products(self) -> list[Columns]:
        """Inner products of all columns there are, local terms first."""
        local = [
            np.hstack([*(t.columns[i] for t in self._of(False)), own])
            for i, own in enumerate(self.background.local)
        ]
        common = [
            np.hstack([*(t.columns[i] for t in self._of(True)), shared])
            for i, shared in enumerate(self.background.common)
        ]
        return inner_products(self.traces, local, common)

    def _of(self, shared: bool) -> list[Term]:
        return [t for t in self.terms.values() if t.shared is shared]

    def columns(self, terms: Sequence[Term]) -> list[Columns]:
        """Inner products of the columns of some terms and of the background."""
        out = []
        for i, products in enumerate(self._products):
            chosen = []
            for shared, own in ((False, self.background.local), (True, self.background.common)):
                first, places = 0, {}
                for t in self._of(shared):
                    places[t.key] = np.arange(first, first + t.columns[i].shape[1])
                    first += t.columns[i].shape[1]
                wanted = [places[t.key] for t in terms if t.shared is shared]
                chosen.append(np.concatenate([*wanted, first + np.arange(own[i].shape[1])]))
            out.append(products.only(*chosen))
        return out

    @property
    def n_samples(self) -> int:
        """Number of samples, bins counted as one."""
        return sum(c.n_samples for c in self._products)

    def roots(
        self, terms: Sequence[Term], values: Sequence[np.ndarray]
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """Roots of the priors of each trial's local weights, and of the common ones."""
        made = [t.roots(v) for t, v in zip(terms, values, strict=True)]
        common = [p[0] for t, p in zip(terms, made, strict=True) if t.shared]
        local = [
            side_by_side(*(p[i] for t, p in zip(terms, made, strict=True) if not t.shared), own)
            for i, own in enumerate(self.background.local_roots)
        ]
        return local, side_by_side(*common, self.background.common_root)

    def fit(
        self,
        terms: Sequence[Term],
        starts: Sequence[np.ndarray] | None = None,
        *,
        sizes_only: bool = False,
    ) -> Explanation:
        """Maximise the evidence over hyperparameters and noise.

        Parameters
        ----------
        terms : sequence of Term
        starts : sequence of array, optional
            Of each term's hyperparameters.
        sizes_only : bool
            Whether shapes stay as they are at the start.
        """
        starts = [t.start for t in terms] if starts is None else starts
        columns = self.columns(terms)
        at = np.log(np.concatenate([*starts, [1.0]]))[:-1]
        bounds = np.concatenate([*(t.bounds for t in terms), np.zeros((0, 2))])
        at = np.clip(at, bounds[:, 0], bounds[:, 1])
        moves = np.concatenate(
            [*((np.arange(len(t.start)) < t.n_scales) | (not sizes_only) for t in terms), [False]]
        )[:-1].astype(bool)
        noise = self._first_noise()

        def split(x: np.ndarray) -> list[np.ndarray]:
            whole = at.copy()
            whole[moves] = x[:-1]
            ends = np.cumsum([len(t.start) for t in terms])
            return np.split(np.exp(whole), ends[:-1]) if len(terms) else []

        def objective(x: np.ndarray) -> float:
            with np.errstate(all="ignore"):
                try:
                    found = log_evidence(
                        columns, TrialNoise(noise.sds, _rho(x[-1])), *self.roots(terms, split(x))
                    )
                except np.linalg.LinAlgError:
                    return 1e30
            return -found if np.isfinite(found) else 1e30

        limits = np.vstack([bounds[moves], [0.0, -np.log(1 - _HIGHEST_RHO)]])
        x = np.clip(np.append(at[moves], -np.log(1 - noise.rho)), *limits.T)
        for step, evaluations in zip(
            (0.7, *(0.25,) * (_ROUNDS - 1)), (30, *(18,) * 9), strict=False
        ):
            corners = np.tile(x, (len(x) + 1, 1))
            inside = np.where(x + step <= limits[:, 1], step, -step)
            corners[1:] += np.diag(inside)
            x = minimize(
                objective,
                x,
                method="Nelder-Mead",
                bounds=list(limits),
                options={
                    "initial_simplex": corners,
                    "maxfev": evaluations * (len(x) + 1),
                    "fatol": 0.05,
                    "xatol": 0.02,
                },
            ).x
            for _ in range(2):
                before = TrialNoise(noise.sds, _rho(x[-1]))
                noise = self._renewed(columns, terms, split(x), before)
        values = split(x)
        local, common = self.roots(terms, values)
        posterior = Posterior(columns, noise, local, common)
        penalty = 0.5 * sum(len(t.start) for t in terms) * np.log(self.n_samples)
        found = log_evidence(columns, noise, local, common) - penalty
        return Explanation(tuple(terms), tuple(values), noise, found, posterior)

    def _renewed(
        self,
        columns: Sequence[Columns],
        terms: Sequence[Term],
        values: Sequence[np.ndarray],
        noise: TrialNoise,
    ) -> TrialNoise:
        """One step of expectation maximisation for the standard deviations."""
        posterior = Posterior(columns, noise, *self.roots(terms, values))
        left = posterior.expected_energies() / [c.n_samples for c in columns]
        return TrialNoise(noise.sds * np.sqrt(left), noise.rho)

    def _first_noise(self) -> TrialNoise:
        """Noise as the quiet samples show it, or as the residual's quickest changes do."""
        sds, rho = [], 0.0
        for t in self.traces:
            lead = t.ready.lead
            scatter = np.std(np.diff(t.residual)) / np.sqrt(2)
            sds.append(max(lead.sd if lead.n_samples else scatter, 1e-9 * np.std(t.ready.compared)))
            rho = max(rho, (lead.correlation_time - 1) / (lead.correlation_time + 1))
        return TrialNoise(np.array(sds), min(rho, _HIGHEST_RHO))


def _rho(x: float) -> float:
    return float(1 - np.exp(-x))


def explainer(bench: Workbench, candidate: Candidate) -> tuple[Explainer, Response]:
    """Prepare the terms for a candidate's residuals.

    The motion that terms act on is the prediction plus the smooth part of the residual, which a
    torque of its own in every trial gives.
    """
    traces, response = traces_of(bench, candidate)
    values = dict(candidate.values)
    first = Terms(traces, response, values).unrepeatable()
    rough = Explainer(traces, background(traces, candidate, first), {first.key: first})
    found = rough.fit([first])
    posterior = found.posterior
    smooth = [
        c[:, : first.columns[i].shape[1]] @ w.mean[: first.columns[i].shape[1]]
        + t.nuisance @ posterior.common.mean
        for i, (c, w, t) in enumerate(zip(first.columns, posterior.local, traces, strict=True))
    ]
    traces = follow(traces, smooth, candidate, response)
    terms = {t.key: t for t in Terms(traces, response, values).every()}
    own = background(traces, candidate, terms[_REMAINDER])
    return Explainer(traces, own, terms), response


def unexplained(bench: Workbench, candidate: Candidate, *, seed: int = 1) -> Unexplained:
    """Say what kind of thing a candidate lacks, and estimate the torque that it lacks.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        A fitted model; the residuals are those of its fitted trials.
    seed : int
        Of the draws that bands are made of.

    Returns
    -------
    Unexplained
    """
    # Many small matrices: threads would cost more than they bring.
    with threadpool_limits(1):
        explains, response = explainer(bench, candidate)
        found = _explanations(explains)
        return _conclude(explains, response, found, seed)


def _explanations(explains: Explainer) -> list[Explanation]:
    """All explanations, best first; of each family the best, alone or with a remainder."""
    terms = explains.terms
    rest = terms[_REMAINDER]
    found = {"none": explains.fit([])}
    for key, t in terms.items():
        try:
            found[key] = explains.fit([t])
        except np.linalg.LinAlgError:
            # A term that these data cannot tell from the model's own parameters.
            continue
    if _REMAINDER not in found:
        return sorted(found.values(), key=lambda e: -e.log_evidence)
    level = found[_REMAINDER].log_evidence
    best = dict(found)
    if level > found["none"].log_evidence + DECISIVE:
        for key, t in terms.items():
            if t.kind == "drift" or t is rest or key not in found:
                continue
            if found[key].log_evidence > level:
                continue
            both = explains.fit([t, rest], [*found[key].values, *found[_REMAINDER].values])
            if both.log_evidence > best[key].log_evidence:
                best[key] = both
        for pair in _pairs(explains, best):
            best[pair.key] = pair
    return _preferred(sorted(best.values(), key=lambda e: -e.log_evidence))


def _preferred(found: list[Explanation]) -> list[Explanation]:
    """Best first: one function of the motion for all trials before what differs by trial.

    Stiffness or torque that is free in every trial can follow anything smooth, so it is believed
    only where no single function of the motion explains most of the misfit.
    """
    if found[0].kind != "unrepeatable":
        return found
    for e in found:
        if e.kind not in ("none", "drift", "unrepeatable") and e.explained > _MOST:
            return [e, *(other for other in found if other is not e)]
    return found


def _pairs(explains: Explainer, best: dict[str, Explanation]) -> list[Explanation]:
    """The best repeatable family and a second one, where it does not suffice alone."""
    ranked = sorted(best.values(), key=lambda e: -e.log_evidence)
    repeatable = [e for e in ranked if e.terms and e.terms[0].kind not in (_REMAINDER, "drift")]
    first, *others = repeatable
    if not first.remainder:
        return []
    out = []
    for second in others[:_MOST_PAIRS]:
        terms = [first.terms[0], second.terms[0], explains.terms[_REMAINDER]]
        starts = [first.values[0], second.values[0], first.values[-1]]
        out.append(explains.fit(terms, starts, sizes_only=True))
    return out


def _conclude(
    explains: Explainer,
    response: Response,
    found: Sequence[Explanation],
    seed: int,
) -> Unexplained:
    noise_alone = next(e for e in found if not e.terms).log_evidence
    families = tuple(e.family(noise_alone) for e in found)
    best = found[0]
    rival = _rival(families)
    torque_like = next(e for e in found if any(t.torques is not None for t in e.terms))
    torques, slopes = _missing_torque(explains, torque_like, seed)
    kernel = readout = static = None
    if memories := [t for t in best.terms if t.kind == "memory"]:
        place = best.slices[best.terms.index(memories[0])]
        weights = best.posterior.common
        kernel = MemoryKernel(memories[0].nodes[0], weights.mean[place], weights.sd[place])
        readout = _read_delay(explains, response, best, memories[0])
    if any(t.key == "static" for t in best.terms):
        static = _static_map(best, slopes)
    return Unexplained(
        families,
        families[0].log_evidence - rival.log_evidence,
        best.explained,
        torques,
        _noise_ratio(explains, best),
        kernel,
        readout,
        static,
    )


def _rival(families: Sequence[Family]) -> Family:
    """Best family of another kind; one that differs by trial is no rival to one that does not."""
    best = families[0]
    others = [f for f in families if f.kind != best.kind]
    if best.kind != "unrepeatable":
        others = [f for f in others if f.kind != "unrepeatable"] or others
    return max(others, key=lambda f: f.log_evidence)


def _noise_ratio(explains: Explainer, found: Explanation) -> float | None:
    """Noise that an explanation needs, over that of the quiet samples."""
    width = bin_width(explains.traces)
    quiet = [binned(t.residual[: t.ready.lead.n_samples], width) for t in explains.traces]
    if any(q.size < _LEAST_QUIET for q in quiet):
        return None
    before = np.array([np.mean(q**2) for q in quiet])
    return float(np.sqrt(np.sum(found.noise.sds**2) / np.sum(before)))


def _missing_torque(
    explains: Explainer, found: Explanation, seed: int
) -> tuple[tuple[MissingTorque, ...], np.ndarray]:
    """Torque of all terms, and the coefficients of angle, velocity and acceleration taken out."""
    local, shared = found.posterior.draw(_DRAWS, seed)
    draws = [np.zeros((_DRAWS, t.residual.size)) for t in explains.traces]
    means = [np.zeros(t.residual.size) for t in explains.traces]
    for i in range(len(draws)):
        for t, s in zip(found.terms, found.slices_in(i), strict=True):
            if t.torques is None:
                continue
            drawn = shared if t.shared else local[i]
            mean = found.posterior.common.mean if t.shared else found.posterior.local[i].mean
            draws[i] += drawn[:, s] @ t.torques[i].T
            means[i] += t.torques[i] @ mean[s]
    motion = np.concatenate([t.motion for t in explains.traces])
    scale = np.linalg.norm(motion, axis=0)
    basis, _ = np.linalg.qr(motion / scale)
    ends = np.cumsum([m.size for m in means])[:-1]
    whole, spread = np.concatenate(means), np.concatenate(draws, axis=1)
    slopes = np.linalg.lstsq(motion / scale, whole, rcond=None)[0] / scale
    whole = whole - basis @ (basis.T @ whole)
    spread = spread - (spread @ basis) @ basis.T
    sds = np.std(spread, axis=0)
    out = []
    for trace, mean, sd in zip(
        explains.traces, np.split(whole, ends), np.split(sds, ends), strict=True
    ):
        ready = trace.ready
        out.append(MissingTorque(ready.name, ready.trial.time[ready.first : ready.last], mean, sd))
    return tuple(out), slopes


def _static_map(found: Explanation, slopes: np.ndarray) -> StaticMap:
    place, term = next(
        (s, t) for s, t in zip(found.slices, found.terms, strict=True) if t.key == "static"
    )
    angle, velocity, visited = term.nodes
    weights = found.posterior.common
    torque, sd = np.full((2, angle.size * velocity.size), np.nan)
    linear = (slopes[0] * angle[:, None] + slopes[1] * velocity).ravel()
    torque[visited] = weights.mean[place] - linear[visited]
    sd[visited] = weights.sd[place]
    shape = (angle.size, velocity.size)
    return StaticMap(angle, velocity, torque.reshape(shape), sd.reshape(shape))


def _read_delay(
    explains: Explainer, response: Response, found: Explanation, memory: Term
) -> DelayReadout:
    """Latency and time constant of highest evidence, each pair of them with its own K and B."""

    def evidence(cells: np.ndarray) -> np.ndarray:
        return _delay_evidence(explains, response, found, memory, cells)

    cells = _cells(_COARSE_DELAYS, _COARSE_DECAYS)
    cells = np.concatenate([_cells(np.zeros(1), _FINE_DECAYS), cells[cells[:, 0] > 0]])
    heights = evidence(cells)
    for width in (0.5, 0.15):
        delay, decay = cells[np.argmax(heights)]
        steps = width * np.linspace(-1, 1, 7)
        delays = delay + _COARSE_DELAYS[1] * steps
        decays = decay * 2**steps if decay else np.array([0.0, 0.002, 0.004, 0.007])
        more = _cells(np.unique(np.maximum(delays, 0.0)), decays)
        cells, heights = np.concatenate([cells, more]), np.append(heights, evidence(more))
    weight = np.exp(heights[-len(more) :] - heights.max())
    weight /= weight.sum()
    delay, decay = cells[np.argmax(heights)]
    spread = weight @ (more - weight @ more) ** 2
    at_once = heights[cells[:, 0] == 0].max()
    return DelayReadout(
        float(delay),
        float(np.sqrt(spread[0])),
        float(decay),
        float(np.sqrt(spread[1])),
        float(heights.max() - at_once),
    )


def _cells(delays: np.ndarray, decays: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(delays, decays, indexing="ij"), axis=-1).reshape(-1, 2)


def _delay_evidence(
    explains: Explainer,
    response: Response,
    found: Explanation,
    memory: Term,
    cells: np.ndarray,
) -> np.ndarray:
    """Log evidence, up to a constant, of each latency and time constant; cells of shape (n, 2)."""
    rest = [t for t in found.terms if t is not memory]
    values = [v for t, v in zip(found.terms, found.values, strict=True) if t is not memory]
    local_roots, rest_root = explains.roots(rest, values)
    moving = [_moving(memory, t) for t in explains.traces]
    n_signals = moving[0].shape[1]
    local, common = [], []
    for i, t in enumerate(explains.traces):
        own = [x.columns[i] for x in rest if not x.shared]
        shared = [x.columns[i] for x in rest if x.shared]
        grid = _delayed(moving[i], t, response, cells)
        local.append(np.hstack([*own, explains.background.local[i]]))
        common.append(np.hstack([grid, *shared, explains.background.common[i]]))
    products = inner_products(explains.traces, local, common)
    summed = np.sum(
        [
            eliminate(c.under(found.noise, i), root).products
            for i, (c, root) in enumerate(zip(products, local_roots, strict=True))
        ],
        axis=0,
    )
    # Torques as large as those there were are possible.
    strength = np.sqrt(np.mean(np.concatenate([_torque(t) for t in explains.traces]) ** 2))
    sizes = strength / np.sqrt(np.mean(np.concatenate(moving) ** 2, axis=0))
    root = side_by_side(np.diag(sizes), rest_root)
    always = np.arange(len(cells) * n_signals, len(summed))
    out = np.empty(len(cells))
    for i in range(len(cells)):
        chosen = np.concatenate([i * n_signals + np.arange(n_signals), always])
        left = eliminate(summed[np.ix_(chosen, chosen)], root)
        out[i] = -0.5 * (left.change + left.products[0, 0])
    return out


def _torque(trace: Trace) -> np.ndarray:
    ready = trace.ready
    return trace.imposed if ready.trial.driven == "torque" else ready.compared


def _moving(memory: Term, trace: Trace) -> np.ndarray:
    """Signals that a memory reads, shape (n, m)."""
    if memory.key == "memory":
        return trace.motion[:, :2]
    sign = 1 if memory.key == "memory_positive" else -1
    return sign * np.maximum(sign * trace.velocity, 0)[:, None]


def _delayed(
    signals: np.ndarray, trace: Trace, response: Response, cells: np.ndarray
) -> np.ndarray:
    """What delayed, low-passed signals add to the residual, shape (n, cells * signals)."""
    out = np.empty((len(signals), len(cells), signals.shape[1]))
    for decay in np.unique(cells[:, 1]):
        keep = np.exp(-trace.interval / decay) if decay else 0.0
        felt = response.to(lfilter([1 - keep], [1, -keep], signals, axis=0), trace.interval)
        for i in np.flatnonzero(cells[:, 1] == decay):
            for j in range(signals.shape[1]):
                earlier = trace.time - cells[i, 0]
                out[:, i, j] = np.interp(earlier, trace.time, felt[:, j], left=0.0)
    return out.reshape(len(signals), -1)


def _sentence(result: Unexplained) -> str:
    best = result.best
    if best.kind == "none":
        words = "What is left is noise: nothing in it depends on the motion or repeats."
        if result.noise_ratio is not None and result.noise_ratio > 1.5:
            words = (
                "What is left looks like noise, but of "
                f"{result.noise_ratio:.1f} times the size it has before the perturbation."
            )
        return words
    readout = result.delay_readout
    lead = {
        "drift": "is a slow drift of the recording",
        "sensor": "looks as if the recording were filtered or delayed",
        "static": "behaves like a torque that depends on the present angle and velocity",
        "hysteresis": (
            "behaves like dry friction or a yielding element: a torque that depends on how far the "
            "joint has moved since it turned back"
        ),
        "memory": "behaves like a torque that depends on the past motion",
        "unrepeatable": (
            "is a torque that differs from trial to trial: no one function of the motion makes it"
        ),
    }[best.kind]
    main = max(best.shares, key=lambda key: best.shares[key])
    if main in ("variation", "varying"):
        when = "from trial to trial" if main == "variation" else "during the trials"
        lead = f"behaves like stiffness and damping that change {when}"
    if best.kind == "memory" and readout is not None:
        if readout.nats >= DECISIVE + _CLEAR * result.margin and readout.delay >= _FELT:
            lead += f", with a latency of about {1000 * readout.delay:.0f} ms"
        else:
            lead += f", and fades with a time constant of about {1000 * readout.decay:.0f} ms"
    if main in ("memory_positive", "memory_negative"):
        lead += f", and to motion in the {main.removeprefix('memory_')} direction only"
    words = f"What is left {lead}"
    if best.kind != "unrepeatable":
        words += f"; that explains {100 * result.share:.0f} % of it beyond the noise"
    return words + "."
