"""A trial: one recording of the torque on a joint and of its angle."""

from __future__ import annotations

import dataclasses
import warnings
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from identifiability.errors import InputError

FloatArray = NDArray[np.float64]

MIN_SAMPLES = 3
UNIFORMITY = 1e-6
"""Largest relative departure of one time step from the sampling interval."""

_IN_MOTION = 0.02  # share of the fastest motion, from which on an end is not at rest


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording of the torque applied to a joint and of the joint's angle.

    The arrays are copied on construction and cannot be written to; every method that changes
    something returns a new trial with a note that says what was done.

    Parameters
    ----------
    time : (n,) array
        Time (s), uniformly sampled.
    torque : (n,) array
        Torque (Nm) that the environment applies to the joint, positive in the direction of
        positive angle: holding a passive spring at a positive angle takes a positive torque.
    angle : (n,) array
        Joint angle (rad).
    driven : {"torque", "angle"}
        Which of the two was imposed; the other is the response.
    name : str
        Name in tables and plots.
    condition : str
        Experimental condition; trials of one condition share it.
    source, sha256 : str
        Base name and SHA-256 of the file that was read, empty for a trial made in memory.
    notes : tuple of str
        What was done to the recording, in order.

    Raises
    ------
    InputError
        If the arrays cannot be a recording: not one-dimensional, of unequal length, fewer than
        three samples, not finite, time not increasing or not uniform, a constant channel.

    Warns
    -----
    UserWarning
        If the angle exceeds one turn, which looks like degrees.
    """

    time: FloatArray = field(repr=False)
    torque: FloatArray = field(repr=False)
    angle: FloatArray = field(repr=False)
    driven: Literal["torque", "angle"] = "torque"
    name: str = "trial"
    condition: str = ""
    source: str = ""
    sha256: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for column in ("time", "torque", "angle"):
            object.__setattr__(self, column, _frozen(getattr(self, column), column))
        object.__setattr__(self, "notes", tuple(self.notes))
        if self.driven not in ("torque", "angle"):
            raise InputError(
                f"driven is {self.driven!r}, but the imposed channel is either 'torque' or 'angle'"
            )
        lengths = {"time": self.time.size, "torque": self.torque.size, "angle": self.angle.size}
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{column} {length}" for column, length in lengths.items())
            raise InputError(f"the columns must be equally long, but their lengths are {found}")
        if self.time.size < MIN_SAMPLES:
            raise InputError(
                f"a trial needs at least {MIN_SAMPLES} samples, found {self.time.size}"
            )
        for column in lengths:
            _check_finite(getattr(self, column), column)
        _check_time(self.time)
        for column in ("torque", "angle"):
            values = getattr(self, column)
            if values.min() == values.max():
                raise InputError(
                    f"{column} is constant ({values[0]:g}) over all {values.size} samples, so "
                    "there is nothing to fit: give a recording, or a part of it, in which it moves"
                )
        largest = float(np.abs(self.angle).max())
        if largest > 2.0 * np.pi:
            warnings.warn(
                f"the angle of trial {self.name!r} reaches {largest:.4g} rad, more than one turn: "
                "looks like degrees?",
                UserWarning,
                stacklevel=3,
            )

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def duration(self) -> float:
        """Time (s) from the first to the last sample."""
        return float(self.time[-1] - self.time[0])

    @property
    def dt(self) -> float:
        """Sampling interval (s)."""
        return self.duration / (self.n_samples - 1)

    @property
    def sampling_rate(self) -> float:
        """Samples a second (Hz)."""
        return 1.0 / self.dt

    def between(self, start: float, stop: float) -> Trial:
        """Return the part from `start` to `stop` (s), both included, on the same time axis.

        Raises
        ------
        InputError
            If the part is empty, lies outside the record or has fewer than three samples.
        """
        first, last = float(self.time[0]), float(self.time[-1])
        slack = 1e-6 * self.dt
        if not start < stop:
            raise InputError(
                f"the part from {start:g} s to {stop:g} s is empty: start must be below stop"
            )
        if start < first - slack or stop > last + slack:
            raise InputError(
                f"the part from {start:g} s to {stop:g} s lies outside the record, "
                f"which runs from {first:g} s to {last:g} s"
            )
        low = int(np.searchsorted(self.time, start - slack))
        high = int(np.searchsorted(self.time, stop + slack))
        if high - low < MIN_SAMPLES:
            raise InputError(
                f"the part from {start:g} s to {stop:g} s holds {high - low} samples, where at "
                f"least {MIN_SAMPLES} are needed (the sampling interval is {self.dt:g} s)"
            )
        return self._part(low, high, f"cut to {start:g}-{stop:g} s")

    def part(self, first: int, last: int, *, name: str, why: str) -> Trial:
        """Return the samples from `first` until before `last`, on the same time axis.

        Parameters
        ----------
        first, last : int
        name : str
            Of the part.
        why : str
            For its notes, such as "cut at its perturbations".

        Raises
        ------
        InputError
            If the part has fewer than three samples, or a constant channel.
        """
        start, stop = self.time[first], self.time[last - 1]
        cut = self._part(first, last, f"{why}: {start:g}-{stop:g} s")
        return dataclasses.replace(cut, name=name)

    def halves(self) -> tuple[Trial, Trial]:
        """Return the first and the second half, as two trials.

        Raises
        ------
        InputError
            If a half has fewer than three samples, or a constant channel.
        """
        middle = self.n_samples // 2
        return (
            self._part(0, middle, "first half"),
            self._part(middle, self.n_samples, "second half"),
        )

    def lowpass(self, cutoff_hz: float, order: int = 4) -> Trial:
        """Return both channels low-pass filtered alike, without phase shift.

        A Butterworth filter runs forward and backward (`scipy.signal.sosfiltfilt`), so the gain at
        the cut-off is 1/2 and the order doubles.

        Parameters
        ----------
        cutoff_hz : float
            Cut-off frequency (Hz), below the Nyquist frequency and at least a millionth of it.
        order : int
            Order of the filter for one direction.

        Raises
        ------
        InputError
            If the cut-off or the order is out of range.
        """
        nyquist = 0.5 * self.sampling_rate
        lowest = 1e-6 * nyquist  # below, the filter's poles round to 1
        if not lowest <= cutoff_hz < nyquist:
            raise InputError(
                f"the cut-off of {cutoff_hz:g} Hz must lie between {lowest:g} Hz and the Nyquist "
                f"frequency, {nyquist:g} Hz at a sampling rate of {self.sampling_rate:g} Hz"
            )
        if order < 1:
            raise InputError(f"the order of the filter is {order}, but must be at least 1")
        sos = signal.butter(order, cutoff_hz, fs=self.sampling_rate, output="sos")
        padding = min(3 * (2 * len(sos) + 1), self.n_samples - 1)
        torque, angle = signal.sosfiltfilt(
            sos, np.stack([self.torque, self.angle]), axis=-1, padlen=padding
        )
        note = f"low-pass filtered at {cutoff_hz:g} Hz (zero-phase Butterworth, order {order})"
        return self._changed(note, torque=torque, angle=angle)

    def decimate(self, factor: int) -> Trial:
        """Return every `factor`-th sample; content above the new Nyquist frequency folds back.

        Low-pass filter first (`lowpass`).

        Raises
        ------
        InputError
            If the factor is not a whole number of at least 1, or leaves fewer than three samples.
        """
        if factor != int(factor) or factor < 1:
            raise InputError(
                f"the factor of decimation is {factor}, but must be a whole number of at least 1"
            )
        every = slice(None, None, int(factor))
        return self._changed(
            f"one sample in {int(factor)} kept",
            time=self.time[every],
            torque=self.torque[every],
            angle=self.angle[every],
        )

    def thinned(self, factor: int) -> Trial:
        """Return every `factor`-th sample, freed of what would fold back.

        A symmetric filter that leaves lower frequencies as they are, of ten kept samples to either
        side. Beyond an end at rest the recording is taken to stay as it is there; beyond one in
        motion, to go on as it came (`extended`).

        Raises
        ------
        InputError
            If the factor is not a whole number of at least 1, or leaves fewer than three samples.
        """
        time = self.decimate(factor).time
        torque, angle = (thinned(v, int(factor), self.angle) for v in (self.torque, self.angle))
        note = f"one sample in {int(factor)} kept, behind a filter against aliasing"
        return self._changed(note, time=time, torque=torque, angle=angle)

    def centred(self, how: Literal["mean", "baseline", "none"]) -> Trial:
        """Return the trial as deviations from its operating point.

        Parameters
        ----------
        how : {"mean", "baseline", "none"}
            The operating point: the mean of each channel, its mean over the quiet samples before
            the perturbation (`quiet_lead`), or none (the trial itself is returned).

        Raises
        ------
        InputError
            If `how` is something else, or ``"baseline"`` finds no quiet lead.
        """
        if how == "none":
            return self
        if how == "mean":
            n_used, over = self.n_samples, "mean"
        elif how == "baseline":
            n_used = quiet_lead(self)
            if n_used < MIN_SAMPLES:
                raise InputError(
                    f"the perturbation begins at sample {n_used}, so there is no quiet lead to "
                    "take the operating point from: centre on 'mean', or on 'none'"
                )
            over = f"mean of the {n_used} quiet samples before the perturbation"
        else:
            raise InputError(f"centring is {how!r}, but must be 'mean', 'baseline' or 'none'")
        return self.less(
            float(self.torque[:n_used].mean()), float(self.angle[:n_used].mean()), over
        )

    def less(self, torque: float, angle: float, what: str) -> Trial:
        """Return the trial less an operating point.

        Parameters
        ----------
        torque, angle : float
            Levels (Nm, rad) to take off.
        what : str
            What they are, for the notes: such as "mean".
        """
        return self._changed(
            f"operating point removed ({what}): {torque:.6g} Nm, {angle:.6g} rad",
            torque=self.torque - torque,
            angle=self.angle - angle,
        )

    def _part(self, low: int, high: int, note: str) -> Trial:
        return self._changed(
            note,
            time=self.time[low:high],
            torque=self.torque[low:high],
            angle=self.angle[low:high],
        )

    def _changed(self, note: str, **columns: FloatArray) -> Trial:
        # dataclasses.replace types its keywords loosely, which is what is wanted here.
        changes: dict[str, object] = {**columns, "notes": (*self.notes, note)}
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


def thinned(values: FloatArray, factor: int, angle: FloatArray) -> FloatArray:
    """Every `factor`-th value, freed of what would fold back, as in `Trial.thinned`.

    Parameters
    ----------
    values : array, shape (n,)
    factor : int
        At least 1.
    angle : array, shape (n,)
        That moves or rests at the ends [rad].
    """
    if factor == 1:
        return values
    taps = signal.firwin(20 * factor + 1, 1 / factor)
    around = extended(values, taps.size // 2, angle)
    return np.asarray(signal.fftconvolve(around, taps, mode="valid")[::factor])


def extended(
    values: FloatArray, n: int, angle: FloatArray, *, within: int | None = None
) -> FloatArray:
    """Values with so many more beyond each end, for a filter that reaches there.

    At rest they stay as they are at the end: turned about it, they would be as far off as twice its
    noise. In motion they are turned about it: if they stopped there, what is seen of the torque of
    inertia would be a blow.

    Parameters
    ----------
    values : array, shape (m,)
    n : int
    angle : array, shape (m,)
        That moves or rests [rad].
    within : int, optional
        Samples from each end within which it is asked whether it moves; `n` by default.

    Returns
    -------
    array, shape (m + 2 n,)
    """
    ends = np.pad(values, n, mode="edge")
    turned = np.pad(values, n, mode="reflect", reflect_type="odd")
    begins, stops = ends_in_motion(angle, n if within is None else within)
    if begins:
        ends[:n] = turned[:n]
    if stops:
        ends[-n:] = turned[-n:]
    return ends


def ends_in_motion(angle: FloatArray, n: int) -> tuple[bool, bool]:
    """Whether an angle [rad], shape (m,), moves within so many samples of its beginning and end."""
    near = min(n, angle.size - 1)
    moved = np.abs(angle[near:] - angle[: angle.size - near])
    least = _IN_MOTION * moved.max()
    return bool(moved[0] > least), bool(moved[-1] > least)


def onsets(trial: Trial, *, separation: float = 0.1, hold: float = 0.02) -> NDArray[np.intp]:
    """Find where the imposed channel starts to move after it was held still.

    Movement is seen as a difference between the mean levels right after and right before a moment,
    over a quarter of `hold` each: more than a twentieth of the largest difference, and more than
    six times its noise, which is the median absolute difference over the still parts, scaled to a
    standard deviation. From the first such moment after a hold, the start is the last sample
    within the scatter of that hold.

    Parameters
    ----------
    trial : Trial
        The recording.
    separation : float
        Movements that start less than this (s) after the last onset belong to it.
    hold : float
        Stillness (s) that has to precede an onset.

    Returns
    -------
    (m,) array of int
        Index of the last still sample before each movement, at least one. The first is 0 where the
        recording begins in the middle of a movement (in a torque-driven trial also where the joint
        itself moves from the start), or where stillness cannot be told from movement.
    """
    imposed = trial.torque if trial.driven == "torque" else trial.angle
    n_hold = min(max(2, round(hold / trial.dt)), trial.n_samples - 1)
    n_level = max(1, n_hold // 4)
    contrast = _contrast(imposed, n_level)
    threshold = max(0.05 * float(contrast.max()), 6.0 * _still_contrast(contrast, n_hold))
    if threshold > 0.5 * contrast.max():
        return np.zeros(1, dtype=np.intp)

    moving = np.flatnonzero(contrast > threshold)
    n_still = np.diff(moving, prepend=-1) - 1
    found = [
        _start(imposed[at + 1 - n_hold : at + 1 + n_level], n_hold) + at + 1 - n_hold
        for at in moving[n_still >= n_hold].tolist()
    ]
    if n_still[0] < n_hold or not _starts_at_rest(trial, found[0]):
        found.insert(0, 0)

    kept = found[:1]
    for index in found[1:]:
        if (index - kept[-1]) * trial.dt >= separation:
            kept.append(index)
    return np.array(kept, dtype=np.intp)


def quiet_lead(trial: Trial) -> int:
    """Return the number of samples before the first onset, 0 where there is no quiet lead."""
    return int(onsets(trial)[0])


def _contrast(values: FloatArray, n_level: int) -> FloatArray:
    """Difference of the mean levels after and before each interval between two samples."""
    total = np.cumsum(np.pad(values - values[0], n_level, mode="edge"))
    levels = (total[n_level:] - total[:-n_level]) / n_level
    return np.abs(levels[n_level:] - levels[:-n_level])[: values.size - 1]


def _still_contrast(contrast: FloatArray, n_hold: int) -> float:
    """Median contrast, scaled to a standard deviation, while the channel is held still."""
    n_blocks = contrast.size // n_hold
    stillest = np.median(contrast[: n_blocks * n_hold].reshape(n_blocks, n_hold), axis=1).min()
    # The stillest of many blocks is stiller than usual: it only selects the still intervals.
    return 1.4826 * float(np.median(contrast[contrast <= 10.0 * stillest]))


def _start(values: FloatArray, n_hold: int) -> int:
    """Return the last sample within the scatter of the first `n_hold`, which precede a movement."""
    departure = np.abs(values - np.median(values[:n_hold]))
    scatter = 1.4826 * np.median(departure[:n_hold])
    moved = n_hold + int(departure[n_hold:].argmax())
    return int(np.flatnonzero(departure[:moved] <= 4.0 * scatter)[-1])


def _starts_at_rest(trial: Trial, onset: int) -> bool:
    """Tell a quiet lead from a torque that is held constant while the joint already moves."""
    if trial.driven == "angle":
        return True
    lead = trial.angle[: onset + 1]
    quarter = max(1, lead.size // 4)
    drift = abs(float(lead[-quarter:].mean() - lead[:quarter].mean()))
    return drift < 0.1 * float(np.ptp(trial.angle))


def _frozen(values: ArrayLike, column: str) -> FloatArray:
    try:
        raw = np.asarray(values)
        if np.iscomplexobj(raw):
            raise TypeError
        array = np.array(raw, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{column} must be a sequence of real numbers") from None
    if array.ndim != 1:
        raise InputError(f"{column} must be one-dimensional, but its shape is {array.shape}")
    array.flags.writeable = False
    return array


def _check_finite(values: FloatArray, column: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"{column} holds {bad.size} values that are not finite, the first ({values[bad[0]]}) "
            f"at sample {bad[0]}: remove or fill them"
        )


def _check_time(time: FloatArray) -> None:
    with np.errstate(over="ignore", invalid="ignore"):  # a step that overflows is uneven
        steps = np.diff(time)
        typical = float(np.median(steps))
        even = np.abs(steps - typical) <= UNIFORMITY * typical
    backward = np.flatnonzero(steps <= 0.0)
    if backward.size:
        at = int(backward[0]) + 1
        raise InputError(
            f"time must increase, but sample {at} ({time[at]:.9g} s) does not come after "
            f"sample {at - 1} ({time[at - 1]:.9g} s)"
        )
    uneven = np.flatnonzero(~even)
    if uneven.size:
        at = int(uneven[0])
        raise InputError(
            f"time must be sampled uniformly, but the step after sample {at} is {steps[at]:.9g} s "
            f"where {typical:.9g} s is usual: resample the recording"
        )
