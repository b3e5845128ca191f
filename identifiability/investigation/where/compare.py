"""How well a model fits each trial, and whether its K, B and I are the same in all of them.

A joint that is what the model says has one K, B and I, whatever the window after a perturbation,
its size, its direction or its kind. They are fitted anew to each part, the model's other parameters
held, and their constancy is tested: with SS_g(x) the sum of squares of group g at parameters x,
scaled by its own residual variance times autocorrelation time, the increase of the sum from own to
common parameters follows chi-square, over its degrees of freedom F, if they are constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import stats

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import (
    NAMES,
    UNKNOWN_LEVEL,
    Refit,
    Refits,
    Take,
    without_levels,
)
from identifiability.investigation.split import Split
from identifiability.investigation.where import groups
from identifiability.investigation.where.groups import Group, Unit
from identifiability.investigation.where.imposed import Imposed, imposed
from identifiability.investigation.where.whitening import Whitening, whitening
from identifiability.measurement.noise import correlation_time

Aspect = Literal["window", "amplitude", "direction", "condition", "trial"]


@dataclass(frozen=True)
class TrialRow:
    """How well a trial is described.

    Attributes
    ----------
    name, condition : str
    amplitude : float
        Largest departure of the imposed signal from its start [Nm or rad].
    direction : int
        Sign of the main response; 0 where it goes to both sides alike.
    error : float
        E (Eq. 3).
    vaf : float
        Variance accounted for [%].
    rms : float
        Root mean square of the residual [rad or Nm].
    noise_ratio : float or None
        The same over the noise's; ``None`` where the noise is unknown.
    n_samples : int
    """

    name: str
    condition: str
    amplitude: float
    direction: int
    error: float
    vaf: float
    rms: float
    noise_ratio: float | None
    n_samples: int


@dataclass(frozen=True, eq=False)
class Estimate:
    """K, B and I fitted to a group of samples.

    Attributes
    ----------
    label : str
    values, errors : array, shape (3,)
        With approximate standard errors; infinite where the group does not determine them.
    n_samples : int
    n_independent : float
        Samples that count as independent.
    at_bound : tuple of str
    """

    label: str
    values: np.ndarray
    errors: np.ndarray
    n_samples: int
    n_independent: float
    at_bound: tuple[str, ...]


@dataclass(frozen=True)
class Change:
    """How one of K, B and I differs between two groups.

    Attributes
    ----------
    parameter : {"K", "B", "I"}
    first, second : str
        Labels of the groups: from the longest to the shortest window, from small to large, from
        positive to negative, or the two of all conditions or trials that differ most clearly, the
        smaller value first.
    before, after : float
        Value in the first and in the second [Nm/rad, Nms/rad, kg m²].
    standard_errors : float
        How many it changes by; 0 where they are not known.
    notable : bool
        Whether it is to be named, if the aspect is significant: clear, or the clearest of the
        three.
    """

    parameter: str
    first: str
    second: str
    before: float
    after: float
    standard_errors: float
    notable: bool = False


@dataclass(frozen=True, eq=False)
class Constancy:
    """Whether K, B and I are the same in all groups of one kind.

    Attributes
    ----------
    by : {"window", "amplitude", "direction", "condition", "trial"}
    groups : tuple of Estimate
        Empty where there are not two groups.
    statistic : float
        Chi-square over its degrees of freedom.
    p_value : float
        1 where there are not two groups.
    mixed : bool
        Whether small and large, or positive and negative perturbations are of different waveforms
        too, so that either may be the reason of a change.
    changes : tuple of Change
        One each of K, B and I; empty where there are not two groups.
    significant : bool
        After Benjamini & Hochberg (1995) over all aspects, at the comparison's level.
    """

    by: Aspect
    groups: tuple[Estimate, ...] = ()
    statistic: float = 0.0
    p_value: float = 1.0
    mixed: bool = False
    changes: tuple[Change, ...] = ()
    significant: bool = False


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measurement against model.

    Attributes
    ----------
    trials : tuple of TrialRow
    error : float
        E pooled over trials.
    overall : Estimate
        K, B and I of all trials together.
    constancy : tuple of Constancy
        By window, amplitude, direction, condition and trial.
    level : float
        False discovery rate over the aspects.
    """

    trials: tuple[TrialRow, ...]
    error: float
    overall: Estimate
    constancy: tuple[Constancy, ...]
    level: float

    def by(self, aspect: Aspect) -> Constancy:
        """Constancy in one aspect."""
        return next(c for c in self.constancy if c.by == aspect)


