"""Trials made ready for the comparison of models: the same for every command, whatever the model.

Where the torque was imposed the angle is simulated and nothing is filtered. Where the angle was
imposed the torque is predicted from its second derivative, which amplifies noise: both channels
then pass the same zero-phase low-pass filter, so that a linear model keeps its parameters, and the
samples that tell nothing new behind it are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from identifiability.errors import InputError
from identifiability.files import plain
from identifiability.measurement.filtering import (
    HIGHEST_HZ,
    Lowpass,
    begins_at_rest,
    cutoff,
    reach,
    settled,
    stride,
)
from identifiability.measurement.noise import correlation_time
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial, onsets

LEAD_SAMPLES = 20
"""Quiet samples from which a level and a noise are read; fewer say too little about either."""
_RESTS = 3  # quiet samples from which the posture is read that a movement starts from
_ALIKE = 0.05  # share of the motion by which angles at rest may differ that count as one
_LEVEL = 4.0  # standard errors that the lead's own scatter does not explain
# Samples at an end that filter and interpolation make up, and those where it rests and the filter
# makes up what was there.
_EDGE, _EDGE_AT_REST = 10, 5
_LARGEST_SHARE = 0.9  # of the scatter that a lead's mean may have taken with it


@dataclass(frozen=True)
class Lead:
    """Noise of a response, read from the quiet samples before the perturbation.

    Attributes
    ----------
    n_samples : int
        0 where there is no usable lead.
    sd : float
        Standard deviation of the noise [rad or Nm]; 0 where there is no usable lead.
    correlation_time : float
        Integrated autocorrelation time [samples], pooled over the trials.
    """

    n_samples: int
    sd: float
    correlation_time: float


NO_LEAD = Lead(0, 0.0, 1.0)


@dataclass(frozen=True)
class Treatment:
    """What was done to a trial before models were compared with it.

    Attributes
    ----------
    level_of : {"lead", "record", "nothing"}
        Samples whose mean was taken for the operating point: the quiet ones before the
        perturbation, all of them (of an imposed angle those of all trials), or none. Of a lead, a
        level that its own scatter explains is left alone: taking it off would add its error to
        every sample. Where the angle is imposed that of the torque is of the record in any case.
    torque, angle : float
        The levels [Nm, rad] that were taken off.
    lowpass_hz : float or None
        Cut-off [Hz] of the filter that both channels passed.
    decimation : int
        One sample in so many was kept.
    torque_between : {"straight", "smooth"}
        How an imposed torque is taken to run between its samples: see `SampledTorque`.
    """

    level_of: Literal["lead", "record", "nothing"]
    torque: float = 0.0
    angle: float = 0.0
    lowpass_hz: float | None = None
    decimation: int = 1
    torque_between: Literal["straight", "smooth"] = "straight"


@dataclass(frozen=True, eq=False)
class Prepared:
    """A trial ready to be compared with models.

    Attributes
    ----------
    trial : Trial
        Filtered, decimated and freed of its operating point; its notes say so in words.
    drive : Drive
        What was imposed, n samples.
    response : array, shape (n,)
        What was measured: angle [rad] or torque [Nm].
    first, last : int
        Samples that are compared (the last excluded): those that the ends of the filter do not
        touch, or one part of a long record.
    recorded_lead : Lead
        Noise of the response as the quiet samples before the perturbation show it.
    lead_is_noise : bool
        Whether what the lead shows is all the noise there is: not where the angle is imposed,
        whose own noise the prediction amplifies in motion, nor where the joint moves in the lead.
    has_offset : bool
        Whether the response's level at rest is unknown, and fitted.
    onsets : array of int
        Samples at which the imposed signal starts to move.
    treatment : Treatment
        What was done to the recording, as data.
    warm_up : float
        Time [s] before a part of it from which on it is computed, until it forgets where it was.
    """

    trial: Trial
    drive: Drive
    response: np.ndarray
    first: int
    last: int
    recorded_lead: Lead
    lead_is_noise: bool
    has_offset: bool
    onsets: np.ndarray
    treatment: Treatment
    warm_up: float = 1.0

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def interval(self) -> float:
        """Sampling interval [s]."""
        return self.drive.interval

    @property
    def lead(self) -> Lead:
        """The lead, where models are judged by its noise; `NO_LEAD` where they are not."""
        return self.recorded_lead if self.lead_is_noise else NO_LEAD

    @cached_property
    def compared(self) -> np.ndarray:
        """Measured response at the compared samples, without its mean where it has an offset."""
        values = self.response[self.first : self.last]
        return values - values.mean() if self.has_offset else values

    @property
    def energy(self) -> float:
        """Sum of the squared response (rad² or Nm²) over the compared samples."""
        return float(np.sum(self.compared**2))

    @property
    def mean_square(self) -> float:
        """Mean of the squared response over the compared samples."""
        return self.energy / self.compared.size

    def part(self, first: int, last: int) -> Prepared:
        """Return the same trial, compared from one sample to another (excluded)."""
        return replace(self, first=first, last=last)

    def without_lead(self) -> Prepared:
        """Return the same trial with unknown noise and an unknown level of the response."""
        return replace(self, lead_is_noise=False, has_offset=True)

    def smooth(self) -> Prepared:
        """Return the same trial with its imposed torque a smooth curve through the samples."""
        drive = SampledTorque(self.trial.torque, hold="smooth").drive(self.trial.time)
        treatment = replace(self.treatment, torque_between="smooth")
        return replace(self, drive=drive, treatment=treatment)

    def record(self) -> dict[str, Any]:
        """Plain record for JSON: which recording, which samples of it, what was done to it."""
        trial, lead, done = self.trial, self.recorded_lead, self.treatment
        found: dict[str, Any] = plain(
            {
                "name": trial.name,
                "source": trial.source,
                "sha256": trial.sha256,
                "samples": self.last - self.first,
                "sampling_rate": trial.sampling_rate,
                "perturbations": len(self.onsets),
                "preparation": {
                    "level": {
                        "of": done.level_of,
                        "torque": done.torque,
                        "angle": done.angle,
                        "fitted": self.has_offset,
                    },
                    "lowpass_hz": done.lowpass_hz,
                    "decimation": done.decimation,
                    "torque_between": done.torque_between,
                    "first": self.first,
                    "last": self.last,
                    "lead": {
                        "samples": lead.n_samples,
                        "noise_sd": lead.sd if lead.n_samples else None,
                        "correlation_time": lead.correlation_time,
                        "is_the_noise": self.lead_is_noise and lead.n_samples > 0,
                    },
                },
                "notes": list(trial.notes),
            }
        )
        return found


def prepare(trials: Sequence[Trial], *, lowpass_hz: Lowpass = "auto") -> tuple[Prepared, ...]:
    """Make trials ready: level, lead, filter, decimation.

    Trials of one study are prepared together: they share the filter, and the correlation time of
    the noise is pooled over their leads.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    lowpass_hz : float, "auto" or None
        Cut-off [Hz] where the angle is imposed: see `cutoff`.

    Returns
    -------
    tuple of Prepared

    Raises
    ------
    InputError
        Where there is no trial, they are driven differently, or the filter cannot be.
    """
    if not trials:
        raise InputError("found no trials, expected at least one")
    if len({trial.driven for trial in trials}) > 1:
        raise InputError(
            "found torque- and angle-driven trials together; give those of one kind at a time"
        )
    if trials[0].driven == "torque":
        without_leads = [_imposed_torque(trial) for trial in trials]
    else:
        cutoff_hz = cutoff(trials, lowpass_hz)
        rest, postures = _postures(trials, cutoff_hz)
        without_leads = [
            _imposed_angle(trial, cutoff_hz, posture, rest)
            for trial, posture in zip(trials, postures, strict=True)
        ]
    return _with_leads(without_leads)


def prepare_whole_band(
    trials: Sequence[Trial], *, lowpass_hz: Lowpass = "auto"
) -> tuple[Prepared, ...]:
    """Make trials ready for a likelihood that knows the noise of both channels: nothing filtered.

    As `prepare`, but for the filter. Where the angle was imposed, the recording is thinned to five
    samples a cycle of the frequency above which its angle is noise more than motion, with all
    below half of that new rate left as it is: it is finer than that only in noise, and in corners
    of the motion that no interpolation gets right.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    lowpass_hz : float, "auto" or None
        As for `prepare`; here it only says how far a recording may be thinned.

    Returns
    -------
    tuple of Prepared
    """
    if not trials or trials[0].driven == "torque":
        return prepare(trials)
    cutoff_hz = cutoff(trials, lowpass_hz) or HIGHEST_HZ
    ready = prepare([t.thinned(stride(t, cutoff_hz)) for t in trials], lowpass_hz=None)
    return tuple(
        p.part(
            p.first + (_EDGE_AT_REST if begins_at_rest(p.trial, _EDGE) else _EDGE), p.last - _EDGE
        )
        for p in ready
    )


def _imposed_torque(trial: Trial) -> tuple[Prepared, int]:
    """A trial as it is, and the number of its quiet samples."""
    moves = onsets(trial)
    prepared = Prepared(
        trial,
        SampledTorque(trial.torque).drive(trial.time),
        trial.angle,
        first=0,
        last=trial.n_samples,
        recorded_lead=NO_LEAD,
        lead_is_noise=True,
        has_offset=True,
        onsets=moves,
        treatment=Treatment("nothing"),
    )
    return prepared, int(moves[0])


def _postures(trials: Sequence[Trial], cutoff_hz: float | None) -> tuple[bool, list[float]]:
    """Operating points: whether those that the trials rest at before they move, and angles [rad].

    A short hold may be one of many, but not where all trials begin at one angle. Then, and where
    trials begin in motion, they have one operating point in common: springs that are not linear act
    about the same angle in all of them.
    """
    quiet = [_quiet(trial, cutoff_hz) for trial in trials]
    together = np.concatenate([trial.angle for trial in trials])
    if min(quiet) >= _RESTS:
        found = [float(t.angle[:n].mean()) for t, n in zip(trials, quiet, strict=True)]
        if len(trials) > 1 and np.ptp(found) < _ALIKE * together.std():
            # A first movement too small to be seen as one would shift the mean of its own trial.
            return True, [float(np.median(found))] * len(trials)
        if all(_rests_first(onsets(trial)) for trial in trials):
            return True, found
    return False, [float(together.mean())] * len(trials)


def _quiet(trial: Trial, cutoff_hz: float | None) -> int:
    """Number of samples before an imposed angle has an effect on the torque."""
    # Inertia shows in the torque before the angle has visibly moved, and a filter spreads it.
    return max(0, int(onsets(trial)[0]) - reach(trial, cutoff_hz or HIGHEST_HZ))


def _imposed_angle(
    trial: Trial, cutoff_hz: float | None, posture: float, rest: bool
) -> tuple[Prepared, int]:
    """A trial about its operating point, filtered and decimated, and the number of quiet samples.

    Springs that are not linear act about the posture that the movement starts from, if it does
    from rest. The torque's level stays unknown: its noise may be slower than the lead is long.
    """
    level = float(trial.torque.mean()), posture
    angle = "at rest before the movement" if rest else "of all trials"
    moves, ready = onsets(trial), trial.less(*level, f"mean torque, and mean angle {angle}")
    first, last, every = 0, trial.n_samples, 1
    if cutoff_hz is not None:
        first, last = settled(trial, cutoff_hz)
        every = stride(trial, cutoff_hz)
        ready = ready.lowpass(cutoff_hz)
    if every > 1:
        ready = ready.decimate(every)
    prepared = Prepared(
        ready,
        imposed_motion(ready.time, ready.angle),
        ready.torque,
        first=-(-first // every),
        last=-(-last // every),
        recorded_lead=NO_LEAD,
        lead_is_noise=False,
        has_offset=True,
        onsets=moves // every,
        treatment=Treatment("lead" if rest else "record", *level, cutoff_hz, every),
    )
    return prepared, _quiet(trial, cutoff_hz) // every


def _with_leads(found: Sequence[tuple[Prepared, int]]) -> tuple[Prepared, ...]:
    """The trials with what their leads show: the noise, and where it is known the level."""
    leads = [p.response[:n] for p, n in found if n >= LEAD_SAMPLES]
    if not leads:
        return tuple(p for p, _ in found)
    time = float(np.mean([correlation_time(q - q.mean()) for q in leads]))
    return tuple(_with_lead(p, n, time) if n >= LEAD_SAMPLES else p for p, n in found)


def _with_lead(prepared: Prepared, n: int, time: float) -> Prepared:
    """One trial with what its n quiet samples show, whose noise has this correlation time."""
    trial = prepared.trial
    # A mean over few independent samples takes part of their scatter with it.
    share = min(_LARGEST_SHARE, time / n)

    def scatter(quiet: np.ndarray) -> float:
        return float(quiet.std() / np.sqrt(1 - share))

    def level(quiet: np.ndarray) -> float:
        mean = float(quiet.mean())
        return mean if abs(mean) > _LEVEL * scatter(quiet) * np.sqrt(share) else 0.0

    sd = scatter(prepared.response[:n])
    if trial.driven == "torque":
        torque, angle = level(trial.torque[:n]), level(trial.angle[:n])
        if angle == 0.0:
            sd = float(np.sqrt(np.mean(trial.angle[:n] ** 2)))
        if torque or angle:
            trial = trial.less(torque, angle, f"mean of the {n} quiet samples")
        prepared = replace(
            prepared,
            trial=trial,
            drive=SampledTorque(trial.torque).drive(trial.time),
            response=trial.angle,
            has_offset=False,
            treatment=Treatment("lead", torque, angle),
        )
    sd = max(sd, _resolution(prepared.response) / np.sqrt(12))
    return replace(prepared, recorded_lead=Lead(n, sd, max(1.0, time)))


def _rests_first(moves: np.ndarray) -> bool:
    """Whether the first movement comes after a rest, not after one of many short holds."""
    return moves.size == 1 or bool(moves[0] > np.median(np.diff(moves)))


def _resolution(values: np.ndarray) -> float:
    """Smallest step between recorded values: at rest a coarse recorder shows no noise at all."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if steps.size else 0.0
