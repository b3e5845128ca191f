"""Parts of the trials in which K, B and I should be the same, by what was done to the joint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.investigation.split import Split
from identifiability.investigation.where.imposed import OTHER_SIZE, Imposed, starts
from identifiability.measurement.perturbations import WINDOWS

_FEWEST, _MANY = 5, 8  # samples of a window; perturbations of a record that is split into them
_LOOKED_AT = 0.2  # seconds after a perturbation in which its size and direction are read
_ONE_SIZE = 1.1  # ratio of two sizes up to which they count as one, where directions are compared


@dataclass(frozen=True)
class Unit:
    """A stretch of compared samples of one trial, with an offset of its own if it has any.

    Attributes
    ----------
    trial : int
        Its number.
    first, last : int
        Compared samples: the first, and the one after the last.
    amplitude : float
        Of the perturbation [Nm or rad].
    direction : int
        Its sign; 0 where it goes to both sides alike.
    kind : int
        Number of its waveform.
    """

    trial: int
    first: int
    last: int
    amplitude: float
    direction: int
    kind: int


@dataclass(frozen=True, eq=False)
class Group:
    """Units that K, B and I are fitted to together.

    Attributes
    ----------
    label : str
    units : tuple of Unit
    """

    label: str
    units: tuple[Unit, ...]

    @property
    def kinds(self) -> set[int]:
        """Numbers of the waveforms in it."""
        return {unit.kind for unit in self.units}


def perturbations(split: Split) -> list[Unit]:
    """The single perturbations of long records, where every trial is one; otherwise nothing."""
    units = []
    for i, ready in enumerate(split.fitted):
        onsets = starts(ready)
        if onsets.size < _MANY:
            return []
        signal = ready.drive.signals[ready.first : ready.last, 0]
        look = round(_LOOKED_AT / ready.drive.interval)
        for first, last in zip(onsets, [*onsets[1:], signal.size], strict=True):
            moved = signal[first : min(last, first + look)] - signal[first]
            change = moved[np.argmax(np.abs(moved))] if moved.size else 0.0
            if last - first >= _FEWEST and change != 0:
                sign = 1 if change > 0 else -1
                units.append(Unit(i, int(first), int(last), float(abs(change)), sign, 0))
    return units


# Each of these gives no groups where there are not two.


def windows(split: Split) -> list[Group]:
    """For each window that fits, the samples within it after the perturbations."""
    firsts = [starts(ready) for ready in split.fitted]
    fitting: list[float] = []
    units: dict[float, list[Unit]] = {}
    for window in WINDOWS:
        units[window] = []
        for i, (ready, onsets) in enumerate(zip(split.fitted, firsts, strict=True)):
            length = round(window / ready.drive.interval)
            ends = [*onsets[1:], ready.last - ready.first]
            for onset, end in zip(onsets, ends, strict=True):
                if length + 1 >= _FEWEST and onset + length < end:
                    onset = int(onset)
                    units[window].append(Unit(i, onset, onset + length + 1, 0.0, 0, 0))
        if units[window]:
            fitting.append(window)
    if len(fitting) < 2:
        return []
    # Only perturbations that have the longest window, so that each window holds the shorter ones.
    whole = {(u.trial, u.first) for u in units[fitting[-1]]}
    return [
        Group(f"{1000 * w:g} ms", tuple(u for u in units[w] if (u.trial, u.first) in whole))
        for w in fitting
    ]


def amplitudes(units: Sequence[Unit]) -> list[Group]:
    """Small and large perturbations; of one kind and direction, where there are such."""
    keys: list[Callable[[Unit], object]] = [
        lambda u: (u.kind, u.direction),
        lambda u: u.kind,
        lambda u: 0,
    ]
    for key in keys:
        small, large = _halves(units, key)
        if small:
            return [Group("small", tuple(small)), Group("large", tuple(large))]
    return []


def _halves(units: Sequence[Unit], key: Callable[[Unit], object]) -> tuple[list[Unit], list[Unit]]:
    """Units below and above the middle amplitude of those that share a key."""
    small: list[Unit] = []
    large: list[Unit] = []
    for value in dict.fromkeys(key(u) for u in units):
        alike = [u for u in units if key(u) == value]
        sizes = [u.amplitude for u in alike]
        if max(sizes) < OTHER_SIZE * min(sizes):
            continue
        # The middle between neighbours that differ most evenly: by size, not by number, where few.
        middle = (
            float(np.median(sizes)) if len(sizes) >= _MANY else np.sqrt(max(sizes) * min(sizes))
        )
        small += [u for u in alike if u.amplitude < middle]
        large += [u for u in alike if u.amplitude >= middle]
    return small, large


def directions(units: Sequence[Unit]) -> list[Group]:
    """Perturbations to either side; of one kind and size, where there are such."""

    def size(u: Unit) -> tuple[int, int]:
        return u.kind, round(np.log(u.amplitude) / np.log(_ONE_SIZE)) if u.amplitude > 0 else 0

    keys: list[Callable[[Unit], object]] = [size, lambda u: u.kind, lambda u: 0]
    for key in keys:
        both: dict[int, list[Unit]] = {1: [], -1: []}
        for value in dict.fromkeys(key(u) for u in units):
            alike = [u for u in units if key(u) == value]
            if {u.direction for u in alike} >= {1, -1}:
                for unit in alike:
                    if unit.direction:
                        both[unit.direction].append(unit)
        if both[1]:
            return [Group("positive", tuple(both[1])), Group("negative", tuple(both[-1]))]
    return []


def conditions(units: Sequence[Unit], loads: Sequence[Imposed]) -> list[Group]:
    """Trials by the kind of perturbation."""
    names = dict.fromkeys(load.condition for load in loads)
    return _if_several(
        [Group(n, tuple(u for u in units if loads[u.trial].condition == n)) for n in names]
    )


def trials(units: Sequence[Unit], split: Split) -> list[Group]:
    """Every trial by itself."""
    return _if_several([Group(split.fitted[u.trial].name, (u,)) for u in units])


def _if_several(groups: list[Group]) -> list[Group]:
    return groups if len(groups) > 1 else []
