"""Noise of one model's residual, and the residual that it whitens.

Every model is judged by the noise that it leaves, in level and colour: a model that fits better has
to show it in less noise, and is not measured by the noise of another.

Noise of an imposed angle is carried over to the torque by the joint, and makes every parameter that
amplifies it too small. How much it adds to the sum of squares is computed for any model by probes:
the same trials with more such noise. It is taken off, as in `inference.likelihood.coloured`, where
K, B and I suffice to say how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import local

import numpy as np

from identifiability.inference.likelihood.carried import by_admittance, by_impedance
from identifiability.inference.likelihood.coloured import excess_of
from identifiability.inference.likelihood.estimate import (
    Contender,
    NoiseEstimate,
    Stretch,
    estimate_noise,
)
from identifiability.inference.likelihood.processes import Process, Whitening
from identifiability.inference.problem import Observation, Problem
from identifiability.investigation.posterior.band import Band
from identifiability.joint.model import Model

_CEILING = 6.0  # of what probes take off, so that the rest of the sum of squares stays positive
# What is taken off a model that is weighed, beyond what is taken off the reference, at most: a
# share of that and of the samples. One that resonates would amplify the probes where by chance the
# noise itself is weak.
_MOST_MORE = 0.1
_HUGE = 1e30  # stands for a response without bound
_PROBE = 1e-4  # size over the angle's: small, so that no model is moved out of its linear range
_NO_EXCESS = 1e-6  # sum of squares that is none


@dataclass(frozen=True, eq=False)
class Weights:
    """Whitening by the noise of one model.

    Attributes
    ----------
    band : Band
    estimate : NoiseEstimate
    contenders : tuple of Contender
        The orders that came nearest, the best first.
    gain : float
        What a probe is multiplied by to have the size of the noise of the angle; 0 without.
    excess : float
        Sum of squares that this noise adds at the reference joint.
    between : sequence of array
        By stretch, variance of what is not known between the samples; none where all of it is.
    """

    band: Band
    estimate: NoiseEstimate
    contenders: tuple[Contender, ...]
    gain: float = 0.0
    excess: float = 0.0
    between: Sequence[np.ndarray] = ()

    @property
    def n_parameters(self) -> int:
        """Number of the noise's parameters, the level not counted; levels by trial are."""
        levels = self.estimate.levels
        return self.contenders[0].order.size + (levels.size - 1) * bool(np.ptp(levels) > 0)

    @cached_property
    def _whitenings(self) -> list[Whitening]:
        """By stretch, for residuals over their trial's level."""
        noise, levels = self.estimate.noise, self.estimate.levels
        if not self.between:
            shared = noise.whitening(max(s.size for s in self.band.samples))
            return [shared] * len(self.band.samples)
        return [
            noise.whitening(extra.size, extra / levels[trial] ** 2)
            for extra, trial in zip(self.between, self.band.trial, strict=True)
        ]

    def whitened(self, by_stretch: Sequence[np.ndarray]) -> np.ndarray:
        """Columns of all stretches, whitened and without a level in each."""
        return np.concatenate(
            [
                whitening.without_level(columns / self.estimate.levels[trial])[0]
                for whitening, columns, trial in zip(
                    self._whitenings, by_stretch, self.band.trial, strict=True
                )
            ]
        )

    @cached_property
    def log_determinant(self) -> float:
        """Of the covariance of all samples, unknown levels of the stretches marginalised."""
        total = 0.0
        for whitening, chosen, trial in zip(
            self._whitenings, self.band.samples, self.band.trial, strict=True
        ):
            level, n = float(self.estimate.levels[trial]), chosen.size
            length = np.linalg.norm(whitening(np.ones((n, 1)))) / level
            total += whitening.log_determinant(n) + 2 * n * np.log(level)
            total += 2 * np.log(length)
        return float(total)

    def draw(self, generator: np.random.Generator) -> list[np.ndarray]:
        """Draw such noise [rad or Nm] for each stretch."""
        out = []
        for i, (chosen, trial) in enumerate(zip(self.band.samples, self.band.trial, strict=True)):
            parts = [part.draw(chosen.size, generator) for part in self.estimate.noise.parts]
            noise = self.estimate.levels[trial] * np.sum(parts, axis=0)
            if self.between:
                noise += np.sqrt(self.between[i]) * generator.standard_normal(chosen.size)
            out.append(noise)
        return out


def raw_residuals(
    problem: Problem, band: Band, x: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray] | None]:
    """Residual and its derivatives by stretch, side by side; the same of what probes change.

    That is 0 in stretches that are not probed.
    """
    residuals = problem.by_observation(problem.residuals(x)[:, None])
    derivatives = problem.by_observation(problem.jacobian(x))
    return _of_trials_and_probes(np.concatenate([residuals, derivatives], axis=2), problem, band)


