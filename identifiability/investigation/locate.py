"""Where a model fails: when, at which frequencies, in which states, directions, sizes and trials.

Every view tests the residual, in units of the noise before the perturbation, with its false
discovery rate controlled (Benjamini & Hochberg 1995, J R Stat Soc B 57: 289-300), and says in one
sentence what it found. Where the noise is unknown the residual is judged by its own level, and only
its structure can be seen.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal, stats

from identifiability.investigation.candidates import Candidate, Workbench
from identifiability.investigation.compare import plain, probability
from identifiability.investigation.evidence import Ready
from identifiability.investigation.imposed import Imposed, imposed
from identifiability.investigation.refits import Refits, correlation_time, without_levels
from identifiability.investigation.whitening import Blocks, Portion, Whitening, excess, whitening

_WIDTHS, _MOST_BINS = (0.01, 0.02), 60  # of the bins in time [s], and their number
_LATENCY_BIN, _LONGEST_LATENCY = 0.01, 0.4  # seconds in which an onset of the misfit is looked for
_LONGEST_SEGMENT, _FEWEST_SEGMENTS = 1.0, 3  # of the spectra [s]; for a coherence
_TAPERED = 0.25  # share of a segment that is tapered, lest its ends leak into high frequencies
_KNOTS, _REACH = 9, 0.995  # of angle and velocity each, an odd number; quantile that they span
_UNKNOWN = 1e3  # size of an offset that is unknown altogether, in units of the noise
_DETERMINED = 0.03  # least singular value of the regression on torques, relative to the largest
_OPPOSITE, _OTHER_SIZE = 0.05, 1.2  # how close to -1, and how far from 1, the ratio of sizes is


@dataclass(frozen=True, eq=False)
class View:
    """What every view has.

    Attributes
    ----------
    significant : bool
    sentence : str
        What was found, or why the view is not possible.
    """

    significant: bool
    sentence: str


@dataclass(frozen=True, eq=False)
class TimeView(View):
    """Residual against the time since the perturbation.

    Attributes
    ----------
    edges : array, shape (n + 1,)
        Of the bins [s].
    ratio : array, shape (n,)
        Mean square of the residual over that of the noise, both averaged over 5 ms.
    p_values, flags : array, shape (n,)
        Of each bin, and whether it is significant.
    latency : float or None
        Time [s] up to which K, B and I can be fitted to the response such that no misfit is left:
        two bins in a row after it cannot be joined.
    """

    edges: np.ndarray
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray
    latency: float | None


@dataclass(frozen=True, eq=False)
class FrequencyView(View):
    """Residual against frequency.

    Attributes
    ----------
    edges : array, shape (n + 1,)
        Of the bands [Hz].
    ratio : array, shape (n,)
        Power of the residual over that of the noise.
    p_values, flags : array, shape (n,)
        Of each band's power, and whether it is significant; nothing is where the noise is unknown.
    coherence : array, shape (n,)
        Squared coherence of the residual with the imposed signal; nan where it is not known.
    coherent : array, shape (n,)
        Whether it is significant.
    """

    edges: np.ndarray
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray
    coherence: np.ndarray
    coherent: np.ndarray


@dataclass(frozen=True, eq=False)
class Curve:
    """Unexplained torque against angle or velocity.

    Attributes
    ----------
    at : array, shape (n,)
        Angle [rad] or velocity [rad/s].
    torque, errors : array, shape (n,)
        Torque [Nm] that resists the motion beyond what the model says, and its standard error. It
        is 0 at rest, and has no linear part: K and B would take that up.
    flags : array, shape (n,)
        Where it is significant.
    share : float
        Share of the misfit, beyond the noise, that this curve alone explains.
    """

    at: np.ndarray
    torque: np.ndarray
    errors: np.ndarray
    flags: np.ndarray
    share: float


@dataclass(frozen=True, eq=False)
class StateView(View):
    """Unexplained torque as the sum of one that depends on the angle and one on the velocity.

    Attributes
    ----------
    angle, velocity : Curve or None
        ``None`` where the trials visit too few states.
    share : float
        Share of the misfit, beyond the noise, that both explain together.
    p_value : float
    """

    angle: Curve | None
    velocity: Curve | None
    share: float
    p_value: float


@dataclass(frozen=True, eq=False)
class DirectionView(View):
    """Parts of the residual that keep and that turn their sign with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        Trials of one perturbation and its opposite.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    even, odd : array, shape (n,)
        Mean square over that of the noise.
    p_even, p_odd : float
    even_significant, odd_significant : bool
    """

    pairs: tuple[tuple[str, str], ...]
    edges: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    p_even: float
    p_odd: float
    even_significant: bool
    odd_significant: bool


@dataclass(frozen=True, eq=False)
class AmplitudeView(View):
    """The part of the residual that does not scale with the perturbation.

    Attributes
    ----------
    pairs : tuple of (str, str)
        The smaller and the larger of two perturbations of one waveform.
    gains : tuple of float
        Ratio of their sizes.
    edges : array, shape (n + 1,)
        Of the bins in time [s].
    ratio : array, shape (n,)
        Mean square of larger less scaled smaller residual, over that of the noise.
    p_value : float
    """

    pairs: tuple[tuple[str, str], ...]
    gains: tuple[float, ...]
    edges: np.ndarray
    ratio: np.ndarray
    p_value: float


@dataclass(frozen=True, eq=False)
class TrialView(View):
    """Error of each trial, or condition, against the noise; or against the others, if unknown.

    Attributes
    ----------
    names : tuple of str
    errors : array, shape (n,)
        E (Eq. 3).
    pooled : float
        E over all.
    ratio : array, shape (n,)
        Mean square of the residual over that of the noise; where that is unknown, error or mean
        square over the others', whichever is less.
    p_values, flags : array, shape (n,)
    """

    names: tuple[str, ...]
    errors: np.ndarray
    pooled: float
    ratio: np.ndarray
    p_values: np.ndarray
    flags: np.ndarray


@dataclass(frozen=True, eq=False)
class Location:
    """Where a model fails.

    Attributes
    ----------
    time, frequency, state, direction, amplitude, trials, conditions : View
    noise_known : bool
        Whether the noise was read from quiet samples before the perturbations.
    driven : {"torque", "angle"}
        What was imposed.
    level : float
        False discovery rate within each view.
    """

    time: TimeView
    frequency: FrequencyView
    state: StateView
    direction: DirectionView
    amplitude: AmplitudeView
    trials: TrialView
    conditions: TrialView
    noise_known: bool
    driven: str
    level: float

    @property
    def views(self) -> dict[str, View]:
        """All views by name."""
        names = ("time", "frequency", "state", "direction", "amplitude", "trials", "conditions")
        return {name: getattr(self, name) for name in names}

    @property
    def sentences(self) -> tuple[str, ...]:
        """One sentence a view."""
        return tuple(view.sentence for view in self.views.values())


@dataclass(frozen=True, eq=False)
class _Scene:
    """What all views look at."""

    parts: tuple[Ready, ...]
    loads: tuple[Imposed, ...]
    candidate: Candidate
    refits: Refits
    noise: Whitening
    blocks: tuple[Blocks, ...]
    level: float

    @property
    def slack(self) -> float:
        """Relative variance of the noise's power in blocks, from the errors of its spectrum."""
        return max(self.noise.block_slack(b.index.shape[1]) for b in self.blocks)

    @property
    def slow_slack(self) -> float:
        """The same at the lowest frequencies."""
        return self.noise.slack(np.zeros(1))

    @property
    def reference(self) -> str:
        """What the residual is judged by."""
        return "the noise" if self.noise.known else "its typical level (the noise is unknown)"

    def significant(self, p_values: np.ndarray) -> np.ndarray:
        """Which of several tests are, at the false discovery rate."""
        if not p_values.size:
            return np.zeros(0, bool)
        return np.asarray(stats.false_discovery_control(p_values) <= self.level)


