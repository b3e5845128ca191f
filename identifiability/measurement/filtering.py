"""The low-pass filter of recordings whose angle was imposed.

The torque is predicted from the imposed angle's second derivative, which multiplies noise by the
square of its frequency. Noise in what is taken for known makes the inertia too small, however long
the record (attenuation: Fuller 1987, Measurement Error Models, section 1.1), and bends whatever
trades with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy import signal

from identifiability.errors import InputError
from identifiability.measurement.trials import Trial

Lowpass = float | Literal["auto"] | None
"""Cut-off frequency [Hz]; "auto" as `noise_cutoff` finds it; ``None`` for no filter."""
HIGHEST_HZ = 50.0
"""Cut-off where the angle shows no noise: perturbations of joints hardly move them faster."""
_OF_NYQUIST = 0.8  # a filter needs room below half the sampling rate
_BAND = 2 ** (1 / 3)  # a third of an octave
_SEGMENT_S = 1.0  # of the averaged spectra, which then reach down to a few Hz
# White noise is flat from the lower to the upper part of the highest octave; an angle that inertia
# moves falls with the square of the frequency at least, its density with the fourth power. Half
# way, in logarithms: few short trials scatter by a quarter.
_LOW, _MIDDLE, _HIGH = 0.5, 0.75, 0.95
_FLAT = ((_MIDDLE + _HIGH) / (_LOW + _MIDDLE)) ** 2
_SAMPLES_PER_CYCLE = 5.0
# Cycles of the cut-off over which the filter reaches: its slowest pole fades by exp(-2.4) in each.
_REACH, _LARGEST_SHARE, _SMALL_SHARE = 2.0, 0.25, 0.05
_SAME, _OFF_STEP = 1e-9, 0.05  # of the largest jump; of a step: what text of few digits rounds
_AT_REST = 0.1  # share of the fastest motion that is none


def cutoff(trials: Sequence[Trial], lowpass_hz: Lowpass) -> float | None:
    """Return the cut-off frequency [Hz] that a setting stands for, one for all trials.

    Where the torque was imposed the angle is simulated, and nothing is filtered.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    lowpass_hz : float, "auto" or None

    Raises
    ------
    InputError
        If the frequency is not below half the sampling rate.
    """
    if lowpass_hz is None or trials[0].driven == "torque":
        return None
    if lowpass_hz == "auto":
        return noise_cutoff(trials)
    rate = min(trial.sampling_rate for trial in trials)
    if lowpass_hz >= 0.5 * rate:
        raise InputError(
            f"found a low-pass of {lowpass_hz:g} Hz, expected less than half the sampling rate "
            f"of {rate:g} Hz; choose a lower --lowpass or 'none'"
        )
    return float(lowpass_hz)


def noise_cutoff(trials: Sequence[Trial], ratio: float = 1.0) -> float:
    """Return the frequency [Hz] above which the imposed angle is noise more than motion.

    The noise is what the angle's spectrum levels off to below half the sampling rate, be it the
    sensor's or the rounding of a coarse recorder; the motion ends where the spectrum, in bands of a
    third of an octave, comes down to so many times that level above it. Where the spectrum still
    falls there, or the motion goes on, the cut-off is the usual one (`HIGHEST_HZ`).

    Parameters
    ----------
    trials : sequence of Trial
        Their spectra are added up.
    ratio : float
        Of motion to noise at the cut-off.
    """
    nyquist = 0.5 * min(trial.sampling_rate for trial in trials)
    highest = min(HIGHEST_HZ, _OF_NYQUIST * nyquist)
    spectra = [_spectrum(trial) for trial in trials]
    noise, edge = _floor(spectra, nyquist), highest
    if noise is None:
        return highest
    while (found := _power(spectra, edge / _BAND, edge)) < (1 + ratio) * noise:
        edge /= _BAND
    # A band without a line of the spectrum: none held motion, so there is nothing to go by.
    return edge if np.isfinite(found) else highest


def known_noise(trials: Sequence[Trial], rate: float = np.inf) -> float:
    """Return the standard deviation [rad] of the white noise that the angles show by themselves.

    Of rounding to steps, or of what their spectrum levels off to, whichever is more; 0 where
    neither shows.

    Parameters
    ----------
    trials : sequence of Trial
        As they were recorded, at the first's rate.
    rate : float
        To which they are thinned [Hz], which leaves so much of white noise; not by default.
    """
    nyquist = 0.5 * min(trial.sampling_rate for trial in trials)
    floor = _floor([_spectrum(trial) for trial in trials], nyquist)
    level = 0.0 if floor is None else float(np.sqrt(floor * nyquist / len(trials)))
    steps = [rounding_step(trial.angle) for trial in trials]
    noise = max(level, float(np.sqrt(np.mean(np.square(steps)) / 12)))
    return noise * float(np.sqrt(min(1.0, rate / trials[0].sampling_rate)))


def rounding_step(values: np.ndarray) -> float:
    """Return the step of which all differences are multiples; 0 where there is none."""
    jumps = np.abs(np.diff(values))
    if not jumps.any():
        return 0.0
    step = float(jumps[jumps > _SAME * jumps.max()].min())
    multiples = (values - values[0]) / step
    off = np.abs(multiples - np.round(multiples))
    return step if off.max() < _OFF_STEP else 0.0


def _power(spectra: Sequence[tuple[np.ndarray, np.ndarray]], low: float, high: float) -> float:
    """Mean density of the angle between two frequencies, summed over the trials."""
    found = [p[(f >= low) & (f < high)] for f, p in spectra]
    return float(sum(p.mean() if p.size else np.nan for p in found))


def _floor(spectra: Sequence[tuple[np.ndarray, np.ndarray]], nyquist: float) -> float | None:
    """Density that the angle levels off to, summed over the trials; None where it still falls."""
    lower = _power(spectra, _LOW * nyquist, _MIDDLE * nyquist)
    upper = _power(spectra, _MIDDLE * nyquist, _HIGH * nyquist)
    return 0.5 * (lower + upper) if upper / _FLAT < lower < upper * _FLAT else None


def _spectrum(trial: Trial) -> tuple[np.ndarray, np.ndarray]:
    length = min(trial.n_samples, round(_SEGMENT_S * trial.sampling_rate))
    return signal.welch(trial.angle, trial.sampling_rate, nperseg=length, detrend="linear")


def stride(trial: Trial, cutoff_hz: float) -> int:
    """Return how many samples to go on: those between tell nothing new below a cut-off [Hz]."""
    return max(1, int(trial.sampling_rate / (_SAMPLES_PER_CYCLE * cutoff_hz)))


def reach(trial: Trial, cutoff_hz: float) -> int:
    """Return how many samples away a filter of this cut-off [Hz] still spreads a motion."""
    return round(_REACH * trial.sampling_rate / cutoff_hz)


def settled(trial: Trial, cutoff_hz: float) -> tuple[int, int]:
    """Return first and last sample (excluded) that the filter made from recorded samples alone.

    Beyond the ends of a record the filter has to guess, and guesses angle and torque each by
    itself: there they do not belong together. A record that begins at rest is guessed rightly. A
    short one most likely does; its beginning is left in, for the perturbation may be there.

    Parameters
    ----------
    trial : Trial
        As it was recorded.
    cutoff_hz : float
        Cut-off frequency [Hz].
    """
    n = trial.n_samples
    edge = min(reach(trial, cutoff_hz), int(_LARGEST_SHARE * n))
    long = edge < _SMALL_SHARE * n
    return edge if long and not begins_at_rest(trial, max(1, edge // 4)) else 0, n - edge


def begins_at_rest(trial: Trial, n: int) -> bool:
    """Whether the angle hardly moves over the first so many samples, which noise barely changes."""
    moved = np.abs(trial.angle[n:] - trial.angle[:-n])
    return bool(moved[0] < _AT_REST * moved.max())
