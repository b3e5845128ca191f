"""Fits of a joint model to recorded trials: whole, by window, and on data that was held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import signal

from identifiability.errors import InputError
from identifiability.inference.fitting import Fit, fit, starting_points
from identifiability.inference.problem import Observation, Prior, Problem, observe
from identifiability.inference.widths import Widths, widths
from identifiability.joint.model import KBI, Model
from identifiability.measurement.filtering import Lowpass, cutoff, smooth
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial, onsets, quiet_lead

_QUIET_SAMPLES = 10


@dataclass(frozen=True, eq=False)
class Prepared:
    """A trial made ready to be fitted.

    Attributes
    ----------
    trial : Trial
        Filtered and freed of its operating point; its notes say how.
    time : array, shape (n,)
        Times [s] of the samples that are computed.
    drive : Drive
        What was imposed, at those samples.
    response : array, shape (n,)
        What was measured: angle [rad] or torque [Nm].
    stride : int
        Every so-many-th of these samples is compared; after a low-pass filter those between tell
        nothing new.
    onsets : array of int
        Samples at which the imposed signal starts to move.
    has_offset : bool
        Whether the response's level at rest is unknown. It is known where a quiet lead was
        recorded.
    settled : (int, int)
        First and last of these samples (excluded) that the ends of the filter do not touch.
    """

    trial: Trial
    time: np.ndarray
    drive: Drive
    response: np.ndarray
    stride: int
    onsets: np.ndarray
    has_offset: bool
    settled: tuple[int, int]

    @property
    def interval(self) -> float:
        """Sampling interval [s]."""
        return self.drive.interval


def prepare(trial: Trial, model: Model, *, lowpass_hz: Lowpass = "auto") -> Prepared:
    """Filter a trial and take off its operating point.

    With an imposed angle the model predicts torque from the angle's second derivative, which
    amplifies noise; both channels then pass the same zero-phase low-pass filter, so that a linear
    model keeps its parameters. With an imposed torque the angle is simulated and nothing is
    filtered.

    Parameters
    ----------
    trial : Trial
    model : Model
        One without internal states needs no samples between those that are compared.
    lowpass_hz : float, "auto" or None
        Cut-off frequency [Hz] for an imposed angle; "auto" is the usual one, or that above which
        the angle is but noise (`noise_cutoff`); ``None`` for no filter.

    Returns
    -------
    Prepared
    """
    moves = onsets(trial)
    if trial.driven == "torque":
        # A lead must be long enough to average over; otherwise the record starts at rest as it is.
        quiet = quiet_lead(trial) >= _QUIET_SAMPLES
        ready = trial.centred("baseline" if quiet else "none")
        drive = SampledTorque(ready.torque).drive(ready.time)
        everything = (0, ready.n_samples)
        return Prepared(ready, ready.time, drive, ready.angle, 1, moves, not quiet, everything)
    smoothed = smooth(trial, cutoff([trial], lowpass_hz))
    ready, every = smoothed.trial, smoothed.every
    drive = imposed_motion(ready.time, ready.angle)
    if model.n_internal or not model.linear:
        return Prepared(
            ready, ready.time, drive, ready.torque, every, moves, True, smoothed.settled
        )
    thinned = replace(
        drive,
        interval=drive.interval * every,
        states=drive.states[::every],
        impulses=drive.impulses[::every],
    )
    kept = slice(None, None, every)
    return Prepared(
        ready,
        ready.time[kept],
        thinned,
        ready.torque[kept],
        1,
        moves // every,
        True,
        smoothed.settled_of_kept,
    )


@dataclass(frozen=True, eq=False)
class Selection:
    """Samples of one trial that are compared.

    Attributes
    ----------
    samples : array of int, shape (k,)
    stretches : int
        Number of windows they come from.
    segment : array of int, shape (k,), or None
        Number of the stretch that each sample belongs to, where each has an unknown offset.
    """

    samples: np.ndarray
    stretches: int
    segment: np.ndarray | None

    def centred(self, values: np.ndarray) -> np.ndarray:
        """Values at the selected samples, without the mean of their stretch if it has an offset.

        Parameters
        ----------
        values : array, shape (n,)
            At all samples of the trial.

        Returns
        -------
        array, shape (k,)
        """
        chosen = values[self.samples]
        if self.segment is None:
            return chosen
        means = np.bincount(self.segment, chosen) / np.bincount(self.segment)
        return chosen - means[self.segment]


def whole(prepared: Prepared, start: float = 0.0, stop: float = 1.0) -> Selection:
    """All compared samples between two fractions of the trial."""
    n, (first, last) = prepared.time.size, prepared.settled
    low, high = max(round(start * n), first), min(round(stop * n), last)
    samples = np.arange(low, high, prepared.stride)
    return Selection(samples, 1, np.zeros(samples.size, int) if prepared.has_offset else None)


def windows(prepared: Prepared, window: float) -> Selection:
    """Samples within `window` seconds of each onset; in windows that do not overlap.

    Raises
    ------
    InputError
        Where the window is longer than the record, or holds fewer than five samples.
    """
    trial = prepared.trial
    if window > trial.duration * (1 + 1e-9):
        raise InputError(
            f"found a window of {window:g} s for the trial '{trial.name}' of {trial.duration:g} s; "
            "choose a shorter window"
        )
    length = round(window / prepared.interval)
    if length < 4 * prepared.stride:
        raise InputError(
            f"found a window of {window:g} s, which holds fewer than five samples of the trial "
            f"'{trial.name}'; choose a longer window"
        )
    stretches = [
        np.arange(onset, onset + length + 1, prepared.stride)
        for i, onset in enumerate(prepared.onsets)
        # A window is used only if it ends within the record and before the next perturbation.
        if onset + length < prepared.time.size
        and (i + 1 == len(prepared.onsets) or onset + length < prepared.onsets[i + 1])
    ]
    if not stretches:
        raise InputError(
            f"no perturbation of the trial '{trial.name}' is followed by {window:g} s of its own; "
            "choose a shorter window"
        )
    segment = np.repeat(np.arange(len(stretches)), [s.size for s in stretches])
    offsets = segment if prepared.has_offset else None
    return Selection(np.concatenate(stretches), len(stretches), offsets)


def recording_problem(
    prepared: Sequence[Prepared],
    selections: Sequence[Selection],
    *,
    model: Model,
    prior: Prior,
    noises: Sequence[Noise] | None = None,
) -> Problem:
    """Problem of fitting a model to selected samples of trials.

    Parameters
    ----------
    prepared : sequence of Prepared
    selections : sequence of Selection
        One a trial.
    model : Model
    prior : Prior
    noises : sequence of Noise, optional
        One a trial. By default each trial weighs by its own energy, as the error E does, so that
        ``2 * cost`` is the sum of the trials' errors E.

    Returns
    -------
    Problem
    """
    observations: list[Observation] = []
    for i, (trial, selection) in enumerate(zip(prepared, selections, strict=True)):
        if noises is None:
            energy = np.sum(selection.centred(trial.response) ** 2)
            noise = Noise(float(np.sqrt(energy)))
        else:
            noise = noises[i]
        observations.append(
            observe(
                trial.drive,
                trial.response,
                noise,
                select=selection.samples,
                segment=selection.segment,
            )
        )
    return Problem(model, observations, prior)


@dataclass(frozen=True)
class Goodness:
    """How well a model describes a response.

    Attributes
    ----------
    error : float
        E (Eq. 3): summed squared residual over summed squared response, both without the offset
        where there is one.
    vaf : float
        Variance accounted for [%].
    n_samples : int
    """

    error: float
    vaf: float
    n_samples: int


@dataclass(frozen=True, eq=False)
class WindowFit:
    """Fit within a window after each perturbation.

    Attributes
    ----------
    window : float
        T [s].
    n_windows : int
        Number of perturbations that contributed.
    widths : Widths
    goodness : Goodness
    """

    window: float
    n_windows: int
    widths: Widths
    goodness: Goodness


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Fit to one part of the data, judged on the other.

    Attributes
    ----------
    fitted, held_out : str
        Which part is which, in words.
    fit : Fit
    goodness_fitted, goodness_held_out : Goodness
    """

    fitted: str
    held_out: str
    fit: Fit
    goodness_fitted: Goodness
    goodness_held_out: Goodness


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """What a fit to recordings gave.

    Attributes
    ----------
    prepared : tuple of Prepared
    problem : Problem
    widths : Widths
    goodness : Goodness
    noises : tuple of Noise
        Per trial the residual's standard deviation, inflated for its correlation.
    independent_fractions : tuple of float
        Per trial the share of samples that count as independent.
    predictions : tuple of array
        Per trial the fitted response, its offset included, at every sample.
    windows : tuple of WindowFit
    held_out : HeldOut or None
    warnings : tuple of str
    """

    prepared: tuple[Prepared, ...]
    problem: Problem
    widths: Widths
    goodness: Goodness
    noises: tuple[Noise, ...]
    independent_fractions: tuple[float, ...]
    predictions: tuple[np.ndarray, ...]
    windows: tuple[WindowFit, ...]
    held_out: HeldOut | None
    warnings: tuple[str, ...] = field(default=())


