"""Explanations of a residual by Gaussian processes, fitted by their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.unexplained.background import Background, background
from identifiability.investigation.unexplained.likeliest import HIGHEST_RHO, Likeliest, likeliest
from identifiability.investigation.unexplained.linear_gaussian import (
    Columns,
    Posterior,
    TrialNoise,
    side_by_side,
)
from identifiability.investigation.unexplained.terms import Term, Terms
from identifiability.investigation.unexplained.traces import (
    Response,
    Trace,
    follow,
    inner_products,
    traces_of,
)

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

REMAINDER = "unrepeatable"
"""Key of the term that every trial has for itself."""
_WEAK = 0.1  # of the size that explains the whole residual
_CLEAR = 30.0  # nats over noise alone of what is not weak


@dataclass(frozen=True, eq=False)
class Family:
    """One explanation of the residual.

    Attributes
    ----------
    key : str
        Keys of its terms joined by "+"; a remainder of its own in each trial is not named.
    name : str
    kind : str
        "none", "drift", "sensor", "static", "hysteresis", "memory" or "unrepeatable": that of the
        part with the largest share.
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
        keys = [t.key for t in self.terms if t.key != REMAINDER or len(self.terms) == 1]
        return "+".join(keys) or "none"

    @property
    def remainder(self) -> bool:
        """Whether there is a torque of its own in each trial besides other terms."""
        return len(self.terms) > 1 and any(t.key == REMAINDER for t in self.terms)

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
        kept = np.array([*(t.key == REMAINDER for t in self.terms), True], float)
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
        columns = self.columns(terms)

        def ended(values: Sequence[np.ndarray], noise: TrialNoise) -> Likeliest:
            roots = partial(self.roots, terms)
            return likeliest(terms, columns, roots, values, noise, sizes_only=sizes_only)

        if not terms:
            found = self._alone
        else:
            found = ended(starts or [t.start for t in terms], self._first_noise())
        if terms and starts is None and found.log_evidence < self._alone.log_evidence + _CLEAR:
            # From a size that explains all no slope may lead to a weak one.
            weak = [np.append(_WEAK * t.start[: t.n_scales], t.start[t.n_scales :]) for t in terms]
            found = max(found, ended(weak, self._alone.noise), key=lambda f: f.log_evidence)
        posterior = Posterior(columns, found.noise, *self.roots(terms, found.values))
        penalty = 0.5 * sum(len(t.start) for t in terms) * np.log(self.n_samples)
        evidence = found.log_evidence - penalty
        return Explanation(tuple(terms), tuple(found.values), found.noise, evidence, posterior)

    @cached_property
    def _alone(self) -> Likeliest:
        """Noise without any term."""
        return likeliest([], self.columns([]), partial(self.roots, []), [], self._first_noise())

    def _first_noise(self) -> TrialNoise:
        """Noise as the quiet samples show it, or as the residual's quickest changes do."""
        sds, rho = [], 0.0
        for t in self.traces:
            lead = t.ready.lead
            scatter = np.std(np.diff(t.residual)) / np.sqrt(2)
            sds.append(max(lead.sd if lead.n_samples else scatter, 1e-9 * np.std(t.ready.compared)))
            rho = max(rho, (lead.correlation_time - 1) / (lead.correlation_time + 1))
        return TrialNoise(np.array(sds), min(rho, HIGHEST_RHO))


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
    own = background(traces, candidate, terms[REMAINDER])
    return Explainer(traces, own, terms), response
