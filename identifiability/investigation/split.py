"""Trials made ready for the comparison of models: responses, noise, weights and pieces.

Every model is fitted to the same samples with the same weights. A trial weighs by its noise and by
a share of its own energy, so that neither the largest trial nor the quietest decides alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.problem import Observation, observe
from identifiability.inference.recordings import integrated_autocorrelation
from identifiability.investigation.rules import Rules
from identifiability.measurement.filtering import Lowpass, cutoff, smooth
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial, onsets, quiet_lead

_LEAD_SAMPLES = 20  # a shorter lead says too little about the noise
_LONGEST, _WARM_UP = 4096, 1.0  # samples of a piece; seconds in which a piece forgets its start
_ROUND = 64  # lengths are padded to a multiple, so that compiled programs serve many data sets


@dataclass(frozen=True, eq=False)
class Lead:
    """Noise of a response, read from the quiet samples before the perturbation.

    Attributes
    ----------
    n_samples : int
        0 where there is no usable lead.
    sd : float
        Standard deviation of the noise; 0 where there is no usable lead.
    correlation_time : float
        Integrated autocorrelation time [samples], pooled over the trials.
    """

    n_samples: int
    sd: float
    correlation_time: float


NO_LEAD = Lead(0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Ready:
    """A trial ready to be compared with models.

    Attributes
    ----------
    trial : Trial
        Filtered and freed of its operating point; its notes say how.
    first, last : int
        Samples that are compared: all, or one part of a long record.
    drive : Drive
        What was imposed.
    response : array, shape (n,)
        What was measured: angle [rad] or torque [Nm].
    lead : Lead
    has_offset : bool
        Whether the response's level at rest is unknown, and fitted.
    """

    trial: Trial
    first: int
    last: int
    drive: Drive
    response: np.ndarray
    lead: Lead
    has_offset: bool

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

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


@dataclass(frozen=True, eq=False)
class Split:
    """The trials that models are fitted to and those they are judged on.

    Attributes
    ----------
    fitted, held_out : tuple of Ready
    how_held_out : str
        In words, which part was held out.
    rules : Rules
        Conventions that everything after goes by.
    """

    fitted: tuple[Ready, ...]
    held_out: tuple[Ready, ...]
    how_held_out: str
    rules: Rules

    @property
    def driven(self) -> str:
        """What was imposed: "torque" or "angle"."""
        return self.fitted[0].trial.driven

    @property
    def has_noise(self) -> bool:
        """Whether every trial has a quiet lead that its noise could be read from."""
        return all(r.lead.n_samples for r in (*self.fitted, *self.held_out))

    def noise_floor(self, part: Sequence[Ready] | None = None) -> float | None:
        """Error E that the noise alone leaves, pooled over trials; ``None`` where it is unknown.

        Parameters
        ----------
        part : sequence of Ready, optional
            The fitted trials by default.
        """
        if not self.has_noise:
            return None
        chosen = self.fitted if part is None else part
        return float(np.mean([r.lead.sd**2 / r.mean_square for r in chosen]))

    @property
    def moves_early(self) -> bool:
        """Whether a torque that is not held constant precedes the first onset of some trial."""
        return self.driven == "torque" and any(
            np.ptp(r.trial.torque[: r.lead.n_samples]) > 0 for r in self.fitted if r.lead.n_samples
        )

    def without_leads(self) -> Split:
        """Return the same trials with unknown noise and an unknown level of the response."""
        fitted, held_out = (
            tuple(replace(r, lead=NO_LEAD, has_offset=True) for r in part)
            for part in (self.fitted, self.held_out)
        )
        return replace(self, fitted=fitted, held_out=held_out)

    def floor_uncertainty(self) -> float:
        """Relative standard error of the noise floor, from the lengths of the leads."""
        trials = (*self.fitted, *self.held_out)
        effective = sum(r.lead.n_samples / r.lead.correlation_time for r in trials)
        return float(np.sqrt(2.0 / max(effective, 1.0)))

    def weights_sd(self, part: Sequence[Ready]) -> np.ndarray:
        """Standard deviation that each trial's residual is measured in, shape (n_trials,)."""
        return np.array(
            [np.sqrt(r.lead.sd**2 + self.rules.discrepancy * r.mean_square) for r in part]
        )

    def observations(self, part: Sequence[Ready]) -> list[Observation]:
        """Observations of a part, long records cut into pieces that can be computed together."""
        out: list[Observation] = []
        for ready, sd in zip(part, self.weights_sd(part), strict=True):
            out += _pieces(ready, Noise(float(sd)))
        return out

    @cached_property
    def room(self) -> tuple[int, int]:
        """Numbers of observations and samples that both parts fit into."""
        parts = [self.observations(part) for part in (self.fitted, self.held_out) if part]
        longest = max(o.measured.size for part in parts for o in part)
        return max(len(part) for part in parts), -(-longest // _ROUND) * _ROUND


def gather(
    trials: Sequence[Trial],
    held_out: Sequence[Trial] = (),
    *,
    lowpass_hz: Lowpass = "auto",
    rules: Rules | None = None,
) -> Split:
    """Make trials ready, and choose what to hold out where nothing is named.

    Held out are whole conditions: of several trials about every third, such that each kind of
    perturbation stays in both parts where it can; of one long record the second half, or the
    first where most of the second lies beyond the angles that the first reaches: what no fitted
    sample came near would judge how well parameters are known, not whether the model is right.

    Parameters
    ----------
    trials : sequence of Trial
        All driven alike.
    held_out : sequence of Trial
        Trials that no model is fitted to.
    lowpass_hz : float, "auto" or None
        Zero-phase low-pass where the angle is imposed: see `cutoff`.
    rules : Rules, optional
        Conventions that everything after goes by.

    Returns
    -------
    Split

    Raises
    ------
    InputError
        Where there is no trial, or they are driven differently.
    """
    if not trials:
        raise InputError("found no trials to fit, expected at least one")
    everything = [*trials, *held_out]
    if len({t.driven for t in everything}) > 1:
        raise InputError("found torque- and angle-driven trials together; investigate one kind")
    rules = Rules() if rules is None else rules
    ready = _ready(everything, lowpass_hz)
    fit, rest = ready[: len(trials)], ready[len(trials) :]
    if rest:
        return Split(tuple(fit), tuple(rest), f"{len(rest)} trials that were named", rules)
    if len(fit) == 1:
        middle = (fit[0].first + fit[0].last) // 2
        parts = replace(fit[0], last=middle), replace(fit[0], first=middle)
        if min(np.ptp(p.compared) for p in parts) == 0:
            raise InputError(
                f"found one trial, '{fit[0].name}', whose response moves in one half only; give "
                "several trials, or name some with --hold-out"
            )
        if _beyond(*parts) > 0.5:
            return Split(
                parts[1:],
                parts[:1],
                "the first half of the record: most of the second lies beyond its angles",
                rules,
            )
        return Split(parts[:1], parts[1:], "the second half of the record", rules)
    held = _choose_held_out([r.trial for r in fit])
    return Split(
        tuple(r for i, r in enumerate(fit) if i not in held),
        tuple(r for i, r in enumerate(fit) if i in held),
        f"{len(held)} of {len(fit)} trials, chosen by amplitude",
        rules,
    )


def _beyond(one: Ready, other: Ready) -> float:
    """Share of another part whose angle lies beyond those that one reaches."""
    reached, asked = (r.trial.angle[r.first : r.last] for r in (one, other))
    return float(np.mean((asked < reached.min()) | (asked > reached.max())))


def _choose_held_out(trials: Sequence[Trial]) -> set[int]:
    """About a third of the trials: those with middling and with the largest amplitudes.

    Ordered by the size of what was imposed, every third trial is held out, beginning with the
    largest: an extrapolation and interpolations.
    """
    imposed = [t.torque if t.driven == "torque" else t.angle for t in trials]
    order = np.argsort([-np.std(x) for x in imposed], kind="stable")
    if len(trials) == 2:
        return {int(order[0])}
    return {int(i) for i in order[:: 3 if len(trials) > 3 else 2][: len(trials) // 2]}


def _ready(trials: Sequence[Trial], lowpass_hz: Lowpass) -> list[Ready]:
    if trials[0].driven == "angle":
        cutoff_hz = cutoff(trials, lowpass_hz)
        return [_angle_driven(trial, cutoff_hz) for trial in trials]
    leads = [quiet_lead(trial) for trial in trials]
    usable = [n if n >= _LEAD_SAMPLES else 0 for n in leads]
    quiet = [t.angle[:n] for t, n in zip(trials, usable, strict=True) if n]
    time = float(np.mean([integrated_autocorrelation(q) for q in quiet])) if quiet else 1.0
    out = []
    for trial, n in zip(trials, usable, strict=True):
        if not n:
            drive = SampledTorque(trial.torque).drive(trial.time)
            out.append(Ready(trial, 0, trial.n_samples, drive, trial.angle, NO_LEAD, True))
            continue
        # A level that the lead's own scatter explains is left alone: taking it off would add its
        # error to every sample.
        shifted, sd = {}, 0.0
        for channel in ("torque", "angle"):
            values = getattr(trial, channel)
            level, scatter = float(values[:n].mean()), float(values[:n].std())
            share = min(0.9, time / n)
            scatter /= np.sqrt(1 - share)
            if abs(level) > 4 * scatter * np.sqrt(share) and abs(level) > 0:
                shifted[channel] = values - level
            elif channel == "angle":
                scatter = float(np.sqrt(np.mean(values[:n] ** 2)))
            sd = scatter
        sd = max(sd, _resolution(trial.angle) / np.sqrt(12))
        if shifted:
            note = f"level of the {n} quiet samples removed from {' and '.join(shifted)}"
            trial = replace(trial, notes=(*trial.notes, note), **shifted)
        drive = SampledTorque(trial.torque).drive(trial.time)
        lead = Lead(n, sd, max(1.0, time))
        out.append(Ready(trial, 0, trial.n_samples, drive, trial.angle, lead, False))
    return out


def _angle_driven(trial: Trial, cutoff_hz: float | None) -> Ready:
    smoothed = smooth(trial, cutoff_hz)
    ready = smoothed.trial
    if smoothed.every > 1:
        ready = ready.decimate(smoothed.every)
    drive = imposed_motion(ready.time, ready.angle)
    return Ready(ready, *smoothed.settled_of_kept, drive, ready.torque, NO_LEAD, True)


def _resolution(values: np.ndarray) -> float:
    """Smallest step between recorded values: at rest a coarse recorder shows no noise at all."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if steps.size else 0.0


def _pieces(ready: Ready, noise: Noise) -> list[Observation]:
    """A trial as one observation, or as overlapping ones that are computed side by side."""
    span = ready.last - ready.first
    n_offsets = ready.has_offset
    if ready.response.size <= _LONGEST and ready.first == 0:
        chosen = np.arange(ready.last)
        segment = np.zeros(chosen.size, int) if n_offsets else None
        return [observe(ready.drive, ready.response, noise, select=chosen, segment=segment)]
    warm_up = round(_WARM_UP / ready.drive.interval)
    length = max(min(span, _LONGEST // 2), 1)
    starts = range(ready.first, ready.last, length)
    out: list[Observation] = []
    for start in starts:
        stop = min(start + length, ready.last)
        if stop - start < 2:
            continue
        low = max(0, start - warm_up)
        part = replace(
            ready.drive,
            states=ready.drive.states[low:stop],
            impulses=ready.drive.impulses[low:stop],
        )
        chosen = np.arange(start - low, stop - low)
        segment = np.zeros(chosen.size, int) if n_offsets else None
        one = observe(part, ready.response[low:stop], noise, select=chosen, segment=segment)
        # The pieces share the record's one offset.
        share = np.sqrt(chosen.size / span)
        out.append(replace(one, constant=one.constant * share, continues=bool(out)))
    return out


def onset_of(ready: Ready) -> int:
    """Sample at which a trial's imposed signal starts to move."""
    return int(onsets(ready.trial)[0])
