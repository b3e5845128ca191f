"""Fits of a joint model to recorded trials: whole, by window, and on data that was held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.between import joined
from identifiability.inference.fitting import Fit, explore, fit, starting_points
from identifiability.inference.noisy import NoisyFit, fit_noisy
from identifiability.inference.problem import Observation, Prior, Problem, observe
from identifiability.inference.starts import first_guess, plain_values, starting_values
from identifiability.inference.widths import Widths, widths
from identifiability.joint.model import KBI, Model
from identifiability.joint.scheme import LEAST, MOST, SHARE, Scheme
from identifiability.measurement.filtering import Lowpass, known_noise
from identifiability.measurement.noise import Noise
from identifiability.measurement.prepared import Prepared, prepare, prepare_whole_band
from identifiability.measurement.splitting import Parts, Rule, hold_out
from identifiability.measurement.trials import Trial
from identifiability.progress import Progress, silent

_STARTS = 6
_EVALUATIONS = 60  # from each start, of a model with effects


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

    @property
    def pieces(self) -> list[np.ndarray]:
        """Samples of each stretch."""
        return list(np.split(self.samples, self.stretches))  # all of one length

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


def whole(prepared: Prepared) -> Selection:
    """All samples of a trial, or of its part, that are to be compared."""
    samples = np.arange(prepared.first, prepared.last)
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
    if length < 4:
        raise InputError(
            f"found a window of {window:g} s, which holds fewer than five samples of the trial "
            f"'{trial.name}'; choose a longer window"
        )
    stretches = [
        np.arange(onset, onset + length + 1)
        for i, onset in enumerate(prepared.onsets)
        # A window is used only if it lies within the compared samples, and ends before the next
        # perturbation.
        if prepared.first <= onset
        and onset + length < prepared.last
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
    refined: bool = False,
    scheme: Scheme | None = None,
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
    refined : bool
        Whether parameters that only refine an effect are free too.
    scheme : Scheme, optional
        How responses are computed; by default as nominal parameters ask for.

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
    return Problem(
        model,
        observations,
        prior,
        fixed=plain_values(model, model.effect_keys if refined else ()),
        scheme=scheme,
    )


def best_fit(problem: Problem, guess: np.ndarray, seed: int) -> tuple[Problem, Fit]:
    """Fit a model from starts about a first guess of K, B and I.

    A model with effects starts from the best K, B and I alone, with its effects near their null,
    at several values of what shapes them.

    Parameters
    ----------
    problem : Problem
        In which each trial weighs by its energy, so that ``2 * cost`` is a sum of errors E.
    guess : array, shape (3,)
        K, B and I.
    seed : int
        Of the starts.

    Returns
    -------
    Problem
        Integrated in steps that suit the fit.
    Fit

    Raises
    ------
    InputError
        Where no start leads to a finite response, or no steps are fine enough.
    """
    model = problem.model
    if not model.effects:
        return problem, fit(problem, starting_points(problem, guess, _STARTS, seed))
    prior = Prior(problem.prior.lower[:3], problem.prior.upper[:3])
    _, alone = best_fit(Problem(KBI(), problem.observations, prior), guess, seed)
    known = {name: alone[name] for name in alone.names}
    points = np.array([problem.free_vector(s) for s in starting_values(model, known)])
    while True:
        best = explore(problem, points, evaluations=_EVALUATIONS)
        finer = _resolved(problem, best)
        if not finer.integration.is_finer_than(problem.integration):
            return problem, best
        problem, points = finer, best.values[None]


def _resolved(problem: Problem, best: Fit) -> Problem:
    """The problem in steps whose error is small beside that of the fit."""
    n = len(problem.observations)
    allowed = np.clip(SHARE * 2 * best.cost / n, LEAST, MOST)
    return problem.resolved(best.values, float(allowed) * n / problem.n_samples)


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
        Of the least squares fit.
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
    rule : {"by amplitude", "second half", "first half"}
        How they were chosen: see `hold_out`.
    fit : Fit
    goodness_fitted, goodness_held_out : Goodness
    """

    fitted: str
    held_out: str
    rule: Rule
    fit: Fit
    goodness_fitted: Goodness
    goodness_held_out: Goodness


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """What a fit to recordings gave.

    Attributes
    ----------
    prepared : tuple of Prepared
        As the error E and the VAF see them.
    problem : Problem
        The model, the recordings in their whole band, and their noise.
    widths : Widths
    goodness : Goodness
        Of the least squares fit.
    with_noise : NoisyFit
        The model with the noise of the recordings, which the widths are those of.
    least_squares : Fit
        Smallest error E (Eq. 3), whatever the noise: where the model is right it differs from the
        likelihood's best by no more than noise explains.
    predictions : tuple of array
        Per trial the response by least squares, its offset included, at every sample.
    windows : tuple of WindowFit
    held_out : HeldOut or None
    warnings : tuple of str
    """

    prepared: tuple[Prepared, ...]
    problem: Problem
    widths: Widths
    goodness: Goodness
    with_noise: NoisyFit
    least_squares: Fit
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
    refined: bool = False,
    seed: int = 1,
    progress: Progress = silent,
) -> RecordingFit:
    """Fit a joint model to recorded trials, with every width, by window and held out.

    Two estimates stand side by side. Least squares has the smallest error E (Eq. 3), and E and VAF
    are its. The widths are those of the likelihood, in which the noise of both channels, its colour
    and its level are estimated with the model (`fit_noisy`), and the noise of an imposed angle no
    longer makes the inertia too small. Where the model is wrong its misfit is taken for noise, and
    these widths are the smallest that can be defended.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    model : Model, optional
        ``KBI()`` by default; any sum of effects.
    window_lengths : sequence of float
        Windows T [s] after each perturbation, to be fitted one by one.
    prior : Prior, optional
        Uniform within the physical bounds by default.
    lowpass_hz : float, "auto" or None
        See `prepare`; one for all trials.
    refined : bool
        Whether parameters that only refine an effect are free too; they are held at the values of
        its plain form otherwise.
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
    model = KBI() if model is None else model
    prior = Prior.recorded(model) if prior is None else prior
    prepared, whole_band = _ready(trials, lowpass_hz)
    selections_by_window = [[windows(p, length) for p in prepared] for length in window_lengths]
    guess = first_guess([p.trial for p in prepared], prior)
    starts_seed, *window_seeds = map(
        int, np.random.SeedSequence(seed).generate_state(1 + len(window_lengths))
    )
    pose = partial(recording_problem, model=model, prior=prior, refined=refined)
    known = _angle_noise(trials, whole_band)

    def study(
        chosen: Sequence[Selection], same: Sequence[Selection], sampler_seed: int, referee: bool
    ) -> tuple[Problem, Fit, NoisyFit, Widths]:
        rough, best = best_fit(pose(prepared, chosen), guess, starts_seed)
        noisy = _noisily(pose, whole_band, same, best, known)
        result = widths(
            noisy.problem,
            starts=noisy.fit.values[None],
            seed=sampler_seed,
            referee=referee,
            quick=bool(model.effects),
        )
        return rough, best, noisy, result

    total = 2 + len(window_lengths)
    progress("whole records: fit, profiles, posterior, quadrature", 1, total)
    selections = [whole(p) for p in prepared]
    rough, best, noisy, result = study(selections, [whole(p) for p in whole_band], seed, True)
    by_window: list[WindowFit] = []
    for length, chosen, child in zip(
        window_lengths, selections_by_window, window_seeds, strict=True
    ):
        progress(f"windows of {1000 * length:g} ms", 2 + len(by_window), total)
        same = [windows(p, length) for p in whole_band]
        windowed, least, _, within = study(chosen, same, child, False)
        n_windows = sum(s.stretches for s in chosen)
        by_window.append(WindowFit(length, n_windows, within, goodness(windowed, least, chosen)))
    progress("fit to one part, judged on the other", total, total)
    parts = hold_out(prepared)
    remarks = [] if parts.held_out else [f"held out: {parts.what_is_held_out}"]
    if not noisy.settled:
        remarks.append("model and noise still moved each other when their fit was stopped")
    if noisy.drowned:
        remarks.append(
            "the noise of the imposed angle is as large as its motion: the inertia is too small"
        )
    return RecordingFit(
        prepared,
        noisy.problem,
        result,
        goodness(rough, best, selections),
        noisy,
        best,
        _predictions(prepared, rough, best),
        tuple(by_window),
        _held_out(parts, pose, guess, starts_seed) if parts.held_out else None,
        tuple(remarks),
    )


def fit_with_noise(
    trials: Sequence[Trial],
    *,
    prior: Prior | None = None,
    lowpass_hz: Lowpass = "auto",
    seed: int = 1,
) -> NoisyFit:
    """Fit K, B and I together with the noise, without widths: the fit of `fit_recordings`.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    prior : Prior, optional
        Uniform within the physical bounds by default.
    lowpass_hz : float, "auto" or None
        See `prepare` and `prepare_whole_band`.
    seed : int
        Of the starts.
    """
    prior = Prior.recorded(KBI()) if prior is None else prior
    prepared, whole_band = _ready(trials, lowpass_hz)
    pose = partial(recording_problem, model=KBI(), prior=prior)
    guess = first_guess([p.trial for p in prepared], prior)
    _, best = best_fit(pose(prepared, [whole(p) for p in prepared]), guess, seed)
    known = _angle_noise(trials, whole_band)
    return _noisily(pose, whole_band, [whole(p) for p in whole_band], best, known)


def _ready(
    trials: Sequence[Trial], lowpass_hz: Lowpass
) -> tuple[tuple[Prepared, ...], tuple[Prepared, ...]]:
    """Trials ready for least squares, and for a likelihood that knows the noise."""
    prepared = joined(prepare(trials, lowpass_hz=lowpass_hz))
    if prepared[0].trial.driven == "torque":
        return prepared, prepared  # nothing of them is filtered
    return prepared, prepare_whole_band(trials, lowpass_hz=lowpass_hz)


def _angle_noise(trials: Sequence[Trial], whole_band: Sequence[Prepared]) -> list[float]:
    """White noise [rad] that an imposed angle shows by itself, as far as it is compared, by trial.

    It is told of all trials of one rate together.
    """
    if trials[0].driven == "torque":
        return [0.0] * len(trials)
    rates = [round(trial.sampling_rate, 6) for trial in trials]
    thinned = dict(zip(rates, (p.trial.sampling_rate for p in whole_band), strict=True))
    shown = {
        rate: known_noise([t for t, r in zip(trials, rates, strict=True) if r == rate], compared)
        for rate, compared in thinned.items()
    }
    return [shown[rate] for rate in rates]


def _noisily(
    pose: Callable[..., Problem],
    whole_band: Sequence[Prepared],
    selections: Sequence[Selection],
    best: Fit,
    known: Sequence[float],
) -> NoisyFit:
    plain = pose(whole_band, selections, noises=[Noise(1.0)] * len(whole_band))
    pieces = [selection.pieces for selection in selections]
    return fit_noisy(plain.resolved(best.values), pieces, best.values, known)


def _predictions(
    prepared: Sequence[Prepared], problem: Problem, best: Fit
) -> tuple[np.ndarray, ...]:
    """Fitted responses at every sample, at the level of the compared ones."""
    found = []
    for p, response in zip(prepared, problem.responses(best.values), strict=True):
        missed = (p.response - response)[p.first : p.last]
        found.append(response + (np.mean(missed) if p.has_offset else 0.0))
    return tuple(found)


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


def _held_out(parts: Parts, pose: Callable[..., Problem], guess: np.ndarray, seed: int) -> HeldOut:
    """Fit one part, judge on the other."""
    chosen, others = ([whole(p) for p in part] for part in (parts.fitted, parts.held_out))
    problem, best = best_fit(pose(parts.fitted, chosen), guess, seed)
    other = pose(parts.held_out, others, scheme=problem.integration)
    return HeldOut(
        parts.what_is_fitted,
        parts.what_is_held_out,
        parts.rule,
        best,
        goodness(problem, best, chosen),
        goodness(other, best, others),
    )