def _raw_values(
    problem: Problem, band: Band, x: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray] | None]:
    """`raw_residuals` without derivatives, which take as long again."""
    return _of_trials_and_probes(problem.by_observation(problem.values(x)[:, None]), problem, band)


def _of_trials_and_probes(
    every: np.ndarray, problem: Problem, band: Band
) -> tuple[list[np.ndarray], list[np.ndarray] | None]:
    n, rows = len(problem.observations), len(band.observations)
    every = np.clip(np.nan_to_num(every, nan=_HUGE), -_HUGE, _HUGE)
    trials = band.compared(every[:rows], problem)
    if n == rows:
        return trials, None
    changed = np.zeros_like(every[:rows])
    changed[band.probed_ones] = every[rows:n] - every[band.probed_ones]
    return trials, band.compared(changed, problem, differ=True)


@dataclass(frozen=True, eq=False)
class Weighed:
    """A problem whose residuals are whitened by given noise: what `explore` needs of one.

    Attributes
    ----------
    problem : Problem
        Of the band's observations, then of its probes where there are any.
    band : Band
    weights : Weights
    finds_reference : bool
        Whether this is K, B and I, sought from a start that noise of the angle made too small.
    """

    problem: Problem
    band: Band
    weights: Weights
    finds_reference: bool = False
    _last: local = field(default_factory=local, init=False, repr=False)

    @property
    def model(self) -> Model:
        """The problem's."""
        return self.problem.model

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.problem.names

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the free parameters."""
        return self.problem.lower

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the free parameters."""
        return self.problem.upper

    def whitened(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """What `raw_residuals` gives, whitened, all stretches in one."""
        return self.of(*raw_residuals(self.problem, self.band, x))

    def of(
        self, trials: Sequence[np.ndarray], probes: Sequence[np.ndarray] | None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The same, of what `raw_residuals` gave."""
        white = self.weights.whitened(trials)
        if probes is None:
            return white, None
        return white, self.weights.gain * self.weights.whitened(probes)

    def squares(self, x: np.ndarray) -> float:
        """Sum of squared whitened residuals, as it is expected without noise of the angle."""
        # Elsewhere code without derivatives takes longer to compile than they do.
        raw = _raw_values if self.problem.takes_long else raw_residuals
        return self.squares_of(*self.of(*raw(self.problem, self.band, x)))

    def squares_of(self, white: np.ndarray, probe: np.ndarray | None) -> float:
        """The same, of what `whitened` gave."""
        total = float(white[:, 0] @ white[:, 0])
        if probe is None:
            return total
        share = float(probe[:, 0] @ probe[:, 0])
        return total + self.weights.excess - min(share, self.most_taken)

    def takes_all(self, probe: np.ndarray) -> bool:
        """Whether all noise of the angle is taken off; beyond that the squares have no slope of it.

        Parameters
        ----------
        probe : array, shape (n, 1 + n_free)
            As `whitened` gives it.
        """
        return float(probe[:, 0] @ probe[:, 0]) < self.most_taken

    def taken_more(self, probe: np.ndarray) -> float:
        """What is taken off the sum of squares beyond what is at the reference."""
        share = float(probe[:, 0] @ probe[:, 0])
        return max(0.0, min(share, self.most_taken) - self.weights.excess)

    @property
    def most_taken(self) -> float:
        """Most that is taken off the sum of squares for noise of the angle."""
        excess = max(self.weights.excess, _NO_EXCESS)
        if self.finds_reference:
            return 0.9 * _CEILING * excess
        more = _MOST_MORE * min(excess, self.band.n_samples)
        # Of what is taken off for noise that is not there half counts as evidence.
        error = self.weights.estimate.carried_error
        return excess + min(more, 1 / error if error else more)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Whitened residuals; with probes one more, less the larger the noise's share is."""
        return self._both(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of `residuals`."""
        return self._both(x)[1]

    def _both(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, last = np.asarray(x, float), self._last
        if not hasattr(last, "x") or not np.array_equal(last.x, x):
            last.x, last.both = x.copy(), self.linear(*self.whitened(x))
        found: tuple[np.ndarray, np.ndarray] = last.both
        return found

    def linear(self, white: np.ndarray, probe: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives, of what `whitened` gave."""
        residuals, jacobian = white[:, 0], white[:, 1:]
        if probe is not None:
            ceiling = _CEILING * max(self.weights.excess, _NO_EXCESS)
            share = float(probe[:, 0] @ probe[:, 0])
            rest = np.sqrt(ceiling - min(share, self.most_taken))
            slope = -(probe[:, 1:].T @ probe[:, 0]) / rest
            residuals = np.append(residuals, rest)
            jacobian = np.vstack([jacobian, slope * (share < self.most_taken)])
        return residuals, jacobian


@dataclass(frozen=True, eq=False)
class Reference:
    """The joint by which noise is carried from one channel to the other, the same for all models.

    Attributes
    ----------
    band : Band
    joint : array, shape (3,)
        Its K, B and I.
    probed : list of array
        Angles [rad] of the trials with more noise; none where the torque is imposed.
    probes : list of Observation
        The observations moved by them.
    whole_probes : list of Observation
        The same of whole motions, for models that are given these.
    probe_problem : Problem or None
        K, B and I with these probes.
    """

    band: Band
    joint: np.ndarray
    probed: list[np.ndarray] = field(default_factory=list)
    probes: list[Observation] = field(default_factory=list)
    whole_probes: list[Observation] = field(default_factory=list)
    probe_problem: Problem | None = None

    @property
    def carried(self) -> Process:
        """What white noise of the other channel, of standard deviation 1, adds to the response."""
        carry = by_impedance if self.band.angle_imposed else by_admittance
        return carry(self.joint, self.band.interval)

    def excess(self, estimate: NoiseEstimate) -> float:
        """Sum of squares that noise of the angle is expected to add at this joint."""
        band = self.band
        if not band.angle_imposed:
            return 0.0
        form = excess_of([estimate], [band.n_samples], [band.interval])
        return 0.0 if form is None else float(self.joint @ form @ self.joint)

    @classmethod
    def of(cls, band: Band, joint: np.ndarray, problem: Problem, seed: int) -> Reference:
        """A joint, with probes where the angle is imposed.

        Parameters
        ----------
        band : Band
        joint : array, shape (3,)
        problem : Problem
            K, B and I of the band.
        seed : int
            Of the probes.
        """
        if not band.angle_imposed:
            return cls(band, joint)
        size = float(np.mean([np.std(p.trial.angle) for p in band.prepared]))
        probed = band.probed(_PROBE * size, seed)
        probes, whole = band.moved(probed), []
        if band.whole:
            angles = band.probed(_PROBE * size, seed, whole=True)
            whole = band.moved(angles, whole=True)
        with_probes = replace(problem, observations=[*band.observations, *probes])
        return cls(band, joint, probed, probes, whole, with_probes)

    def probes_of(self, model: Model) -> list[Observation]:
        """The observations with more noise, moved by what a model is given."""
        return self.whole_probes if self.band.sees_whole(model) else self.probes

    def weights(
        self, raw: Sequence[np.ndarray], tried: Sequence[Contender], like: Weights | None = None
    ) -> Weights:
        """Estimate the noise of a residual.

        Parameters
        ----------
        raw : sequence of array
            By stretch, the residual, then derivatives that the fit took out of it.
        tried : sequence of Contender
            See `estimate_noise`.
        like : Weights, optional
            Noise of the same record, of which it is known how well the carried part's size is.
        """
        with_error = self.band.angle_imposed and like is None
        weights = self._estimated(raw, tried, with_error)
        if like is not None:
            known = replace(weights.estimate, carried_error=like.estimate.carried_error)
            weights = replace(weights, estimate=known)
        estimate = weights.estimate
        if self.probe_problem is None:
            return weights
        # One probe is a draw: its size at this joint is set to what is expected there.
        excess = self.excess(estimate)
        drawn = weights.whitened(self.raw_probes)
        gain = np.sqrt(excess / max(float(np.sum(drawn**2)), 1e-300))
        return replace(weights, gain=float(gain), excess=excess)

    @cached_property
    def raw_probes(self) -> list[np.ndarray]:
        """By stretch, what the probes add to the residual of this joint, shape (n, 1)."""
        assert self.probe_problem is not None
        x = self.probe_problem.free_vector(self._values)
        _, probes = raw_residuals(self.probe_problem, self.band, x)
        assert probes is not None
        return [probe[:, :1] for probe in probes]

    def adopted(self, weights: Weights) -> Weights:
        """Noise that was estimated of other samples of the same trials."""
        share = self.band.n_samples / weights.band.n_samples
        excess = share * weights.excess
        return replace(weights, band=self.band, excess=excess, between=self.between)

    def _estimated(
        self, raw: Sequence[np.ndarray], tried: Sequence[Contender], with_error: bool
    ) -> Weights:
        between = self.between if self.between else [None] * len(raw)
        stretches = [
            Stretch(columns[:, 0], columns[:, 1:], int(trial), beside)
            for columns, trial, beside in zip(raw, self.band.trial, between, strict=True)
        ]
        estimate, best = estimate_noise(
            stretches, self.carried, tried, self.band.angle_noise, with_error=with_error
        )
        return Weights(self.band, estimate, best, between=self.between)

    @cached_property
    def between(self) -> list[np.ndarray]:
        """By stretch, variance of what is not known between the samples; none where all is."""
        found = self.band.between(self.joint)
        return found if any(one.any() for one in found) else []

    @property
    def _values(self) -> dict[str, float]:
        return dict(zip(("K", "B", "I"), map(float, self.joint), strict=True))
