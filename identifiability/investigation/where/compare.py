"""How well a model fits each trial, and whether its K, B and I are the same in all of them.

A joint that is what the model says has one K, B and I, whatever the window after a perturbation,
its size, its direction or its kind. They are fitted anew to each part, the model's other parameters
held, and their constancy is tested: with SS_g(x) the sum of squares of group g at parameters x,
scaled by its own residual variance times autocorrelation time, the increase of the sum from own to
common parameters follows chi-square, over its degrees of freedom F, if they are constant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import stats

from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.fits.refits import (
    NAMES,
    UNITS,
    UNKNOWN_LEVEL,
    Refit,
    Refits,
    Take,
    correlation_time,
    without_levels,
)
from identifiability.investigation.split import Split
from identifiability.investigation.where.imposed import Imposed, imposed, starts
from identifiability.investigation.where.whitening import Whitening, whitening

WINDOWS = (0.05, 0.1, 0.2)
"""Windows T [s] after each perturbation: those of Kistemaker & Rozendaal (2011)."""
LEVEL = 0.05
_FEWEST, _MANY = 5, 8  # samples of a window; perturbations of a record that is split into them
_LOOKED_AT = 0.2  # seconds after a perturbation in which its size and direction are read
_NOTABLE = 3.0  # standard errors from which a change is named

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
    significant : bool
        After Benjamini & Hochberg (1995) over all aspects, at a false discovery rate of 5 %.
    sentence : str
    """

    by: Aspect
    groups: tuple[Estimate, ...]
    statistic: float
    p_value: float
    significant: bool
    sentence: str


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
    """

    trials: tuple[TrialRow, ...]
    error: float
    overall: Estimate
    constancy: tuple[Constancy, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence an aspect."""
        return tuple(c.sentence for c in self.constancy)

    def by(self, aspect: Aspect) -> Constancy:
        """Constancy in one aspect."""
        return next(c for c in self.constancy if c.by == aspect)


@dataclass(frozen=True)
class _Unit:
    """A stretch of compared samples of one trial, with an offset of its own if it has any."""

    trial: int
    first: int
    last: int
    amplitude: float
    direction: int
    kind: int


@dataclass(frozen=True, eq=False)
class _Group:
    label: str
    units: tuple[_Unit, ...]


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
    split = bench.split
    loads = imposed(split.fitted)
    fitter = _Fitter(Refits(bench, candidate), split, _noise(split, candidate))
    whole = [
        _Unit(i, 0, ready.last - ready.first, load.amplitude, load.direction, load.kind)
        for i, (ready, load) in enumerate(zip(split.fitted, loads, strict=True))
    ]
    units = _perturbations(split) or whole
    everything = _Group("all", tuple(units))
    overall = fitter.estimate(everything, fitter.refits.fit(fitter.take(everything)))
    aspects = [
        _by_window(fitter),
        _by_group(fitter, "amplitude", *_amplitudes(units)),
        _by_group(fitter, "direction", *_directions(units)),
        _by_group(fitter, "condition", *_conditions(whole, loads)),
        _by_group(fitter, "trial", *_trials(whole, split)),
    ]
    # What cannot be tested is no test; the others are corrected for their number.
    tested = [i for i, a in enumerate(aspects) if a.groups]
    passed = set()
    if tested:
        adjusted = stats.false_discovery_control([aspects[i].p_value for i in tested])
        passed = {i for i, p in zip(tested, adjusted, strict=True) if p <= LEVEL}
    constancy = tuple(
        replace(a, significant=i in passed, sentence=_sentence(a, i in passed))
        for i, a in enumerate(aspects)
    )
    rows = tuple(_row(bench, candidate, i, load) for i, load in enumerate(loads))
    return Comparison(rows, candidate.fitted.error, overall, constancy)


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

    def take(self, *groups: _Group, scales: Sequence[float] = ()) -> Take:
        """Samples of the groups, whitened, in units of their weight and of a group's own scale."""
        parts, noise = self.split.fitted, self.noise
        weights = noise.sds / self.split.weights_sd(parts)
        chosen: list[list[tuple[_Unit, float]]] = [[] for _ in parts]
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

    def estimate(self, group: _Group, found: Refit) -> Estimate:
        """Standard errors of a fit to a group: Gauss-Newton, for its independent samples.

        Parameters
        ----------
        group : _Group
        found : Refit
        """
        n = sum(row.size for row in found.rows)
        independent = n / correlation_time(tuple(row for row in found.rows if row.size))
        errors = np.sqrt(self.spread(found) * np.diag(_inverse(found.information)))
        return Estimate(group.label, found.values, errors, n, independent, found.at_bound)

    def spread(self, found: Refit) -> float:
        """Variance of a fit's residual times its autocorrelation time."""
        pieces = tuple(row for row in found.rows if row.size)
        n, time = sum(piece.size for piece in pieces), correlation_time(pieces)
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