def compare(bench: Workbench, candidate: Candidate) -> Comparison:
    """Compare a fitted model with the trials it was fitted to.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        One of its fits.

    Returns
    -------
    Comparison
    """
    split, level = bench.split, bench.rules.false_discoveries
    loads = imposed(split.fitted)
    fitter = _Fitter(Refits(bench, candidate), split, _noise(split, candidate))
    whole = [
        Unit(i, 0, ready.last - ready.first, load.amplitude, load.direction, load.kind)
        for i, (ready, load) in enumerate(zip(split.fitted, loads, strict=True))
    ]
    units = groups.perturbations(split) or whole
    everything = Group("all", tuple(units))
    overall = fitter.estimate(everything, fitter.refits.fit(fitter.take(everything)))
    aspects = [
        _by_window(fitter, groups.windows(split)),
        _by_group(fitter, "amplitude", groups.amplitudes(units)),
        _by_group(fitter, "direction", groups.directions(units)),
        _by_group(fitter, "condition", groups.conditions(whole, loads)),
        _by_group(fitter, "trial", groups.trials(whole, split)),
    ]
    # What cannot be tested is no test; the others are corrected for their number.
    tested = [a for a in aspects if a.groups]
    passed: set[Aspect] = set()
    if tested:
        adjusted = stats.false_discovery_control([a.p_value for a in tested])
        passed = {a.by for a, p in zip(tested, adjusted, strict=True) if p <= level}
    constancy = tuple(
        replace(a, significant=a.by in passed, changes=_changes(a, bench.rules.notable))
        for a in aspects
    )
    rows = tuple(_row(bench, candidate, i, load) for i, load in enumerate(loads))
    return Comparison(rows, candidate.fitted.error, overall, constancy, level)


def _row(bench: Workbench, candidate: Candidate, i: int, load: Imposed) -> TrialRow:
    ready, left = bench.split.fitted[i], candidate.fitted.by_trial[i]
    rms = float(np.sqrt(np.mean(left**2)))
    known = ready.lead.n_samples and ready.lead.sd > 0
    return TrialRow(
        ready.name,
        load.condition,
        load.amplitude,
        load.direction,
        float(candidate.fitted.errors[i]),
        float(100 * (1 - np.var(left) / np.var(ready.compared))),
        rms,
        rms / float(ready.lead.sd) if known else None,
        left.size,
    )


