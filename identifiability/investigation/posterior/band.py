"""Trials as the likelihood compares them: all that was recorded, but for what noise drowns.

Where the angle was imposed the torque is predicted from its derivatives. Above the frequency where
the angle is noise more than motion there is nothing to learn, and everything to misread: there both
channels are cut off, by one filter, and so few samples are compared that none lies beyond it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from identifiability.errors import InputError
from identifiability.inference.between import Between, joined
from identifiability.inference.problem import Observation, Prior, Problem
from identifiability.inference.starts import plain_values
from identifiability.investigation.pieces import MOST_SAMPLES, owners, pieces, remembering
from identifiability.investigation.posterior import between
from identifiability.investigation.posterior.halving import (
    KEPT,
    Window,
    halve,
    halved,
    without_level,
)
from identifiability.joint.model import Model
from identifiability.joint.scheme import Scheme
from identifiability.measurement.filtering import (
    HIGHEST_HZ,
    Lowpass,
    cutoff,
    known_noise,
    noise_cutoff,
    rounding_step,
)
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import imposed_motion
from identifiability.measurement.prepared import Prepared, prepare_whole_band
from identifiability.measurement.splitting import Rule, halves
from identifiability.measurement.trials import Trial

_ENOUGH = 3.9  # samples a cycle of the cut-off, of which every other one is enough
_SAME_RATE = 1e-3
_AROUND, _STANDS = 5, 0.6  # samples; steps: a filter makes less of one
_MOST_PROBED = 2_048  # samples of which noise of an imposed angle is told
_PROBED = 0.5  # share of those by which fits are begun, at most
_CLEAR = 10.0  # times the noise that the motion is, up to the cut-off


@dataclass(frozen=True, eq=False)
class Band:
    """Trials that models are fitted to, and how they are compared.

    Attributes
    ----------
    prepared : tuple of Prepared
        Sampled alike.
    whole : tuple of Prepared
        The same, moved by the whole of an imposed motion; none where nothing was cut off.
    every : int
        One sample in so many is compared.
    bounds : mapping of str to (float, float)
        Other bounds than the physical ones, by parameter name.
    angle_noise : float
        Standard deviation [rad] of the white noise that an imposed angle is known to have.
    step : float
        To multiples of which the angle was rounded [rad]; 0 where it was not.
    changed : tuple of tuple of array
        What leaving out every other sample changes, by trial: see `between`. Of an imposed angle.
    recorded : tuple of Trial
        The trials before they were thinned and cut off at `cutoff_hz`. Of an imposed angle.
    cutoff_hz : float
    most : int
        Samples that are compared, of long records; about so many.
    """

    prepared: tuple[Prepared, ...]
    every: int
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    angle_noise: float = 0.0
    step: float = 0.0
    changed: tuple[tuple[np.ndarray, ...], ...] = ()
    recorded: tuple[Trial, ...] = ()
    cutoff_hz: float = np.inf
    most: int = MOST_SAMPLES
    whole: tuple[Prepared, ...] = ()

    def without(self, rule: Rule, numbers: Collection[int]) -> Band:
        """The same without what an investigation holds out: trials, or half of one.

        Parameters
        ----------
        rule : str
            How it is held out: see `Parts`.
        numbers : collection of int
            Of the trials that are.
        """
        if numbers:
            kept = [i for i in range(len(self.prepared)) if i not in numbers]
            changed = tuple(tuple(by_trial[i] for i in kept) for by_trial in self.changed)
            return replace(
                self,
                prepared=tuple(self.prepared[i] for i in kept),
                whole=tuple(p for i, p in enumerate(self.whole) if i in kept),
                changed=changed,
                recorded=tuple(t for i, t in enumerate(self.recorded) if i in kept),
            )
        half = rule == "first half"
        prepared, whole = (
            tuple(halves(p)[half] for p in both) for both in (self.prepared, self.whole)
        )
        return replace(self, prepared=prepared, whole=whole)

    @property
    def angle_imposed(self) -> bool:
        """Whether the angle was imposed, and the torque is predicted."""
        return self.prepared[0].trial.driven == "angle"

    @property
    def interval(self) -> float:
        """Time [s] between compared samples."""
        return self.prepared[0].interval * self.every

    @cached_property
    def observations(self) -> list[Observation]:
        """The trials, long ones in pieces; residuals are in the response's unit."""
        return [o for o, _ in self._placed]

    def sees_whole(self, model: Model) -> bool:
        """Whether a model is given the whole motion, and its torque passes the filter."""
        return bool(self.whole) and not model.linear

    def earlier(self, model: Model) -> list[int]:
        """Samples that a model is given before those of each observation."""
        if not self.sees_whole(model):
            return [0] * len(self.observations)
        return [window.earlier for window in self._windows]

    @cached_property
    def _windows(self) -> list[Window]:
        return self._whole(self.whole)

    def _whole(self, whole: Sequence[Prepared]) -> list[Window]:
        """Pieces as they are placed, of trials moved by their whole motions."""
        placed = zip(self._placed, self.trial, strict=True)
        return [Window.of(whole[trial], piece, span) for (piece, span), trial in placed]

    def compared(
        self, rows: np.ndarray, problem: Problem, *, differ: bool = False
    ) -> list[np.ndarray]:
        """Of a model's residuals and their derivatives what is compared, by stretch.

        Parameters
        ----------
        rows : array, shape (n_observations, n, k)
            By observation of the model's problem and sample; the residual, then derivatives.
        problem : Problem
            Which may have another response to the same motion than was recorded.
        differ : bool
            Whether the first column too is a difference, of two residuals.
        """
        if not self.sees_whole(problem.model):
            return self.stretches(rows)
        trials = problem.observations[: len(rows)]
        seen = [
            window.compared(mine, self.every, None if differ else one.measured)
            for window, mine, one in zip(self._windows, rows, trials, strict=True)
        ]
        return without_level(seen, self.trial)

    def residuals(self, problem: Problem, x: np.ndarray) -> list[np.ndarray]:
        """What a model of these trials leaves of all that is compared, by stretch, shape (n, 1)."""
        rows = problem.by_observation(problem.values(x)[:, None])
        return self.compared(rows[: len(self.observations)], problem)

    def responses(self, problem: Problem, x: np.ndarray) -> list[np.ndarray]:
        """Response of a model of these trials, between the ends of each stretch."""
        found = problem.responses(x)
        if not self.sees_whole(problem.model):
            return [one[window] for one, window in zip(found, self.windows, strict=True)]
        return [
            window.compared(one[:, None], 1)[:, 0]
            for one, window in zip(found, self._windows, strict=True)
        ]

    @cached_property
    def windows(self) -> list[np.ndarray]:
        """Of each observation, the samples between which it is compared."""
        return [np.flatnonzero(o.scale > 0) for o in self.observations]

    @cached_property
    def samples(self) -> list[np.ndarray]:
        """Of each observation, the samples that are compared: a stretch of correlated noise."""
        return [window[:: self.every] for window in self.windows]

    @cached_property
    def trial(self) -> np.ndarray:
        """Number of the trial that each observation belongs to."""
        return owners(self.observations)

    @cached_property
    def probed_ones(self) -> np.ndarray:
        """Numbers of the observations that are probed: of long records some of the pieces.

        A probe costs what the piece itself does, and tells only how much more noise a model makes
        of an imposed angle than another.
        """
        share = min(1.0, _MOST_PROBED / self.n_samples)
        if self.most < MOST_SAMPLES:
            share = min(share, _PROBED)  # of what begins fits
        chosen = []
        for trial in np.unique(self.trial):
            mine = np.flatnonzero(self.trial == trial)
            n = max(1, round(share * mine.size))
            middles = (np.arange(n) + 0.5) * mine.size / n
            chosen.append(mine[middles.astype(int)])
        return np.concatenate(chosen)

    @cached_property
    def spans(self) -> list[slice]:
        """Of each observation, its place among the samples of its trial, between its ends."""
        return [span for _, span in self._placed]

    def between(self, joint: np.ndarray) -> list[np.ndarray]:
        """Variance [Nm²] of what is not known between the samples, by stretch.

        Parameters
        ----------
        joint : array, shape (3,)
            K, B and I by which the motion shows in the torque.
        """
        if not self.changed:
            return [np.zeros(chosen.size) for chosen in self.samples]
        places = [
            (int(trial), slice(span.start, span.stop, self.every))
            for trial, span in zip(self.trial, self.spans, strict=True)
        ]
        return between.variances(self.changed, joint, places)

    @cached_property
    def n_recorded(self) -> int:
        """Number of samples that could be compared."""
        return sum(-(-(p.last - p.first) // self.every) for p in self.prepared)

    @cached_property
    def _placed(self) -> list[tuple[Observation, slice]]:
        return self._pieces(self.prepared)

    def _pieces(self, prepared: Sequence[Prepared]) -> list[tuple[Observation, slice]]:
        """Trials in pieces with their places, of long records as many as are compared."""
        share = min(1.0, self.most / self.n_recorded)
        out: list[tuple[Observation, slice]] = []
        for p in prepared:
            every = pieces(p, Noise(1.0), shortly=self.most < MOST_SAMPLES)
            ends = p.first + np.cumsum([0, *(np.count_nonzero(o.scale > 0) for o in every)])
            n = max(1, round(share * len(every)))
            kept = np.linspace(0, len(every), n, endpoint=False) + 0.5 * (len(every) / n - 1)
            chosen = [int(i) for i in np.round(kept)]
            # The pieces that are left share the record's one offset.
            norm = np.sqrt(sum(np.sum(every[i].constant ** 2) for i in chosen))
            for i in chosen:
                one = every[i]
                if n < len(every):
                    shared = one.constant / (norm if norm > 0 else 1.0)
                    one = replace(one, constant=shared, continues=i != chosen[0])
                out.append((one, slice(int(ends[i]), int(ends[i + 1]))))
        return out

    @cached_property
    def n_samples(self) -> int:
        """Number of compared samples."""
        return sum(chosen.size for chosen in self.samples)

    @cached_property
    def scale(self) -> float:
        """Root mean square of the response about its level [rad or Nm]."""
        levelled = [
            o.measured[chosen] - o.measured[chosen].mean()
            for o, chosen in zip(self.observations, self.samples, strict=True)
        ]
        return float(np.sqrt(np.mean(np.concatenate(levelled) ** 2)))

    def probed(self, sd: float, seed: int, *, whole: bool = False) -> list[np.ndarray]:
        """Angles of the trials with noise of this standard deviation [rad].

        Of even power at all frequencies: chance would give a narrow resonance what to feed on.

        Parameters
        ----------
        sd : float
        seed : int
        whole : bool
            Whether of the whole motion, with noise of which the filter leaves as much.
        """
        random = np.random.default_rng(seed)
        out = []
        for p in self.whole if whole else self.prepared:
            n = p.trial.n_samples
            phases = random.uniform(0.0, 2 * np.pi, n // 2 + 1)
            noise = np.fft.irfft(np.exp(1j * phases), n)
            noise /= noise.std()
            if whole:
                noise /= KEPT
            elif self.every > 1:
                noise = halve(noise, p.trial.angle) / KEPT
            out.append(p.trial.angle + sd * noise)
        return out

    def moved(self, angles: Sequence[np.ndarray], *, whole: bool = False) -> list[Observation]:
        """The observations that are probed, moved by other angles [rad], one by trial."""
        moved = [
            replace(p, drive=imposed_motion(p.trial.time, angle))
            for p, angle in zip(self.whole if whole else self.prepared, angles, strict=True)
        ]
        if whole:
            every_window = self._whole(moved)
            return [every_window[i].observation for i in self.probed_ones]
        every = self._pieces(moved)
        return [every[i][0] for i in self.probed_ones]

    def motions(self) -> list[np.ndarray]:
        """Imposed angles [rad], as far as they are compared, at the times they were recorded at."""
        return [
            CubicSpline(p.trial.time, p.trial.angle)(np.clip(t.time, *p.trial.time[[0, -1]]))
            for p, t in zip(self.prepared, self.recorded, strict=True)
        ]

    def responding(self, changes: Sequence[np.ndarray]) -> list[Observation]:
        """The observations, had the recorded torques been so different [Nm], one by trial."""
        different = [
            replace(t, torque=t.torque + change)
            for t, change in zip(self.recorded, changes, strict=True)
        ]
        ready, _ = _moved_by_angles(different, self.cutoff_hz)
        pairs = zip(self.prepared, ready, strict=True)
        return [o for o, _ in self._pieces([replace(p, response=r.response) for p, r in pairs])]

    @property
    def stands(self) -> list[np.ndarray]:
        """Of each trial, the samples about which the angle does not leave one rounding step."""
        out = []
        for p in self.prepared:
            angle = p.trial.angle
            around = maximum_filter1d(angle, _AROUND) - minimum_filter1d(angle, _AROUND)
            out.append(around < _STANDS * self.step)
        return out

    def problem(
        self,
        model: Model,
        *,
        refined: Sequence[str] = (),
        scheme: Scheme | None = None,
        probes: Sequence[Observation] = (),
    ) -> Problem:
        """Problem of fitting a model to the trials, with probes after them."""
        names = model.parameter_names
        # A resonance beyond them cannot be seen: one there mends what lies between the samples.
        seen = 0.5 / self.interval
        bounds = {
            n: (p.lower, seen)
            for n, p in model.parameters.items()
            if p.unit == "Hz" and p.lower < seen < p.upper
        }
        bounds |= {n: b for n, b in self.bounds.items() if n in names}
        own = self.observations
        if self.sees_whole(model):
            own = [window.observation for window in self._windows]
        return Problem(
            model,
            [*own, *probes],
            Prior.recorded(model, **bounds),
            fixed=plain_values(model, refined),
            scheme=scheme,
        )

    def stretches(self, rows: np.ndarray) -> list[np.ndarray]:
        """Compared samples of values by observation and sample, shape (n_observations, n, ...)."""
        return [rows[i][chosen] for i, chosen in enumerate(self.samples)]


def band_of(
    trials: Sequence[Trial],
    held_out: Sequence[Trial],
    *,
    lowpass_hz: Lowpass = "auto",
    torque_between: Between = "auto",
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Band:
    """Make the trials of an investigation ready for the likelihood.

    Parameters
    ----------
    trials, held_out : sequence of Trial
        As of the investigation. All are compared: what a set of effects says of a condition in
        which others fail is what tells them apart.
    lowpass_hz : float, "auto" or None
        Where the angle is imposed, the frequency [Hz] above which it is noise: see `cutoff`.
    torque_between : {"auto", "straight", "smooth"}
        How an imposed torque runs between its samples: see `joined`.
    bounds : mapping of str to (float, float), optional
        Other bounds than the physical ones.

    Raises
    ------
    InputError
        Where the trials' rates are no multiples of the lowest.
    """
    recorded = [*trials, *held_out]
    every = _alike(recorded)
    if lowpass_hz == "auto" and every[0].driven == "angle":
        lowpass_hz = noise_cutoff(every, _CLEAR)
    step = max(rounding_step(trial.angle) for trial in recorded)
    if every[0].driven == "torque":
        ready = tuple(remembering(joined(prepare_whole_band(every), torque_between)))
        return Band(ready, 1, dict(bounds or {}), step=step)
    cutoff_hz = cutoff(every, lowpass_hz) or HIGHEST_HZ
    fitted, whole = _moved_by_angles(every, cutoff_hz)
    noise = known_noise(recorded, fitted[0].trial.sampling_rate)
    if whole:
        noise *= KEPT
    changed = tuple(
        tuple(between.changes(fitted, _moved_by_angles(between.left_out(every, i), cutoff_hz)[0]))
        for i in (0, 1)
    )
    return Band(
        fitted,
        1 + bool(whole),
        dict(bounds or {}),
        angle_noise=noise,
        step=step,
        changed=changed,
        recorded=tuple(every),
        cutoff_hz=float(cutoff_hz),
        whole=whole,
    )


def _moved_by_angles(
    trials: Sequence[Trial], cutoff_hz: float
) -> tuple[tuple[Prepared, ...], tuple[Prepared, ...]]:
    """Trials whose angle was imposed, prepared.

    And the same moved by their whole motions, where the upper half of the band was cut off.
    """
    fitted = tuple(remembering(prepare_whole_band(trials, lowpass_hz=cutoff_hz)))
    if fitted[0].trial.sampling_rate < _ENOUGH * cutoff_hz:
        return fitted, ()
    pairs = [halved(p) for p in fitted]
    return tuple(one for one, _ in pairs), tuple(whole for _, whole in pairs)


def _alike(trials: list[Trial]) -> list[Trial]:
    """Trials at the lowest of their rates, where it goes into the others."""
    intervals = [1 / trial.sampling_rate for trial in trials]
    factors = [round(max(intervals) / interval) for interval in intervals]
    odd = [abs(f * i / max(intervals) - 1) for f, i in zip(factors, intervals, strict=True)]
    if max(odd) > _SAME_RATE:
        raise InputError(
            f"found trials sampled every {min(intervals):g} to {max(intervals):g} s, expected one "
            "rate for all whose effects are weighed together, or multiples of one; resample them"
        )
    return [t.thinned(f) if f > 1 else t for t, f in zip(trials, factors, strict=True)]