def fit_recordings(
    trials: Sequence[Trial],
    *,
    model: Model | None = None,
    window_lengths: Sequence[float] = (),
    prior: Prior | None = None,
    lowpass_hz: Lowpass = "auto",
    seed: int = 1,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> RecordingFit:
    """Fit a linear joint model to recorded trials, with every width, by window and held out.

    The estimate is that of least squares. Its residual is rarely white, so the noise that the
    widths are computed for has the residual's variance times its integrated autocorrelation time:
    the likelihood of as many samples as are independent. Where the model is wrong the residual is
    not noise at all, and these widths are the smallest that can be defended.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    model : Model, optional
        ``KBI()`` by default.
    window_lengths : sequence of float
        Windows T [s] after each perturbation, to be fitted one by one.
    prior : Prior, optional
        Uniform within the physical bounds by default.
    lowpass_hz : float, "auto" or None
        See `prepare`; one for all trials.
    seed : int
    progress : callable
        Told ``(what, done, total)`` before each part of the work.

    Returns
    -------
    RecordingFit

    Raises
    ------
    InputError
        Where there is no trial, or the trials are driven differently, or a window does not fit.
    """
    if not trials:
        raise InputError("found no trials, expected at least one")
    if len({trial.driven for trial in trials}) > 1:
        raise InputError("found torque- and angle-driven trials together; fit them one by one")
    model = KBI() if model is None else model
    prior = Prior.physical(model) if prior is None else prior
    cutoff_hz = cutoff(trials, lowpass_hz)
    prepared = tuple(prepare(trial, model, lowpass_hz=cutoff_hz) for trial in trials)
    selections_by_window = [[windows(p, length) for p in prepared] for length in window_lengths]
    selections = [whole(p) for p in prepared]
    start = first_guess([p.trial for p in prepared], prior)
    starts_seed, *window_seeds = np.random.SeedSequence(seed).generate_state(
        1 + len(window_lengths)
    )

    def study(
        chosen: Sequence[Selection], sampler_seed: int, referee: bool
    ) -> tuple[Problem, Widths, Goodness, list[Noise], list[float]]:
        rough = recording_problem(prepared, chosen, model=model, prior=prior)
        starts = starting_points(rough, start, 6, int(starts_seed))
        best = fit(rough, starts)
        noises, fractions = _noises(rough, best, chosen)
        problem = recording_problem(prepared, chosen, model=model, prior=prior, noises=noises)
        result = widths(problem, starts=best.values[None], seed=int(sampler_seed), referee=referee)
        return problem, result, goodness(problem, result.fit, chosen), noises, fractions

    total = 2 + len(window_lengths)
    progress("whole records: fit, profiles, posterior, quadrature", 1, total)
    problem, result, quality, noises, fractions = study(selections, seed, True)
    by_window: list[WindowFit] = []
    for length, chosen, child in zip(
        window_lengths, selections_by_window, window_seeds, strict=True
    ):
        progress(f"windows of {1000 * length:g} ms", 2 + len(by_window), total)
        _, within, within_quality, _, _ = study(chosen, int(child), False)
        n_windows = sum(s.stretches for s in chosen)
        by_window.append(WindowFit(length, n_windows, within, within_quality))
    progress("fit to one part, judged on the other", total, total)
    held_out, remarks = _hold_out(prepared, model, prior, start, int(starts_seed))
    predictions = []
    for p, selection, response in zip(
        prepared, selections, problem.responses(result.fit.values), strict=True
    ):
        missed = (p.response - response)[selection.samples]
        offset = np.mean(missed) if p.has_offset else 0.0
        predictions.append(response + offset)
    return RecordingFit(
        prepared,
        problem,
        result,
        quality,
        tuple(noises),
        tuple(fractions),
        tuple(predictions),
        tuple(by_window),
        held_out,
        tuple(remarks),
    )


def goodness(problem: Problem, best: Fit, selections: Sequence[Selection]) -> Goodness:
    """Error and variance accounted for of a fit at selected samples, pooled over trials.

    Each trial weighs by its own energy in the error, and by its variance in the VAF.
    """
    errors, residual_power, power, n = [], 0.0, 0.0, 0
    responses = problem.responses(best.values)
    for observation, response, selection in zip(
        problem.observations, responses, selections, strict=True
    ):
        measured = selection.centred(observation.measured)
        residual = selection.centred(response - observation.measured)
        errors.append(np.sum(residual**2) / np.sum(measured**2))
        residual_power += float(np.sum(residual**2))
        power += float(np.sum(measured**2))
        n += measured.size
    return Goodness(float(np.mean(errors)), 100 * (1 - residual_power / power), n)


def integrated_autocorrelation(residual: np.ndarray) -> float:
    """Integrated autocorrelation time of a residual, in samples, at least 1.

    Summed up to the first lag beyond five times the sum so far (Sokal's window).

    Parameters
    ----------
    residual : array, shape (n,)
    """
    x = np.asarray(residual, float) - np.mean(residual)
    n = x.size
    power = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    covariance = np.fft.irfft(power)[:n]
    if covariance[0] == 0:
        return 1.0
    times = 2 * np.cumsum(covariance / covariance[0]) - 1
    beyond = np.flatnonzero(np.arange(n) >= 5 * times)
    return float(max(1.0, times[beyond[0] if beyond.size else n - 1]))


def _noises(
    problem: Problem, best: Fit, selections: Sequence[Selection]
) -> tuple[list[Noise], list[float]]:
    """Noise whose white likelihood is worth as many samples as are independent."""
    noises, fractions = [], []
    for observation, response, selection in zip(
        problem.observations, problem.responses(best.values), selections, strict=True
    ):
        residual = selection.centred(response - observation.measured)
        n_offsets = observation.n_offsets
        dof = max(1, residual.size - n_offsets - len(best.values) / len(problem.observations))
        variance = float(np.sum(residual**2)) / dof
        if variance == 0:
            variance = 1e-24 * float(np.mean(observation.measured**2))
        time = integrated_autocorrelation(residual)
        noises.append(Noise(float(np.sqrt(variance * time))))
        fractions.append(1 / time)
    return noises, fractions


def _hold_out(
    prepared: Sequence[Prepared], model: Model, prior: Prior, start: np.ndarray, seed: int
) -> tuple[HeldOut | None, list[str]]:
    """Fit one part, judge on the other: trials where there are several, else halves in time."""
    if len(prepared) > 1:
        half = (len(prepared) + 1) // 2
        parts = [list(prepared[:half]), list(prepared[half:])]
        selections = [[whole(p) for p in part] for part in parts]
        words = [f"the first {half} of {len(prepared)} trials", f"the other {len(prepared) - half}"]
    else:
        middle = prepared[0].time.size // 2
        moves = prepared[0].onsets
        continuous = len(moves) == 1 and moves[0] == 0 and prepared[0].trial.driven == "torque"
        if not continuous and not (np.any(moves < middle) and np.any(moves >= middle)):
            remark = (
                "nothing was held out: there is one trial, and it is not perturbed in both halves"
            )
            return None, [remark]
        parts = [[prepared[0]], [prepared[0]]]
        selections = [[whole(prepared[0], 0.0, 0.5)], [whole(prepared[0], 0.5, 1.0)]]
        words = ["the first half", "the second half"]
    problems = [
        recording_problem(part, chosen, model=model, prior=prior)
        for part, chosen in zip(parts, selections, strict=True)
    ]
    best = fit(problems[0], starting_points(problems[0], start, 6, seed))
    return HeldOut(
        words[0],
        words[1],
        best,
        goodness(problems[0], best, selections[0]),
        goodness(problems[1], best, selections[1]),
    ), []


def first_guess(trials: Sequence[Trial], prior: Prior) -> np.ndarray:
    """K, B and I by linear regression of torque on the smoothed motion, within the bounds.

    Parameters
    ----------
    trials : sequence of Trial
    prior : Prior
        Its first three bounds are those of K, B and I.

    Returns
    -------
    array, shape (3,)
    """
    rows, targets = [], []
    for trial in trials:
        angle, torque = trial.angle, trial.torque
        if trial.driven == "torque":
            sos = signal.butter(
                2, min(0.4 * trial.sampling_rate, 30.0), fs=trial.sampling_rate, output="sos"
            )
            pad = min(angle.size - 1, 3 * int(trial.sampling_rate / 30.0))
            angle, torque = (signal.sosfiltfilt(sos, x, padlen=pad) for x in (angle, torque))
        motion = imposed_motion(trial.time, angle).signals
        scale = np.std(torque)
        rows.append(np.column_stack([motion - motion.mean(axis=0)]) / scale)
        targets.append((torque - torque.mean()) / scale)
    guess = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    lower, upper = prior.lower[:3], prior.upper[:3]
    return np.clip(np.where(guess > 0, guess, [50.0, 1.0, 0.05]), lower, upper)