def _by_group(fitter: _Fitter, by: Aspect, groups: Sequence[_Group], remark: str) -> Constancy:
    """Constancy over groups that share no samples.

    Parameters
    ----------
    fitter : _Fitter
    by : str
    groups : sequence of _Group
        None where there are not two.
    remark : str
        Why there are none, or what the reader must bear in mind.
    """
    if not groups:
        return Constancy(by, (), 0.0, 1.0, False, remark)
    found = [fitter.refits.fit(fitter.take(group)) for group in groups]
    estimates = tuple(fitter.estimate(g, f) for g, f in zip(groups, found, strict=True))
    spreads = [max(fitter.spread(f), 1e-300) for f in found]
    scales = [float(np.sqrt(s)) for s in spreads]
    common = fitter.refits.fit(fitter.take(*groups, scales=scales))
    apart = sum(f.cost / s for f, s in zip(found, spreads, strict=True))
    dof = 3 * (len(groups) - 1)
    statistic = max(common.cost - apart, 0.0) / dof
    independent = sum(e.n_independent for e in estimates) - 3 * len(groups)
    p_value = fitter.probability(statistic, dof, independent, found)
    return Constancy(by, estimates, statistic, p_value, False, remark)


def _by_window(fitter: _Fitter) -> Constancy:
    """Constancy over windows, each of which contains the shorter ones.

    The shorter window's sum of squares at the longer one's parameters exceeds its own least by
    d A d, with A its Gauss-Newton matrix and, if the parameters are constant, the covariance
    inv(A) - inv(A') of the difference d (Hausman 1978, Econometrica 46: 1251-1271): a weighted sum
    of chi-squares, which one scaled chi-square of the same mean and variance stands for.
    """
    groups = _windows(fitter.split)
    if len(groups) < 2:
        shortest, longest = 1000 * WINDOWS[0], 1000 * WINDOWS[-1]
        remark = (
            f"Fewer than two of the windows of {shortest:g} to {longest:g} ms fit into the trials, "
            "so whether K, B and I change with the window is not known."
        )
        return Constancy("window", (), 0.0, 1.0, False, remark)
    found: list[Refit] = []
    for group in reversed(groups):  # from the longest, which determines K, B and I best
        start = found[-1].values if found else None
        found.append(fitter.refits.fit(fitter.take(group), start))
    found.reverse()
    estimates = tuple(fitter.estimate(g, f) for g, f in zip(groups, found, strict=True))
    total, mean, square, independent = 0.0, 0.0, 0.0, 0.0
    for group, short, long, estimate in zip(groups, found, found[1:], estimates, strict=False):
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
    return Constancy("window", estimates, statistic, p_value, False, "")


def _windows(split: Split) -> list[_Group]:
    """For each window that fits, the samples within it after the perturbations."""
    firsts = [starts(ready) for ready in split.fitted]
    fitting: list[float] = []
    units: dict[float, list[_Unit]] = {}
    for window in WINDOWS:
        units[window] = []
        for i, (ready, onsets) in enumerate(zip(split.fitted, firsts, strict=True)):
            length = round(window / ready.drive.interval)
            ends = [*onsets[1:], ready.last - ready.first]
            for onset, end in zip(onsets, ends, strict=True):
                if length + 1 >= _FEWEST and onset + length < end:
                    onset = int(onset)
                    units[window].append(_Unit(i, onset, onset + length + 1, 0.0, 0, 0))
        if units[window]:
            fitting.append(window)
    if not fitting:
        return []
    # Only perturbations that have the longest window, so that each window holds the shorter ones.
    whole = {(u.trial, u.first) for u in units[fitting[-1]]}
    return [
        _Group(f"{1000 * w:g} ms", tuple(u for u in units[w] if (u.trial, u.first) in whole))
        for w in fitting
    ]


