"""Long records in pieces that are computed side by side, each begun early enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.fitting import explore
from identifiability.inference.problem import Observation, Prior, Problem, observe
from identifiability.inference.starts import first_guess
from identifiability.joint.model import KBI
from identifiability.measurement.noise import Noise
from identifiability.measurement.prepared import Prepared

MOST_SAMPLES = 8_192
"""Samples of one trial or half a record that models are fitted to or judged on."""

_LONGEST = 4096  # samples of a piece
_FORGOTTEN = 1e-5  # share of a motion that is left
_STATES = 3.0  # seconds: ten times the slowest state that a recording of some minutes tells
_EVALUATIONS, _FURTHER = 20, 40  # of the fit by which that is known


def remembering(trials: Sequence[Prepared]) -> list[Prepared]:
    """Trials that know how long their joint takes to forget a motion, where that matters.

    An imposed torque lets a joint swing on for as long as its damping says, which is read from K, B
    and I fitted to the first piece of each long record. An imposed angle is what it is; there only
    states of the muscle fade.

    Parameters
    ----------
    trials : sequence of Prepared
    """
    long = [p for p in trials if _is_long(p)]
    if not long:
        return list(trials)
    if long[0].trial.driven == "angle":
        return [_warmed(p, _STATES) for p in trials]
    begins = [pieces(p, Noise(1.0))[0] for p in long]
    prior = Prior.recorded(KBI())
    try:
        guess = first_guess([p.trial for p in long], prior)
        starts = np.array([guess, guess * [3.0, 0.3, 1.0]])
        problem = Problem(KBI(), begins, prior)
        found = explore(problem, starts, evaluations=_EVALUATIONS, further=_FURTHER).values
    except InputError:
        return list(trials)  # nothing to be read from them; their fit says so
    stiffness, damping, inertia = found
    slowest = -max(np.roots([inertia, damping, stiffness]).real)
    seconds = -np.log(_FORGOTTEN) / max(slowest, 1e-6)
    return [_warmed(p, seconds) for p in trials]


def _warmed(prepared: Prepared, seconds: float) -> Prepared:
    """A trial that is computed from so long before its parts on, if it has any."""
    longer = max(prepared.warm_up, seconds)
    return replace(prepared, warm_up=longer) if _is_long(prepared) else prepared


def _is_long(prepared: Prepared) -> bool:
    return not (prepared.response.size <= _LONGEST and prepared.first == 0)


def pieces(prepared: Prepared, noise: Noise, *, shortly: bool = False) -> list[Observation]:
    """A trial as one observation, or as overlapping ones that are computed side by side.

    Each begins so long before its compared samples as the joint needs to forget where it was, and
    compares no fewer than that: of a joint that swings on for long, pieces are mostly beginnings.

    Parameters
    ----------
    prepared : Prepared
    noise : Noise
    shortly : bool
        Whether they are as short as can be all the same, because few of them are computed.
    """
    span = prepared.last - prepared.first
    n_offsets = prepared.has_offset
    if not _is_long(prepared):
        chosen = np.arange(prepared.last)
        segment = np.zeros(chosen.size, int) if n_offsets else None
        return [observe(prepared.drive, prepared.response, noise, select=chosen, segment=segment)]
    warm_up = int(np.ceil(prepared.warm_up / prepared.drive.interval))
    length = _LONGEST // 2 if shortly else max(_LONGEST // 2, min(warm_up, MOST_SAMPLES))
    length = max(min(span, length), 1)
    starts = range(prepared.first, prepared.last, length)
    out: list[Observation] = []
    for start in starts:
        stop = min(start + length, prepared.last)
        if stop - start < 2:
            continue
        low = max(0, start - warm_up)
        part = replace(
            prepared.drive,
            states=prepared.drive.states[low:stop],
            impulses=prepared.drive.impulses[low:stop],
        )
        chosen = np.arange(start - low, stop - low)
        segment = np.zeros(chosen.size, int) if n_offsets else None
        one = observe(part, prepared.response[low:stop], noise, select=chosen, segment=segment)
        # The pieces share the record's one offset.
        share = np.sqrt(chosen.size / span)
        out.append(replace(one, constant=one.constant * share, continues=bool(out)))
    return out


def owners(observations: Sequence[Observation]) -> np.ndarray:
    """Number of the trial that each observation is a piece of, shape (n_observations,)."""
    return np.cumsum([not o.continues for o in observations]) - 1


def places(observations: Sequence[Observation]) -> list[np.ndarray]:
    """Where each trial's compared samples are among residuals, its pieces put together.

    Parameters
    ----------
    observations : sequence of Observation
        Whole trials, or pieces of them in their order.

    Returns
    -------
    list of array of int
        One a trial.
    """
    width = max(o.measured.size for o in observations)
    pieces: list[list[np.ndarray]] = []
    for row, observation in enumerate(observations):
        if not observation.continues:
            pieces.append([])
        pieces[-1].append(row * width + np.flatnonzero(observation.scale > 0))
    return [np.concatenate(found) for found in pieces]