def _observed(scene: _Scene) -> list[tuple[Ready, Blocks]]:
    return list(zip(scene.parts, scene.blocks, strict=True))


def locate(bench: Workbench, candidate: Candidate, level: float = 0.05) -> Location:
    """Find where a fitted model fails.

    Parameters
    ----------
    bench : Workbench
    candidate : Candidate
        One of its fits.
    level : float
        False discovery rate within each view.

    Returns
    -------
    Location
    """
    parts = bench.evidence.fitted
    noise = whitening(parts, candidate.fitted)
    blocks = tuple(
        noise.blocks(i, ready, left)
        for i, (ready, left) in enumerate(zip(parts, candidate.fitted.by_trial, strict=True))
    )
    scene = _Scene(parts, imposed(parts), candidate, Refits(bench, candidate), noise, blocks, level)
    trials = [(ready.name, [i]) for i, ready in enumerate(parts)]
    names = dict.fromkeys(load.condition for load in scene.loads)
    conditions = [
        (name, [i for i, load in enumerate(scene.loads) if load.condition == name])
        for name in names
    ]
    return Location(
        _in_time(scene),
        _in_frequency(scene),
        _in_state(scene),
        _by_direction(scene),
        _by_amplitude(scene),
        _by_trial(scene, trials, "trial", "trials"),
        _by_trial(scene, conditions, "kind of perturbation", "kinds of perturbation"),
        noise.known,
        bench.evidence.driven,
        level,
    )


# Time