def _noise(split: Split, candidate: Candidate) -> Whitening:
    """The noise where it is known; otherwise residuals stay as they are, and weigh as fitted."""
    found = whitening(split.fitted, candidate.fitted)
    if found.known:
        return found
    sds = split.weights_sd(split.fitted)
    return Whitening(False, np.zeros(0), sds, found.dof, np.zeros(sds.size), np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class _Fitter:
    """Fits K, B and I to groups of samples."""

    refits: Refits
    split: Split
    noise: Whitening

    def take(self, *groups: Group, scales: Sequence[float] = ()) -> Take:
        """Samples of the groups, whitened, in units of their weight and of a group's own scale."""
        parts, noise = self.split.fitted, self.noise
        weights = noise.sds / self.split.weights_sd(parts)
        chosen: list[list[tuple[Unit, float]]] = [[] for _ in parts]
        for group, scale in zip(groups, scales or [1.0] * len(groups), strict=True):
            for unit in group.units:
                chosen[unit.trial].append((unit, scale))

        def rows(trial: int, columns: np.ndarray) -> np.ndarray:
            offset = (
                UNKNOWN_LEVEL * noise.sds[trial]
                if parts[trial].has_offset
                else noise.offsets[trial]
            )
            level = np.full((len(columns), 1), offset)
            white = noise.white(trial, np.column_stack([columns, level]))
            pieces = [columns[:0]]
            for unit, scale in chosen[trial]:
                part = white[unit.first : unit.last]
                one = np.zeros(len(part), int)
                pieces.append(
                    without_levels(part[:, :-1], part[:, -1], one) * (weights[trial] / scale)
                )
            return np.concatenate(pieces)

        return rows

    def estimate(self, group: Group, found: Refit) -> Estimate:
        """Standard errors of a fit to a group: Gauss-Newton, for its independent samples.

        Parameters
        ----------
        group : Group
        found : Refit
        """
        n = sum(row.size for row in found.rows)
        independent = n / correlation_time(*(row for row in found.rows if row.size))
        errors = np.sqrt(self.spread(found) * np.diag(_inverse(found.information)))
        return Estimate(group.label, found.values, errors, n, independent, found.at_bound)

    def spread(self, found: Refit) -> float:
        """Variance of a fit's residual times its autocorrelation time."""
        pieces = tuple(row for row in found.rows if row.size)
        n, time = sum(piece.size for piece in pieces), correlation_time(*pieces)
        # The fit takes three of as many samples as are independent.
        return found.cost * time / max(n - 3 * time, 1.0)

    def probability(
        self, statistic: float, dof: float, independent: float, found: Sequence[Refit]
    ) -> float:
        """Probability of a larger mean of `dof` squares over the residuals' variance.

        That variance comes from a number of independent residuals. As far as they are noise, they
        were whitened by a spectrum that is itself an estimate, least certain at the low frequencies
        that K, B and I are seen at.
        """
        weights = self.noise.sds / self.split.weights_sd(self.split.fitted)
        rows = [r / w for f in found for r, w in zip(f.rows, weights, strict=True)]
        power = sum(float(r @ r) for r in rows) / sum(r.size for r in rows)
        slack = self.noise.slack(np.zeros(1)) / max(power, 1.0) ** 2
        others = 1 / (1 / max(independent, 1.0) + slack / 2)
        return float(stats.f.sf(statistic, dof, others))


def _inverse(information: np.ndarray) -> np.ndarray:
    """Inverse of a Gauss-Newton matrix; what is undetermined gets a very large variance."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _by_group(fitter: _Fitter, by: Aspect, parts: Sequence[Group]) -> Constancy:
    """Constancy over groups that share no samples."""
    if not parts:
        return Constancy(by)
    found = [fitter.refits.fit(fitter.take(group)) for group in parts]
    estimates = tuple(fitter.estimate(g, f) for g, f in zip(parts, found, strict=True))
    spreads = [max(fitter.spread(f), 1e-300) for f in found]
    scales = [float(np.sqrt(s)) for s in spreads]
    common = fitter.refits.fit(fitter.take(*parts, scales=scales))
    apart = sum(f.cost / s for f, s in zip(found, spreads, strict=True))
    dof = 3 * (len(parts) - 1)
    statistic = max(common.cost - apart, 0.0) / dof
    independent = sum(e.n_independent for e in estimates) - 3 * len(parts)
    p_value = fitter.probability(statistic, dof, independent, found)
    mixed = by in ("amplitude", "direction") and parts[0].kinds != parts[1].kinds
    return Constancy(by, estimates, statistic, p_value, mixed)


def _by_window(fitter: _Fitter, parts: Sequence[Group]) -> Constancy:
    """Constancy over windows, each of which contains the shorter ones.

    The shorter window's sum of squares at the longer one's parameters exceeds its own least by
    d A d, with A its Gauss-Newton matrix and, if the parameters are constant, the covariance
    inv(A) - inv(A') of the difference d (Hausman 1978, Econometrica 46: 1251-1271): a weighted sum
    of chi-squares, which one scaled chi-square of the same mean and variance stands for.
    """
    if not parts:
        return Constancy("window")
    found: list[Refit] = []
    for group in reversed(parts):  # from the longest, which determines K, B and I best
        start = found[-1].values if found else None
        found.append(fitter.refits.fit(fitter.take(group), start))
    found.reverse()
    estimates = tuple(fitter.estimate(g, f) for g, f in zip(parts, found, strict=True))
    total, mean, square, independent = 0.0, 0.0, 0.0, 0.0
    for group, short, long, estimate in zip(parts, found, found[1:], estimates, strict=False):
        take = fitter.take(group)
        at_long = [
            take(i, left)[:, 0] for i, left in enumerate(fitter.refits.linearised(long.values)[0])
        ]
        excess = sum(float(r @ r) for r in at_long) - short.cost
        total += max(excess, 0.0) / max(fitter.spread(short), 1e-300)
        share = np.linalg.eigvals(_inverse(long.information) @ short.information).real
        weights = 1 - np.clip(share, 0.0, 1.0)
        mean, square = mean + weights.sum(), square + np.sum(weights**2)
        independent += max(estimate.n_independent - 3, 1.0)
    dof = mean**2 / max(square, 1e-300)
    statistic = total / max(mean, 1e-300)
    p_value = fitter.probability(statistic, dof, independent, found[:-1])
    return Constancy("window", estimates, statistic, p_value)


def _changes(found: Constancy, notable: float) -> tuple[Change, ...]:
    """Largest clear change of each of K, B and I.

    Parameters
    ----------
    found : Constancy
    notable : float
        Standard errors from which a change is named, even if another is clearer.
    """
    if not found.groups:
        return ()
    changes = [_change(found, i, notable) for i in range(len(NAMES))]
    largest = max(change.standard_errors for change in changes)
    return tuple(
        replace(c, notable=0 < c.standard_errors >= min(notable, largest)) for c in changes
    )


def _change(found: Constancy, i: int, notable: float) -> Change:
    values = np.array([group.values[i] for group in found.groups])
    errors = np.array([group.errors[i] for group in found.groups])
    if found.by == "window":
        a, b = len(values) - 1, 0
        error = _nested(errors[b], errors[a])
    else:
        a, b = (0, 1) if found.by in ("amplitude", "direction") else _apart(values, errors, notable)
        error = float(np.hypot(errors[a], errors[b]))
    return Change(
        NAMES[i],
        found.groups[a].label,
        found.groups[b].label,
        float(values[a]),
        float(values[b]),
        float(abs(values[b] - values[a]) / error) if error > 0 else 0.0,
    )


def _nested(short: float, long: float) -> float:
    """Standard error of the difference of estimates of which one's samples hold the other's.

    It is at least half that of the shorter one, lest a chance in the errors count as clearness.
    """
    if not np.isfinite(short):
        return np.inf
    return float(np.sqrt(max(short**2 - long**2, 0.25 * short**2)))


def _apart(values: np.ndarray, errors: np.ndarray, notable: float) -> tuple[int, int]:
    """Two groups: of those that differ clearly, or most clearly, those furthest apart."""
    distance = np.abs(values[:, None] - values)
    scores = distance / np.maximum(np.hypot(errors[:, None], errors), 1e-300)
    clear = np.where(scores >= min(notable, scores.max()), distance, -1.0)
    a, b = np.unravel_index(int(np.argmax(clear)), clear.shape)
    return (int(a), int(b)) if values[a] <= values[b] else (int(b), int(a))