def _perturbations(split: Split) -> list[_Unit]:
    """The single perturbations of long records, where every trial is one; otherwise nothing."""
    units = []
    for i, ready in enumerate(split.fitted):
        onsets = starts(ready)
        if onsets.size < _MANY:
            return []
        signal = ready.drive.signals[ready.first : ready.last, 0]
        look = round(_LOOKED_AT / ready.drive.interval)
        for first, last in zip(onsets, [*onsets[1:], signal.size], strict=True):
            moved = signal[first : min(last, first + look)] - signal[first]
            change = moved[np.argmax(np.abs(moved))] if moved.size else 0.0
            if last - first >= _FEWEST and change != 0:
                sign = 1 if change > 0 else -1
                units.append(_Unit(i, int(first), int(last), float(abs(change)), sign, 0))
    return units


def _amplitudes(units: Sequence[_Unit]) -> tuple[list[_Group], str]:
    """Small and large perturbations; of one kind and direction, where there are such."""
    strictest: list[Callable[[_Unit], object]] = [
        lambda u: (u.kind, u.direction),
        lambda u: u.kind,
    ]
    for key in strictest:
        small, large = _halves(units, key)
        if small:
            break
    else:
        small, large = _halves(units, lambda u: 0)
    if not small:
        return (
            [],
            "All perturbations are of one size, so whether K, B and I change with it is not known.",
        )
    mixed = {u.kind for u in small} != {u.kind for u in large}
    remark = "; the waveforms differ too" if mixed else ""
    return [_Group("small", tuple(small)), _Group("large", tuple(large))], remark


def _halves(
    units: Sequence[_Unit], key: Callable[[_Unit], object]
) -> tuple[list[_Unit], list[_Unit]]:
    """Units below and above the middle amplitude of those that share a key."""
    small: list[_Unit] = []
    large: list[_Unit] = []
    for value in dict.fromkeys(key(u) for u in units):
        alike = [u for u in units if key(u) == value]
        sizes = [u.amplitude for u in alike]
        if max(sizes) < 1.2 * min(sizes):
            continue
        # The middle between neighbours that differ most evenly: by size, not by number, where few.
        middle = (
            float(np.median(sizes)) if len(sizes) >= _MANY else np.sqrt(max(sizes) * min(sizes))
        )
        small += [u for u in alike if u.amplitude < middle]
        large += [u for u in alike if u.amplitude >= middle]
    return small, large


def _directions(units: Sequence[_Unit]) -> tuple[list[_Group], str]:
    """Perturbations to either side; of one kind and size, where there are such."""

    def size(u: _Unit) -> tuple[int, int]:
        return u.kind, round(np.log(u.amplitude) / np.log(1.1)) if u.amplitude > 0 else 0

    keys: list[Callable[[_Unit], object]] = [size, lambda u: u.kind, lambda u: 0]
    for key in keys:
        both: dict[int, list[_Unit]] = {1: [], -1: []}
        for value in dict.fromkeys(key(u) for u in units):
            alike = [u for u in units if key(u) == value]
            if {u.direction for u in alike} >= {1, -1}:
                for unit in alike:
                    if unit.direction:
                        both[unit.direction].append(unit)
        if both[1]:
            break
    if not both[1]:
        return [], (
            "All perturbations go one way, so whether K, B and I change with the direction is not "
            "known."
        )
    remark = ""
    if {u.kind for u in both[1]} != {u.kind for u in both[-1]}:
        remark = "; the waveforms differ too"
    return [_Group("positive", tuple(both[1])), _Group("negative", tuple(both[-1]))], remark


