"""Starts for the fits of joint models, such that they do not get stuck."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import signal

from identifiability.inference.problem import Prior
from identifiability.joint.model import Model
from identifiability.joint.parameters import Parameter
from identifiability.measurement.perturbations import imposed_motion
from identifiability.measurement.trials import Trial

_FACTORS = (0.4, 1.0, 2.5)
_WIDE = (0.15, 0.3, 0.55, 1.0, 1.8, 4.0, 10.0)
_NARROW = 3  # ratio of bounds up to which starts between them are equally spaced
_SOFTER = (3.0, 10.0)  # stiffness of a tendon over the joint's
_WIDELY_SOFTER = (1.0, 3.0, 10.0)
# Of a link with play: its stiffness over the joint's, its gap over what is usual, and the part of
# the largest place to either side. A limb is pressed against a stiff link by little of its gap.
_LINKS, _GAPS, _PLACES = (10.0, 30.0, 100.0), (0.3, 1.0), (-0.5, -0.325, 0.0, 0.325, 0.5)
_STIFF = 100.0  # the same, of one that hardly gives: softer ones lead away from it
_MOST_STARTS, _MOST_WIDELY = 6, 28
_PART = 0.1  # of the torque, that a property makes of which regression finds nothing


def starting_values(
    model: Model, known: Mapping[str, float], *, most: int | None = None, wide: bool = False
) -> list[dict[str, float]]:
    """Starts for a model some of whose parameters are known from a smaller one.

    A new effect starts near its null, where the best size is found at once, at several values of
    its shape parameters; an effect that vanishes with infinite stiffness starts at several
    stiffnesses, with K and B raised to make up for it.

    Parameters
    ----------
    model : Model
    known : mapping of str to float
        K, B, I and the parameters of the effects that were there before.
    most : int, optional
        Number of starts; more by default where they are wide.
    wide : bool
        Whether shapes are spread further, for starts of which the best will be chosen.
    """
    most = most or (_MOST_WIDELY if wide else _MOST_STARTS)
    factors, softer = (_WIDE, _WIDELY_SOFTER) if wide else (_FACTORS, _SOFTER)
    grids: list[list[float]] = []
    names = model.parameter_names
    for name, p in model.parameters.items():
        if name in known:
            grids.append([known[name]])
        elif p.plain is not None:
            grids.append([p.plain])
        elif p.null is not None and np.isfinite(p.null):
            grids.append([p.null + 0.01 * (p.nominal - p.null)])
        elif p.null is not None:
            grids.append([f * known["K"] + 1.0 for f in softer])
        elif p.lower >= 0 and p.upper > (_NARROW if wide else 10) * p.lower:
            clipped = [float(np.clip(f * p.nominal, p.lower, p.upper)) for f in factors]
            grids.append(list(dict.fromkeys(clipped)))
        else:
            grids.append([p.lower + s * (p.upper - p.lower) for s in (0.5, 0.25, 0.75)])
    every = list(itertools.product(*grids))
    # Spread over the grid; the middle one, of nominal shape, comes first.
    chosen = np.unique(np.linspace(0, len(every) - 1, most).astype(int))
    starts = [dict(zip(names, every[i], strict=True)) for i in chosen]
    new = {name: p for name, p in model.parameters.items() if name not in known}
    gives = [name for name, p in new.items() if p.endless]
    if wide and gives:
        shape = {n: p.nominal for n, p in new.items() if p.null is None and p.plain is None}
        starts.append(starts[0] | shape | dict.fromkeys(gives, _STIFF * known["K"] + 1.0))
        starts += [starts[0] | shape | other for other in _with_gaps(new, known["K"])]
    for start in starts:
        for name in gives:
            softened = 1 + start["K"] / start[name]
            start["K"] *= softened
            start["B"] *= softened**2
    return starts


def _with_gaps(new: Mapping[str, Parameter], stiffness: float) -> list[dict[str, float]]:
    """Stiffnesses, gaps and places of a link that has all three, as play has.

    From near a gap of 0 no step leads to where the limb leans against one side of it.
    """
    places = {n: p for n, p in new.items() if p.plain is None and p.lower == -p.upper}
    keys = {name.split(".")[0] for name in places}
    own = {name: p for name, p in new.items() if name.split(".")[0] in keys}
    sizes = {name: p for name, p in own.items() if p.null is not None and p.plain is None}
    if len({p.endless for p in sizes.values()}) < 2:
        return []
    grids = {
        name: [f * stiffness + 1.0 for f in _LINKS] if p.endless else [f * p.nominal for f in _GAPS]
        for name, p in sizes.items()
    } | {n: [p.nominal + part * p.upper for part in _PLACES] for n, p in places.items()}
    return [dict(zip(grids, values, strict=True)) for values in itertools.product(*grids.values())]


def refined_values(
    model: Model, values: Mapping[str, float], free: Sequence[str]
) -> list[dict[str, float]]:
    """Starts of a refined model: the plain optimum, and its refinements one way and the other.

    Parameters
    ----------
    model : Model
    values : mapping of str to float
        All parameters of the plain optimum.
    free : sequence of str
        Those that were free there.
    """
    starts = [dict(values)]
    new = {
        name: (p, p.plain)
        for name, p in model.parameters.items()
        if p.plain is not None and name not in free
    }
    own = {name.split(".")[0] for name in new}
    for side in (1.0, -1.0):
        start = dict(values)
        for name, (p, plain) in new.items():
            # Most of the way to one side and, where there is one, to the other.
            room = p.upper - plain if side > 0 or p.lower >= plain else p.lower - plain
            start[name] = plain + float(np.clip(0.8 * room, -0.5, 0.8))
        starts.append(start)
        # The plain form may have gone astray for want of the refinement.
        fresh = dict(start)
        for name, p in model.parameters.items():
            if name.split(".")[0] in own and p.plain is None and p.null is None:
                fresh[name] = p.nominal
        starts.append(fresh)
    return starts


def nested_values(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values by which a model does what a smaller one does: effects that are new have no size.

    Parameters
    ----------
    model : Model
    values : mapping of str to float
        All parameters of the smaller one.
    """

    def without(p: Parameter) -> float:
        if p.plain is not None:
            return p.plain
        return p.nominal if p.null is None else min(p.null, p.upper)

    return {n: values[n] if n in values else without(p) for n, p in model.parameters.items()}


def plain_values(model: Model, refined: Sequence[str] = ()) -> dict[str, float]:
    """Values that give effects their plain form, of those parameters that only refine them.

    Parameters
    ----------
    model : Model
    refined : sequence of str
        Keys of the effects whose refining parameters are to be free.
    """
    return {
        name: p.plain
        for name, p in model.parameters.items()
        if p.plain is not None and name.split(".")[0] not in refined
    }


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
    rows, targets, sizes = [], [], []
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
        sizes.append(scale / np.maximum(np.std(motion, axis=0), 1e-300))
        rows.append(np.column_stack([motion - motion.mean(axis=0)]) / scale)
        targets.append((torque - torque.mean()) / scale)
    guess = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    lower, upper = prior.lower[:3], prior.upper[:3]
    # What regression finds nothing of may still be there, as a part of the torque.
    small = _PART * np.median(sizes, axis=0)
    return np.clip(np.where(guess > 0, guess, small), lower, upper)