def _edges(scene: _Scene, trials: Iterable[int]) -> np.ndarray:
    """Edges of bins in time since the perturbation [s]."""
    observed = [_observed(scene)[i] for i in trials]
    finest = max(ready.drive.interval * blocks.index.shape[1] for ready, blocks in observed)
    longest = max(float(blocks.time.max(initial=0.0)) for _, blocks in observed) + finest
    fitting = [w for w in _WIDTHS if w >= finest * (1 - 1e-9) and longest / w <= _MOST_BINS]
    width = fitting[0] if fitting else max(longest / _MOST_BINS, finest)
    return np.arange(np.ceil(longest / width - 1e-6) + 1) * width


def _bin(time: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of the bin of each time."""
    inside = np.searchsorted(edges, time + 1e-9 * edges[-1], side="right") - 1
    return np.minimum(inside, edges.size - 2)


def _in_time(scene: _Scene) -> TimeView:
    edges = _edges(scene, range(len(scene.parts)))
    bins = [_bin(b.time, edges) for b in scene.blocks]
    n = edges.size - 1
    ratio, p_values = np.ones(n), np.ones(n)
    for k in range(n):
        portions, total = _share(scene, bins, k)
        ratio[k], p_values[k] = excess(total, portions, scene.slack)
    flags = scene.significant(p_values)
    latency = _latency(scene) if flags.any() else None
    if not flags.any():
        sentence = (
            f"At no time after the perturbation does the residual exceed {scene.reference} "
            f"({n} bins, least {probability(float(p_values.min()))})."
        )
        return TimeView(False, sentence, edges, ratio, p_values, flags, None)
    worst = int(np.argmax(np.where(flags, ratio, 0.0)))
    sentence = (
        f"The residual exceeds {scene.reference} in {flags.sum()} of {n} bins of time, most from "
        f"{1000 * edges[worst]:.0f} to {1000 * edges[worst + 1]:.0f} ms after the perturbation "
        f"({plain(np.sqrt(ratio[worst]))} times in size)"
    )
    if latency is not None:
        first = f"for the first {1000 * latency:.0f} ms, no longer"
        sentence += f"; K, B and I can account {first if latency else 'not even for its beginning'}"
    return TimeView(True, sentence + ".", edges, ratio, p_values, flags, latency)


def _share(scene: _Scene, bins: Sequence[np.ndarray], k: int) -> tuple[list[Portion], float]:
    """Portions of all trials in a bin, and their sum of squares."""
    portions, total = [], 0.0
    for i, (blocks, inside) in enumerate(zip(scene.blocks, bins, strict=True)):
        chosen = inside == k
        if chosen.any():
            portions.append(scene.noise.portion(i, blocks, chosen))
            total += float(np.sum(blocks.values[chosen] ** 2))
    return portions, total


def _latency(scene: _Scene) -> float | None:
    """Time from which the response cannot be joined to what came before.

    K, B and I are fitted to a window that grows bin by bin. What each bin adds to the least sum of
    squares is independent of the others and chi-square distributed, as the recursive residuals of
    Brown, Durbin & Evans (1975, J R Stat Soc B 37: 149-192) are. Two such bins in a row at a
    probability of sqrt(level / n) each keep the probability of any false onset below the level.
    """
    finest = max(r.drive.interval * b.index.shape[1] for r, b in _observed(scene))
    edges = np.arange(0.0, _LONGEST_LATENCY, max(_LATENCY_BIN, finest))
    edges = edges[edges < max(b.time.max(initial=0.0) for b in scene.blocks)]
    n = edges.size
    bins = [np.searchsorted(edges, b.time + 1e-9, side="right") - 1 for b in scene.blocks]
    threshold = np.sqrt(scene.level / max(n, 1))
    cost, values, failed = 0.0, scene.refits.values, False
    for k in range(n):
        portions, _ = _share(scene, bins, k)
        if not portions:
            return None

        def take(trial: int, columns: np.ndarray, last: int = k) -> np.ndarray:
            blocks, chosen = scene.blocks[trial], bins[trial] <= last
            rows = scene.noise.averaged(trial, columns, blocks.index[chosen])
            if not scene.parts[trial].has_offset:
                return rows
            level = np.full((len(columns), 1), _UNKNOWN * scene.noise.sds[trial])
            ones = scene.noise.averaged(trial, level, blocks.index[chosen])
            return without_levels(rows, ones[:, 0], blocks.event[chosen])

        found = scene.refits.fit(take, values)
        _, p_value = excess(max(found.cost - cost, 0.0), portions, scene.slow_slack)
        if p_value < threshold and failed:
            return float(edges[k - 1])
        failed = p_value < threshold
        cost, values = found.cost, found.values
    return None


# Frequency


def _in_frequency(scene: _Scene) -> FrequencyView:
    residuals, inputs, owners, duration = _segments(scene)
    if not owners:
        none = np.zeros(0)
        flags = np.zeros(0, bool)
        reason = "The trials are too short for a spectrum."
        return FrequencyView(False, reason, none, none, none, flags, none, flags)
    highest = min(len(r) for r in residuals)
    edges = _octaves(highest - 1)
    power = np.array([np.abs(r[:highest]) ** 2 for r in residuals])
    cross = np.array(
        [r[:highest] * np.conj(u[:highest]) for r, u in zip(residuals, inputs, strict=True)]
    )
    drive = np.array([np.abs(u[:highest]) ** 2 for u in inputs])
    known = len(owners) >= _FEWEST_SEGMENTS
    norm = power.sum(axis=0) * drive.sum(axis=0)
    squared = np.abs(cross.sum(axis=0)) ** 2 / np.where(norm > 0, norm, 1.0)
    squared = np.clip(squared, 0.0, 1 - 1e-12)
    n = edges.size - 1
    # The taper joins neighbouring frequencies: so many count as one.
    taper = signal.windows.tukey(1000, _TAPERED)
    shared = float(np.mean(taper**4) / np.mean(taper**2) ** 2)
    ratio, p_values, coherence, p_coherent = np.ones(n), np.ones(n), np.full(n, np.nan), np.ones(n)
    for k, (low, high) in enumerate(itertools.pairwise(edges)):
        band = slice(low, high)
        portions = [
            Portion(2 * (high - low) * owners.count(i) / shared, 0.0, float(scene.noise.dof[i]))
            for i in dict.fromkeys(owners)
        ]
        hertz_of_band = np.arange(low, high) / duration
        places = [hertz_of_band * ready.drive.interval for ready in scene.parts]
        slack = max(scene.noise.slack(place) for place in places)
        lift = max(scene.noise.lift(place) for place in places) if scene.noise.known else 0.0
        total = 2 * float(power[:, band].sum()) / shared / (1 + lift)
        ratio[k], p_values[k] = excess(total, portions, slack)
        p_values[k] = max(p_values[k], _against_lead(scene, hertz_of_band, power[:, band], owners))
        if known:
            coherence[k] = squared[band].mean()
            # Of noise, -(L - 1) ln(1 - coherence) of L segments is exponentially distributed.
            score = -(len(owners) - 1) * np.log1p(-squared[band]).sum()
            p_coherent[k] = stats.gamma.sf(score / shared, (high - low) / shared)
    flags = scene.significant(p_values) if scene.noise.known else np.zeros(n, bool)
    coherent = scene.significant(p_coherent) if known else np.zeros(n, bool)
    hertz = edges / duration
    sentence = _frequency_sentence(scene, hertz, ratio, flags, coherent, known)
    significant = bool(flags.any() if scene.noise.known else coherent.any())
    return FrequencyView(significant, sentence, hertz, ratio, p_values, flags, coherence, coherent)


def _segments(
    scene: _Scene,
) -> tuple[list[np.ndarray], list[np.ndarray], list[int], float]:
    """Spectra of whitened residuals and imposed signals over segments of one duration."""
    firsts = [int(b.index[0, 0]) if b.index.size else 0 for b in scene.blocks]
    spans = [
        (r.last - r.first - first) * r.drive.interval
        for r, first in zip(scene.parts, firsts, strict=True)
    ]
    duration = min(min(spans), _LONGEST_SEGMENT)
    residuals, inputs, owners = [], [], []
    for i, (ready, first) in enumerate(zip(scene.parts, firsts, strict=True)):
        length = int(duration / ready.drive.interval * (1 + 1e-9))
        if length < 16:
            return [], [], [], duration
        taper = signal.windows.tukey(length, _TAPERED)
        white = scene.noise.white(i, scene.candidate.fitted.by_trial[i])
        acting = ready.drive.signals[ready.first : ready.last, 0]
        acting = acting - acting[first]
        for start in range(first, white.size - length + 1, length):
            part = slice(start, start + length)
            residuals.append(np.fft.rfft(taper * white[part]) / np.sqrt(np.sum(taper**2)))
            inputs.append(np.fft.rfft(taper * acting[part]))
            owners.append(i)
    return residuals, inputs, owners, duration


def _against_lead(
    scene: _Scene, hertz: np.ndarray, power: np.ndarray, owners: Sequence[int]
) -> float:
    """Probability that a band's power exceeds the highest peak of the leads in it, by chance.

    The noise's spectrum is a smooth fit to the leads; a hum stands out from it in both. Bands below
    what the leads resolve are left to the fit.
    """
    trials = list(dict.fromkeys(owners))
    quiet = np.zeros(hertz.size)
    for i in trials:
        ready = scene.parts[i]
        n, interval = ready.lead.n_samples, ready.drive.interval
        if not scene.noise.known or hertz[-1] * n * interval < 1:
            return 0.0
        white = scene.noise.white(i, np.asarray(ready.response[:n])[:, None])[:, 0]
        turn = np.exp(-2j * np.pi * np.outer(hertz, np.arange(n) * interval))
        quiet += np.abs(turn @ white) ** 2 / n / len(trials)
    return float(stats.f.sf(power.mean() / quiet.max(), 2 * power.size, 2 * len(trials)))


def _octaves(highest: int) -> np.ndarray:
    """Edges of bands an octave wide, as numbers of periods in a segment, without its mean."""
    edges = [1]
    while edges[-1] < highest:
        edges.append(min(max(2 * edges[-1], edges[-1] + 1), highest))
    return np.array(edges)


def _frequency_sentence(
    scene: _Scene,
    hertz: np.ndarray,
    ratio: np.ndarray,
    flags: np.ndarray,
    coherent: np.ndarray,
    coherence_known: bool,
) -> str:
    imposed_signal = scene.parts[0].trial.driven
    if not scene.noise.known:
        if not coherence_known:
            return "The noise is unknown and there are too few trials for a coherence."
        if not coherent.any():
            return f"At no frequency is the residual coherent with the imposed {imposed_signal}."
        return (
            f"The residual is coherent with the imposed {imposed_signal} at "
            f"{_bands(hertz, coherent)}: what is missing is driven by it (the noise is unknown)."
        )
    if not flags.any():
        return f"At no frequency does the residual's power exceed the noise's ({flags.size} bands)."
    worst = int(np.argmax(np.where(flags, ratio, 0.0)))
    sentence = (
        f"The residual's power exceeds the noise's at {_bands(hertz, flags)}, most "
        f"({plain(ratio[worst])} times) at {plain(hertz[worst])} to {plain(hertz[worst + 1])} Hz"
    )
    if not coherence_known:
        return sentence + "."
    if (coherent & flags).any():
        return sentence + f"; it is coherent with the imposed {imposed_signal}."
    return sentence + f"; it is not coherent with the imposed {imposed_signal}."


def _bands(hertz: np.ndarray, flags: np.ndarray) -> str:
    """Flagged bands in words, neighbours joined."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    pairs = edge.reshape(-1, 2)
    return " and ".join(f"{plain(hertz[low])} to {plain(hertz[high])} Hz" for low, high in pairs)


# State


def _in_state(scene: _Scene) -> StateView:
    """Unexplained torque against angle and velocity, by generalised least squares.

    A torque f(angle) + g(velocity), both piecewise linear, acts on the joint that the model says it
    is (with the candidate's K, B and I), and the response to it is fitted to the whitened residual
    together with changes of K, B and I and of the trials' levels. This needs no second derivative
    of the measured angle. A torque over the plane of both is not determined by transients, each of
    which visits one line in it.
    """
    motions = [
        _motion(ready, left)
        for ready, left in zip(scene.parts, scene.candidate.fitted.by_trial, strict=True)
    ]
    knots = [_knots(np.concatenate([motion[k] for motion in motions])) for k in (0, 1)]
    _, slopes = scene.refits.linearised(scene.refits.values)
    values, nuisance, forced = [], [], []
    often = np.zeros(2 * _KNOTS)
    for i, (ready, b) in enumerate(_observed(scene)):
        hats = np.column_stack([_hats(x, k) for x, k in zip(motions[i], knots, strict=True)])
        often += np.sum(hats[b.index[:, 0]] ** 2, axis=0)
        forced.append(scene.noise.averaged(i, _response_to(scene, ready, hats), b.index))
        levels = np.zeros((len(b.values), len(scene.parts)))
        ones = np.ones((len(hats), 1))
        levels[:, i] = scene.noise.averaged(i, ones, b.index)[:, 0]
        nuisance.append(np.column_stack([scene.noise.averaged(i, slopes[i], b.index), levels]))
        values.append(b.values)
    taken = _span(np.concatenate(nuisance))
    design, left = (
        rows - taken @ (taken.T @ rows) for rows in map(np.concatenate, (forced, values))
    )
    misfit = float(left @ left) - (left.size - taken.shape[1])
    both, angle, velocity = (
        _regression(left, design, knots, often, parts) for parts in ((0, 1), (0,), (1,))
    )
    if not both.rank:
        reason = "The trials visit too few states to tell where in them the model fails."
        return StateView(False, reason, None, None, 0.0, 1.0)
    owner = np.repeat(np.arange(len(scene.parts)), [len(b.values) for b in scene.blocks])
    numbers = np.bincount(owner, both.leverage, len(scene.parts))
    portions = [
        Portion(float(n), 0.0, float(dof)) for n, dof in zip(numbers, scene.noise.dof, strict=True)
    ]
    p_value = excess(both.gained, portions, scene.slow_slack)[1]
    shares = [
        float(np.clip((fit.gained - fit.rank) / misfit, 0.0, 1.0)) if misfit > 0 else 0.0
        for fit in (both, angle, velocity)
    ]
    p_values = 2 * stats.norm.sf(np.abs(both.torque) / np.maximum(both.errors, 1e-300))
    flags = scene.significant(p_values)
    curves = [
        Curve(knots[k], both.torque[part], both.errors[part], flags[part], shares[1 + k])
        for k, part in enumerate((slice(0, _KNOTS), slice(_KNOTS, None)))
    ]
    if p_value > scene.level:
        chance = probability(p_value)
        sentence = f"No torque that depends on angle and velocity alone is missing ({chance})."
        return StateView(False, sentence, curves[0], curves[1], 0.0, p_value)
    sentence = (
        "A torque that depends on the present angle and velocity would explain "
        f"{100 * shares[0]:.0f} % of the misfit, one that depends on the angle alone "
        f"{100 * shares[1]:.0f} %, on the velocity alone {100 * shares[2]:.0f} %."
    )
    return StateView(True, sentence, curves[0], curves[1], shares[0], p_value)


@dataclass(frozen=True, eq=False)
class _Regression:
    """A residual explained by torques at knots."""

    torque: np.ndarray
    errors: np.ndarray
    gained: float
    rank: int
    leverage: np.ndarray


def _regression(
    left: np.ndarray,
    design: np.ndarray,
    knots: Sequence[np.ndarray],
    often: np.ndarray,
    parts: Sequence[int],
) -> _Regression:
    """Fit torques at the knots of angle (0), velocity (1) or both.

    They are in units of the torque times the root of the time spent there, and are orthogonal to
    the linear torques; of what is ill determined the smallest is taken.
    """
    basis = np.zeros((2 * _KNOTS, 0))
    for k in parts:
        # At rest there is no torque, and what is not visited is not asked for.
        used = k * _KNOTS + np.flatnonzero((knots[k] != 0) & (often[k * _KNOTS :][:_KNOTS] >= 1))
        if used.size < 3:
            continue
        root = np.sqrt(often[used])[:, None]
        block = np.zeros((2 * _KNOTS, used.size - 1))
        block[used] = _orthogonal_to(root * knots[k][used - k * _KNOTS][:, None]) / root
        basis = np.column_stack([basis, block])
    none = np.zeros(2 * _KNOTS)
    if not basis.size:
        return _Regression(none, none, 0.0, 0, np.zeros(left.size))
    reduced = design @ basis
    inverse = np.linalg.pinv(reduced, rcond=_DETERMINED)
    leverage = np.sum(reduced * inverse.T, axis=1)
    coefficients = inverse @ left
    remaining = left - reduced @ coefficients
    spread = max(1.0, float(np.mean(remaining**2)) * correlation_time((remaining,)))
    return _Regression(
        basis @ coefficients,
        np.sqrt(spread * np.sum((basis @ inverse) ** 2, axis=1)),
        float(left @ left - remaining @ remaining),
        round(float(leverage.sum())),
        np.maximum(leverage, 0.0),
    )


def _knots(values: np.ndarray) -> np.ndarray:
    """Places symmetric about 0 that span most values, closer near rest."""
    reach = max(float(np.quantile(np.abs(values), _REACH)), 1e-12)
    place = np.linspace(-1, 1, _KNOTS)
    return np.asarray(reach * np.sign(place) * np.abs(place) ** 1.5)


def _hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Functions that are 1 at one knot and fall to 0 at its neighbours, shape (n, n_knots)."""
    return np.column_stack([np.interp(values, knots, row) for row in np.eye(knots.size)])


def _motion(ready: Ready, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity at the compared samples; of an imposed torque, as the model has them."""
    if ready.trial.driven == "angle":
        signals = ready.drive.signals[ready.first : ready.last]
        return signals[:, 0], signals[:, 1]
    angle = ready.compared - left
    return angle, np.gradient(angle, ready.drive.interval)


def _response_to(scene: _Scene, ready: Ready, torque: np.ndarray) -> np.ndarray:
    """Change of the response to additional resisting torques, shape (n, k)."""
    if ready.trial.driven == "angle":
        return torque
    K, B, I = scene.refits.values
    system = np.array([[0.0, 1.0, 0.0], [-K / I, -B / I, 1 / I], [0.0, 0.0, 0.0]])
    # Motion is slow within a sample: the torque is as good as constant.
    step = linalg.expm(system * ready.drive.interval)
    forward = [0.0, step[0, 2], step[0, 1] * step[1, 2] - step[1, 1] * step[0, 2]]
    back = [1.0, -step[0, 0] - step[1, 1], step[0, 0] * step[1, 1] - step[0, 1] * step[1, 0]]
    return -np.asarray(signal.lfilter(forward, back, torque, axis=0))


def _orthogonal_to(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what is orthogonal to some columns."""
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=True)
    rank = int(np.sum(sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)))
    return np.asarray(vectors[:, rank:])


def _span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what some columns span."""
    norms = np.linalg.norm(columns, axis=0)
    vectors, sizes, _ = np.linalg.svd(columns[:, norms > 0] / norms[norms > 0], full_matrices=False)
    return np.asarray(vectors[:, sizes > 1e-9])


# Direction and size


@dataclass(frozen=True, eq=False)
class _Combined:
    """Weighted sum of two trials' residuals, in units of its noise."""

    values: np.ndarray
    time: np.ndarray
    portion: Portion


def _combined(scene: _Scene, i: int, j: int, weight: float) -> _Combined:
    """Residual of trial j plus `weight` times that of trial i."""
    one, other = scene.blocks[i], scene.blocks[j]
    n = min(one.values.size, other.values.size)
    variances = np.array([(weight * scene.noise.sds[i]) ** 2, scene.noise.sds[j] ** 2])
    total = variances.sum()
    values = (
        weight * scene.noise.sds[i] * one.values[:n] + scene.noise.sds[j] * other.values[:n]
    ) / np.sqrt(total)
    shares = variances / total
    levels = np.array([one.level[:n] @ one.level[:n], other.level[:n] @ other.level[:n]])
    dof = 1 / np.sum(shares**2 / scene.noise.dof[[i, j]])
    return _Combined(values, other.time[:n], Portion(n, float(shares @ levels), float(dof)))


def _profile(
    scene: _Scene, combined: Sequence[_Combined], edges: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Mean squares over the noise's by time; the ratio over all times, and its probability."""
    bins = [_bin(c.time, edges) for c in combined]
    squares = np.zeros(edges.size - 1)
    numbers = np.zeros(edges.size - 1)
    for c, inside in zip(combined, bins, strict=True):
        squares += np.bincount(inside, c.values**2, edges.size - 1)
        numbers += np.bincount(inside, minlength=edges.size - 1)
    total = sum(float(c.values @ c.values) for c in combined)
    ratio, p_value = excess(total, [c.portion for c in combined], scene.slack)
    return squares / np.maximum(numbers, 1), ratio, p_value


def _alike(scene: _Scene) -> list[tuple[int, int, float]]:
    """Pairs of trials of one waveform and length, the smaller first, and the ratio of sizes."""
    found = []
    for i, one in enumerate(scene.loads):
        for j, other in enumerate(scene.loads):
            ratio = other.gain / one.gain if one.gain else 0.0
            same = i != j and one.kind == other.kind and scene.blocks[i].time.size > 0
            if same and (abs(ratio) > 1 or (abs(ratio) == 1 and i < j)):
                found.append((i, j, ratio))
    return found


def _names(scene: _Scene, pairs: Sequence[tuple[int, int, float]]) -> tuple[tuple[str, str], ...]:
    return tuple((scene.parts[i].name, scene.parts[j].name) for i, j, _ in pairs)


def _by_direction(scene: _Scene) -> DirectionView:
    pairs = [p for p in _alike(scene) if abs(p[2] + 1) < _OPPOSITE]
    if not pairs:
        none = np.zeros(0)
        reason = (
            "No two trials are the same perturbation in opposite directions, so the misfit cannot "
            "be split into parts that keep and that turn their sign."
        )
        return DirectionView(False, reason, (), none, none, none, 1.0, 1.0, False, False)
    even = [_combined(scene, i, j, 1.0) for i, j, _ in pairs]
    odd = [_combined(scene, i, j, -1.0) for i, j, _ in pairs]
    edges = _edges(scene, {k for i, j, _ in pairs for k in (i, j)})
    even_profile, even_ratio, p_even = _profile(scene, even, edges)
    odd_profile, odd_ratio, p_odd = _profile(scene, odd, edges)
    is_even, is_odd = (bool(f) for f in scene.significant(np.array([p_even, p_odd])))
    sizes = (
        f"(even part {plain(np.sqrt(even_ratio))}, odd part {plain(np.sqrt(odd_ratio))} times "
        f"{scene.reference})"
    )
    sentence = {
        (False, False): f"Neither direction shows a misfit {sizes}.",
        (False, True): f"The misfit turns its sign with the perturbation {sizes}.",
        (True, False): f"The misfit keeps its sign when the perturbation turns {sizes}.",
        (
            True,
            True,
        ): f"The misfit differs between the directions, and partly turns with them {sizes}.",
    }[is_even, is_odd]
    return DirectionView(
        is_even or is_odd,
        sentence,
        _names(scene, pairs),
        edges,
        even_profile,
        odd_profile,
        p_even,
        p_odd,
        is_even,
        is_odd,
    )


def _misfit(scene: _Scene, trials: Iterable[int]) -> bool:
    """Whether some trials' residuals exceed the noise at all."""
    chosen = [(i, scene.blocks[i]) for i in trials]
    everything = slice(None)
    portions = [scene.noise.portion(i, blocks, everything) for i, blocks in chosen]
    total = sum(float(blocks.values @ blocks.values) for _, blocks in chosen)
    return excess(total, portions, scene.slack)[1] <= scene.level


def _by_amplitude(scene: _Scene) -> AmplitudeView:
    different = [p for p in _alike(scene) if abs(p[2]) > _OTHER_SIZE]
    # Trials of one direction tell size from direction; others serve where there are none.
    pairs = [p for p in different if p[2] > 0] or different
    if not pairs:
        none = np.zeros(0)
        reason = (
            "No two trials are the same perturbation at two sizes, so whether the misfit scales "
            "with it is not known."
        )
        return AmplitudeView(False, reason, (), (), none, none, 1.0)
    combined = [_combined(scene, i, j, -ratio) for i, j, ratio in pairs]
    edges = _edges(scene, {k for i, j, _ in pairs for k in (i, j)})
    profile, ratio, p_value = _profile(scene, combined, edges)
    significant = p_value <= scene.level
    size = f"{plain(np.sqrt(ratio))} times {scene.reference}"
    if significant:
        sentence = (
            "The residual does not scale with the perturbation (the difference is "
            f"{size}): what is missing is not linear."
        )
        if pairs[0][2] < 0:
            sentence = (
                "The residual does not scale with the perturbation (the difference is "
                f"{size}), but size and direction differ together."
            )
    elif _misfit(scene, {k for i, j, _ in pairs for k in (i, j)}):
        sentence = (
            f"The misfit scales with the perturbation (the difference is {size}, "
            f"{probability(p_value)}): what is missing looks linear."
        )
    else:
        sentence = (
            f"Neither size shows a misfit (the scaled difference is {size}, "
            f"{probability(p_value)})."
        )
    return AmplitudeView(
        significant,
        sentence,
        _names(scene, pairs),
        tuple(float(p[2]) for p in pairs),
        edges,
        profile,
        p_value,
    )


# Trials and conditions


def _by_trial(
    scene: _Scene, groups: Sequence[tuple[str, list[int]]], what: str, plural: str
) -> TrialView:
    fitted = scene.candidate.fitted
    names = tuple(name for name, _ in groups)
    errors = np.array([float(np.mean(fitted.errors[members])) for _, members in groups])
    n = len(groups)
    ratio, p_values = np.ones(n), np.ones(n)
    if scene.noise.known:
        for k, (_, members) in enumerate(groups):
            portions = [scene.noise.portion(i, scene.blocks[i], slice(None)) for i in members]
            total = sum(float(np.sum(scene.blocks[i].values ** 2)) for i in members)
            ratio[k], p_values[k] = excess(total, portions, scene.slack)
    elif n > 1:
        # The noise may be alike in all trials, or in proportion to the response: exceed both.
        squares = [float(np.mean(r**2)) for r in fitted.by_trial]
        samples = [r.size / correlation_time((r,)) for r in fitted.by_trial]
        counts = np.array([sum(samples[i] for i in members) for _, members in groups])
        levels = np.array([np.mean([squares[i] for i in members]) for _, members in groups])
        for k in range(n):
            others = np.arange(n) != k
            ratio[k] = min(
                x[k] / max(float(np.average(x[others], weights=counts[others])), 1e-300)
                for x in (errors, levels)
            )
            p_values[k] = stats.f.sf(ratio[k], counts[k], counts[others].sum())
    flags = scene.significant(p_values)
    pooled = fitted.error
    if n == 1 and not scene.noise.known:
        sentence = f"There is one {what} (E = {plain(pooled)}), and the noise is unknown."
    elif not flags.any():
        against = (
            "the noise explains" if scene.noise.known else "the others have (the noise is unknown)"
        )
        sentence = f"No {what} has a larger error than {against} (E = {plain(pooled)})."
    else:
        worst = int(np.argmax(np.where(flags, ratio, 0.0)))
        against = (
            "the noise explains" if scene.noise.known else "the others have (the noise is unknown)"
        )
        sentence = (
            f"{flags.sum()} of {n} {plural} have a larger error than {against}; it is largest "
            f"against that in {names[worst]} (E = {plain(errors[worst])}, over all "
            f"{plain(pooled)})."
        )
        if n == 1:
            sentence = f"The one {what} has a larger error than {against} (E = {plain(pooled)})."
    return TrialView(bool(flags.any()), sentence, names, errors, pooled, ratio, p_values, flags)