def _conditions(units: Sequence[_Unit], loads: Sequence[Imposed]) -> tuple[list[_Group], str]:
    names = dict.fromkeys(load.condition for load in loads)
    groups = [
        _Group(name, tuple(u for u in units if loads[u.trial].condition == name)) for name in names
    ]
    if len(groups) < 2:
        return [], "All trials are of one kind, so K, B and I cannot change with it."
    return groups, ""


def _trials(units: Sequence[_Unit], split: Split) -> tuple[list[_Group], str]:
    groups = [_Group(split.fitted[u.trial].name, (u,)) for u in units]
    if len(groups) < 2:
        return [], "There is one trial, so K, B and I cannot change from trial to trial."
    return groups, ""


def _sentence(found: Constancy, significant: bool) -> str:
    """One plain sentence on one aspect."""
    if not found.groups:
        return found.sentence
    where = {
        "window": "with the window",
        "amplitude": "with the size of the perturbation",
        "direction": "with its direction",
        "condition": "with the kind of perturbation",
        "trial": "from trial to trial",
    }[found.by]
    if not significant:
        return (
            f"K, B and I do not change {where} by more than their errors explain "
            f"({probability(found.p_value)})."
        )
    changes = [c for c in (_change(found, i) for i in range(3)) if c[0] > 0]
    if not changes:
        return f"K, B and I change {where} ({probability(found.p_value)}), though none by itself."
    largest = max(changes)[0]
    named = [text for score, text in changes if score >= min(_NOTABLE, largest)]
    listed = ", ".join(named[:-1]) + (" and " if named[:-1] else "") + named[-1]
    if found.by == "window":
        ends = f"{found.groups[-1].label} to {found.groups[0].label}"
        how = f"as the window shortens from {ends}"
    elif found.by == "amplitude":
        how = "from small to large perturbations"
    elif found.by == "direction":
        how = "from the positive to the negative direction"
    else:
        how = where
    return f"{listed} {how}: it should not if the model is right{found.sentence}."


def _change(found: Constancy, i: int) -> tuple[float, str]:
    """How many standard errors a parameter changes by, and its largest clear change in words."""
    values = np.array([g.values[i] for g in found.groups])
    errors = np.array([g.errors[i] for g in found.groups])
    if found.by == "window":
        a, b = len(values) - 1, 0
        error = np.sqrt(max(errors[b] ** 2 - errors[a] ** 2, 0.25 * errors[b] ** 2))
    elif found.by in ("amplitude", "direction"):
        a, b = 0, 1
        error = np.hypot(errors[0], errors[1])
    else:
        apart = np.abs(values[:, None] - values)
        scores = apart / np.maximum(np.hypot(errors[:, None], errors), 1e-300)
        clear = np.where(scores >= min(_NOTABLE, scores.max()), apart, -1.0)
        pair = np.unravel_index(int(np.argmax(clear)), clear.shape)
        a, b = sorted((int(pair[0]), int(pair[1])), key=lambda k: values[k])
        error = np.hypot(errors[a], errors[b])
    score = abs(values[b] - values[a]) / error if error > 0 else 0.0
    x, y = _in_words(values[a], values[b])
    if found.by in ("condition", "trial"):
        labels = found.groups[a].label, found.groups[b].label
        return float(
            score
        ), f"{NAMES[i]} goes from {x} ({labels[0]}) to {y} {UNITS[i]} ({labels[1]})"
    verb = "rises" if values[b] > values[a] else "falls"
    return float(score), f"{NAMES[i]} {verb} from {x} to {y} {UNITS[i]}"


def _in_words(a: float, b: float) -> tuple[str, str]:
    """Two numbers with as many digits as it takes to tell them apart, at least two."""
    for digits in range(2, 7):
        x, y = plain(a, digits), plain(b, digits)
        if x != y:
            break
    return x, y


def plain(x: float, digits: int = 2) -> str:
    """A number with so many significant digits, without an exponent unless it is very small."""
    return f"{float(f'{x:.{digits}g}'):.10g}"


def probability(p: float) -> str:
    """A p value in words."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"
