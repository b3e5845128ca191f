"""One continuous recording as trials, one for each perturbation."""

from __future__ import annotations

from itertools import pairwise

from identifiability.errors import InputError
from identifiability.measurement.trials import Trial, onsets

LEAD = 0.1
"""Seconds before a perturbation that its trial begins."""

APART = 0.2
"""Seconds between two perturbations that are two: both edges of a pulse are one."""

_NOTE = "cut at its perturbations"


def cut_at_onsets(
    recording: Trial, *, lead: float = LEAD, separation: float = APART
) -> tuple[Trial, ...]:
    """Cut a recording where what was imposed starts to move (`onsets`).

    Each trial begins before one onset and ends where the next begins, so that no sample belongs to
    two and none after the first onset's lead is lost. Times stay those of the recording.

    Parameters
    ----------
    recording : Trial
    lead : float
        Seconds before an onset that its trial begins; half of the time since the last onset at
        most, so that each trial has its own perturbation.
    separation : float
        Movements that start closer (s) than this to the last perturbation belong to it, as the
        second edge of a pulse does. One that starts closer to the end is left with the trial
        before.

    Returns
    -------
    tuple of Trial
        The recording itself where it has one perturbation.

    Raises
    ------
    InputError
        If the lead is negative, the separation not above 0, or a trial has a constant channel.
    """
    if not separation > 0:
        raise InputError(f"perturbations {separation:g} s apart were asked for, expected above 0")
    if not lead >= 0:
        raise InputError(f"a lead of {lead:g} s was asked for, expected 0 or more")
    interval, n = recording.dt, recording.n_samples
    starts = [int(i) for i in onsets(recording, separation=separation)]
    starts = [i for i in starts if i == starts[0] or (n - 1 - i) * interval >= separation]
    if len(starts) == 1:
        return (recording,)
    ahead = round(lead / interval)
    edges = [max(0, starts[0] - ahead)]
    edges += [after - min(ahead, (after - before) // 2) for before, after in pairwise(starts)]
    return tuple(
        recording.part(first, last, name=f"{recording.name} {number}", why=_NOTE)
        for number, (first, last) in enumerate(pairwise([*edges, n]), start=1)
    )


def is_cut(trial: Trial) -> bool:
    """Tell whether a trial was cut from a longer recording by `cut_at_onsets`."""
    return any(note.startswith(_NOTE) for note in trial.notes)
