"""What was imposed in each trial: how much, which way, and which trials are alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identifiability.measurement.prepared import Prepared
from identifiability.measurement.trials import onsets

OTHER_SIZE = 1.2
"""Ratio of two sizes from which they count as different."""
_ALIKE = 0.99  # correlation of imposed signals that are scaled copies of each other
_TWO_SIDED = 0.8  # ratio of the excursions to both sides from which there is no main direction
_REST, _AT_REST = 0.02, 0.05  # seconds before an onset, and share of the response's range


@dataclass(frozen=True)
class Imposed:
    """What was imposed in one trial.

    Attributes
    ----------
    amplitude : float
        Largest departure of the imposed signal from its start [Nm or rad].
    direction : int
        Sign of the response's main excursion; 0 where it goes to both sides alike.
    kind : int
        Number of the waveform: trials whose imposed signals are scaled copies share it.
    gain : float
        Size, with its sign, relative to the first trial of that waveform.
    condition : str
        The trial's own, or else the first trial of its waveform.
    """

    amplitude: float
    direction: int
    kind: int
    gain: float
    condition: str


def imposed(part: Sequence[Prepared]) -> tuple[Imposed, ...]:
    """Amplitude, direction and kind of every trial."""
    signals = [_signal(ready) for ready in part]
    leaders: list[int] = []
    kinds, gains = [], []
    for i, (interval, values) in enumerate(signals):
        for kind, leader in enumerate(leaders):
            other = signals[leader]
            correlation, gain = _likeness(other[1], values)
            if np.isclose(other[0], interval, rtol=1e-6) and abs(correlation) > _ALIKE:
                kinds.append(kind)
                gains.append(gain)
                break
        else:
            leaders.append(i)
            kinds.append(len(leaders) - 1)
            gains.append(1.0)
    named = any(ready.trial.condition for ready in part)
    return tuple(
        Imposed(
            float(np.abs(values).max(initial=0.0)),
            _direction(ready.compared - ready.compared[0]),
            kind,
            float(gain),
            ready.trial.condition if named else _like(part, leaders[kind], kinds.count(kind)),
        )
        for ready, (_, values), kind, gain in zip(part, signals, kinds, gains, strict=True)
    )


def starts(ready: Prepared) -> np.ndarray:
    """Compared samples at which a perturbation starts, counted from the first compared one.

    Where the torque is imposed only those that find the joint at rest count: after them the
    response depends on nothing earlier.

    Returns
    -------
    array of int, shape (n_starts,)
        At least one; 0 where no perturbation starts in the compared part.
    """
    found = onsets(ready.trial)
    if ready.trial.driven == "torque":
        before = round(_REST / ready.drive.interval)
        limit = _AT_REST * np.ptp(ready.response)
        home = ready.response[: found[0] + 1].mean()
        quiet = [found[0]]
        for onset in found[1:]:
            last = ready.response[max(0, onset - before) : onset + 1]
            if abs(last.mean() - home) < limit and np.ptp(last) < 2 * limit:
                quiet.append(onset)
        found = np.array(quiet)
    inside = found[(found >= ready.first) & (found < ready.last - 1)] - ready.first
    return inside if inside.size else np.zeros(1, int)


def _signal(ready: Prepared) -> tuple[float, np.ndarray]:
    """Imposed signal from the first onset on, less its value there."""
    values = ready.drive.signals[ready.first : ready.last, 0]
    onset = int(starts(ready)[0])
    return ready.drive.interval, values[onset:] - values[onset]


def _likeness(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Correlation of two signals over their common length, and size of the second in the first."""
    n = min(one.size, other.size)
    one, other = one[:n], other[:n]
    product, energy = float(one @ other), float(one @ one)
    norm = np.sqrt(energy * float(other @ other))
    return (product / norm, product / energy) if norm > 0 else (0.0, 0.0)


def _direction(response: np.ndarray) -> int:
    up, down = max(response.max(), 0.0), max(-response.min(), 0.0)
    if min(up, down) > _TWO_SIDED * max(up, down):
        return 0
    return 1 if up > down else -1


def _like(part: Sequence[Prepared], leader: int, n: int) -> str:
    return part[leader].name if n == 1 else f"like {part[leader].name}"
