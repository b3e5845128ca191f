"""The perturbation that would tell apart what these data cannot.

For two rivals i and j and a perturbation, the evidence to expect is how far the best j stays from
what i predicts, in units of the noise: T = min over theta_j of |y_i - y_j|^2 / sigma^2, expected
twice the difference of the log likelihoods (the T criterion of Atkinson & Fedorov 1975, Biometrika
62: 57-70). It is computed both ways round; the smaller counts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import explore
from identifiability.inference.problem import Problem, observe
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate
from identifiability.investigation.ladder.found import Found
from identifiability.investigation.split import Split
from identifiability.investigation.verdict.judge import Verdict
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import (
    Drive,
    SampledTorque,
    imposed_motion,
    multisine,
    prbs,
)
from identifiability.numerals import number

_EVALUATIONS = 30
_SIZES = 10  # of a perturbation that are tried until the response keeps within the limits
_LEAD = 0.05  # [s] of rest before the perturbation
_MOST_REPETITIONS = 200  # more than anyone does


@dataclass(frozen=True)
class Limits:
    """What an experiment may do.

    Attributes
    ----------
    torque : float
        Largest torque [Nm], imposed or met.
    angle : float
        Largest excursion [rad], imposed or met.
    duration : float
        Of the record [s].
    """

    torque: float
    angle: float
    duration: float


@dataclass(frozen=True)
class Design:
    """One perturbation and the evidence it would give.

    Attributes
    ----------
    perturbation : str
        In words, with its parameters.
    amplitude : float
        Largest torque [Nm] or angle [rad] imposed.
    peak_angle, peak_torque : float
        Largest angle [rad] and torque [Nm] to expect of either model.
    expected_evidence : float
        T, for one trial.
    """

    perturbation: str
    amplitude: float
    peak_angle: float
    peak_torque: float
    expected_evidence: float


@dataclass(frozen=True)
class NextExperiment:
    """Perturbation that would best separate two effects.

    Attributes
    ----------
    pair : tuple of str
    best : Design
    others : tuple of Design
        What else was tried, best first.
    limits : Limits
    needed : float
        Expected evidence at which a pair counts as resolved.
    """

    pair: tuple[str, str]
    best: Design
    others: tuple[Design, ...]
    limits: Limits
    needed: float

    @property
    def resolved(self) -> bool:
        """Whether one trial would do."""
        return self.best.expected_evidence >= self.needed

    @property
    def repetitions(self) -> int:
        """Number of trials that would do."""
        return int(np.ceil(self.needed / max(self.best.expected_evidence, 1e-3)))

    @property
    def proposed(self) -> bool:
        """Whether so few trials would do that anyone may be advised to make them."""
        return self.repetitions <= _MOST_REPETITIONS

    def to_dict(self) -> dict[str, Any]:
        """Plain record, for JSON."""
        return asdict(self)


def usual_limits(split: Split) -> Limits:
    """Limits that the recorded trials kept: their largest torque, angle and duration."""
    trials = [r.trial for r in (*split.fitted, *split.held_out)]
    return Limits(
        max(float(np.abs(t.torque).max()) for t in trials),
        max(float(np.abs(t.angle).max()) for t in trials),
        max(t.duration for t in trials),
    )


def next_experiment(
    bench: Workbench,
    final: Candidate,
    rival: Candidate,
    pair: tuple[str, str],
    *,
    limits: Limits | None = None,
    seed: int = 1,
) -> NextExperiment:
    """Search the perturbations within limits for the one that best separates two models.

    Parameters
    ----------
    bench : Workbench
    final, rival : Candidate
        The two models, fitted.
    pair : tuple of str
        The effects in which they differ.
    limits : Limits, optional
        Those that the recorded trials kept by default.
    seed : int
        Of random waveforms.

    Raises
    ------
    InputError
        Where no perturbation within the limits has a finite response.
    """
    split = bench.split
    limits = usual_limits(split) if limits is None else limits
    trial = split.fitted[0]
    interval = trial.drive.interval
    n = min(int(limits.duration / interval) + 1, split.longest)
    time = interval * np.arange(n)
    noise = _noise(split, final)
    tried = []
    for words, signal in _waveforms(time, seed):
        try:
            tried.append(_assess(bench, final, rival, words, signal, time, noise, limits))
        except (InputError, ValueError, np.linalg.LinAlgError):
            continue
    if not tried:
        raise InputError("no perturbation within the limits has a finite response")
    tried.sort(key=lambda d: -d.expected_evidence)
    return NextExperiment(pair, tried[0], tuple(tried[1:]), limits, bench.rules.resolved)


def open_pair(found: Found, verdict: Verdict) -> tuple[Candidate, tuple[str, str]] | None:
    """The rival model that most deserves to be told from the final one, and what they differ in.

    Parameters
    ----------
    found : Found
    verdict : Verdict

    Returns
    -------
    (Candidate, (str, str)) or None
        ``None`` where no pair is open that an experiment could tell apart.
    """
    if not verdict.sets:
        return None
    for missing in found.missing:
        for rival in missing.equals:
            if rival.key not in missing.effect.equivalent:
                return rival.candidate, (missing.key, rival.key)
    return None


def _noise(split: Split, final: Candidate) -> float:
    if split.has_noise:
        return float(np.median([r.lead.sd for r in split.fitted]))
    return float(np.median([np.std(r) for r in final.fitted.by_trial]))


def _waveforms(time: np.ndarray, seed: int) -> list[tuple[str, np.ndarray]]:
    """Unit perturbations that begin after a short rest."""
    start = int(np.searchsorted(time, _LEAD - 1e-9))
    moved = time[start:] - time[start]

    def placed(values: np.ndarray) -> np.ndarray:
        signal = np.zeros(time.size)
        signal[start:] = values
        return signal

    def pulse(width: float) -> np.ndarray:
        return placed(((moved > 0) & (moved <= width)).astype(float))

    # What is shorter than the sampling interval would not be there.
    interval = float(time[1] - time[0])
    widths = [w for w in (0.005, 0.02, 0.05, 0.15) if w >= interval]
    out = [(f"a pulse of {1000 * w:g} ms", pulse(w)) for w in widths]
    out.append(("a step", placed((moved > 0).astype(float))))
    if 0.02 in widths:
        double = pulse(0.02) - np.roll(pulse(0.02), round(0.06 / interval))
        out.append(("two opposite pulses of 20 ms, 60 ms apart", double))
    for f in (2.0, 6.0, 15.0):
        out.append((f"a sinusoid of {f:g} Hz", placed(np.sin(2 * np.pi * f * moved))))
    if moved[-1] > 0.4:
        tones = np.arange(1.0, 21.0)
        wave = multisine(moved, amplitude=1.0, frequencies=tones, seed=seed).values
        out.append(("a multisine from 1 to 20 Hz", placed(wave / np.abs(wave).max())))
        dwell = max(1, round(0.03 / interval)) * interval
        binary = prbs(moved, amplitude=1.0, dwell=dwell, seed=seed).values
        out.append(("a pseudo-random binary sequence switching every 30 ms", placed(binary)))
    return out


def _assess(
    bench: Workbench,
    final: Candidate,
    rival: Candidate,
    words: str,
    signal: np.ndarray,
    time: np.ndarray,
    noise: float,
    limits: Limits,
) -> Design:
    angle_driven = bench.split.driven == "angle"
    amplitude, most = limits.torque, limits.angle
    if angle_driven:
        amplitude, most = most, amplitude
    for _ in range(_SIZES):
        drive = _drive(signal * amplitude, time, angle_driven)
        responses = [_simulated(candidate, drive) for candidate in (final, rival)]
        reached = max(float(np.abs(response).max()) for response in responses)
        if not reached > most:
            break
        amplitude *= 0.95 * most / reached
    else:
        raise InputError("no size of the perturbation was found that keeps within the limits")
    evidence = min(
        _distance(bench, rival, drive, responses[0], noise),
        _distance(bench, final, drive, responses[1], noise),
    )
    angle, torque = (amplitude, reached) if angle_driven else (reached, amplitude)
    turned, pushed = f"{number(angle, 2)} rad", f"{number(torque, 2)} Nm"
    what = (
        f"{words} with an angle of {turned} (and a torque up to {pushed})"
        if angle_driven
        else f"{words} with a torque of {pushed} (and an angle up to {turned})"
    )
    return Design(what, float(amplitude), float(angle), float(torque), float(evidence))


def _drive(signal: np.ndarray, time: np.ndarray, angle_driven: bool) -> Drive:
    if not angle_driven:
        return SampledTorque(signal).drive(time)
    # A servo cannot jump: the motion is smoothed over 20 ms.
    width = max(3, round(0.02 / (time[1] - time[0])))
    window = np.hanning(width + 2)[1:-1]
    smooth = np.convolve(signal, window / window.sum(), mode="full")[: signal.size]
    return imposed_motion(time, smooth)


def _simulated(candidate: Candidate, drive: Drive) -> np.ndarray:
    return simulate(candidate.model, candidate.model.vector(candidate.values), drive)


def _distance(
    bench: Workbench, candidate: Candidate, drive: Drive, response: np.ndarray, noise: float
) -> float:
    """Evidence that remains against a model refitted to another one's response."""
    if not np.all(np.isfinite(response)):
        raise InputError("the response is not finite")
    template = bench.problem(
        candidate.model, bench.split.fitted, refined=candidate.refined, scheme=candidate.scheme
    )
    problem = Problem(
        template.model,
        [observe(drive, response, Noise(noise))],
        template.prior,
        fixed=template.fixed,
        scheme=template.scheme,
    )
    start = problem.free_vector(candidate.values)
    return 2 * explore(problem, start[None], evaluations=_EVALUATIONS).cost
