"""What the instruments of the library make of a response, with first derivatives."""

from __future__ import annotations

import math

import numpy as np

from identifiability.joint.effects.base import Effect
from identifiability.joint.effects.sensor_delay import SensorDelay
from identifiability.joint.effects.sensor_drift import SensorDrift
from identifiability.joint.effects.sensor_lowpass import SensorLowpass
from identifiability.loops import compiled_loop

_DELAY, _DRIFT, _LOWPASS = range(3)
_KINDS = {SensorDelay.record: _DELAY, SensorDrift.record: _DRIFT, SensorLowpass.record: _LOWPASS}
_LEAST, _NEARLY = 1e-6, 1e-9  # see `effects.sensor_lowpass`


def kind_of(effect: Effect) -> int | None:
    """Number of the loops of an instrument; none of one that the library does not know."""
    return _KINDS.get(type(effect).record)


@compiled_loop
def record(
    kind: int, p: np.ndarray, lanes: np.ndarray, interval: float, signal: np.ndarray
) -> np.ndarray:
    """What an instrument makes of a signal.

    Parameters
    ----------
    kind : int
    p : array, shape (n_parameters,)
        Its parameters.
    lanes : array of int, shape (n_parameters,)
        Which derivative is that by each of them, from 1; 0 if none.
    interval : float
    signal : array, shape (n, width)

    Returns
    -------
    array, shape (n, width)
    """
    if kind == _DELAY:
        return _delayed(p[0], lanes[0], interval, signal)
    if kind == _DRIFT:
        return _drifting(p, lanes, interval, signal)
    return _lowpassed(p[0], p[1], lanes, interval, signal)


@compiled_loop
def _delayed(delay: float, lane: int, interval: float, signal: np.ndarray) -> np.ndarray:
    n, width = signal.shape
    out = np.empty((n, width))
    # The same cubic through four neighbours everywhere: their shares, and derivatives of these.
    first = math.floor(-delay / interval)
    s = -delay / interval - first
    a, da = -s * (s - 1) * (s - 2) / 6, (3 * s * s - 6 * s + 2) / (6 * interval)
    b, db = (s + 1) * (s - 1) * (s - 2) / 2, -(3 * s * s - 4 * s - 1) / (2 * interval)
    c, dc = -(s + 1) * s * (s - 2) / 2, (3 * s * s - 2 * s - 2) / (2 * interval)
    d, dd = (s + 1) * s * (s - 1) / 6, -(3 * s * s - 1) / (6 * interval)
    for k in range(n):
        base = k + first
        h, i = min(max(base - 1, 0), n - 1), min(max(base, 0), n - 1)
        j, m = min(max(base + 1, 0), n - 1), min(max(base + 2, 0), n - 1)
        for t in range(width):
            out[k, t] = a * signal[h, t] + b * signal[i, t] + c * signal[j, t] + d * signal[m, t]
        if lane:
            out[k, lane] += da * signal[h, 0] + db * signal[i, 0]
            out[k, lane] += dc * signal[j, 0] + dd * signal[m, 0]
    return out


@compiled_loop
def _drifting(p: np.ndarray, lanes: np.ndarray, interval: float, signal: np.ndarray) -> np.ndarray:
    out = signal.copy()
    for k in range(signal.shape[0]):
        power = time = interval * k
        for i in range(3):
            out[k, 0] += p[i] * power
            if lanes[i]:
                out[k, lanes[i]] += power
            power *= time
    return out


@compiled_loop
def _expm1(z: complex) -> complex:
    return complex(
        math.expm1(z.real) * math.cos(z.imag) - 2.0 * math.sin(0.5 * z.imag) ** 2,
        math.exp(z.real) * math.sin(z.imag),
    )


@compiled_loop
def _pole(constant: complex, interval: float) -> np.ndarray:
    """What the next value of one pole has of its last, of the signal now and before; and 1.

    In the second row their derivatives by its time constant. The signal is straight in between.
    """
    there = abs(constant) >= _LEAST
    ratio = interval / (constant if there else complex(_LEAST, 0.0))
    gone = -_expm1(-ratio)
    kept, mean = 1.0 - gone, gone * constant / interval
    keeping = kept * ratio / constant if there else 0j
    meaning = (gone - keeping * constant) / interval
    found = np.empty((2, 4), np.complex128)
    found[0, 0], found[0, 1], found[0, 2], found[0, 3] = kept, 1.0 - mean, mean - kept, 1.0
    found[1, 0], found[1, 1], found[1, 2], found[1, 3] = keeping, -meaning, meaning - keeping, 0.0
    return found


@compiled_loop
def _add_signal(
    one: np.ndarray, other: np.ndarray, slow: complex, fast: complex, out: np.ndarray
) -> None:
    """Add what the sum of two poles, of such shares, has of the signal now and the two before."""
    middle = slow * (one[2] * other[3] - one[1] * other[0])
    middle += fast * (one[3] * other[2] - one[0] * other[1])
    out[2] += (slow * one[1] * other[3] + fast * one[3] * other[1]).real
    out[3] += middle.real
    out[4] -= (slow * one[2] * other[0] + fast * one[0] * other[2]).real


@compiled_loop
def _add_last(one: np.ndarray, other: np.ndarray, out: np.ndarray) -> None:
    """Add what it has of its own last two values."""
    out[0] += (one[0] * other[3] + one[3] * other[0]).real
    out[1] -= (one[0] * other[0]).real


@compiled_loop
def _add_moved(
    one: np.ndarray,
    other: np.ndarray,
    a: complex,
    b: complex,
    slow: complex,
    fast: complex,
    out: np.ndarray,
) -> None:
    """Add what all of that changes by where the poles' time constants do, by `a` and `b`."""
    for left, right in ((a * one[1], other[0]), (one[0], b * other[1])):
        _add_last(left, right, out)
        _add_signal(left, right, slow, fast, out)


@compiled_loop
def _both_poles(constant: float, shape: float, interval: float) -> np.ndarray:
    """The recursion of two poles, with derivatives by time constant and shape, shape (3, 5).

    A value is made of the last two, of the signal now, and of the two before.
    """
    inner = 1.0 - 4.0 * shape
    apart = abs(inner) >= _NEARLY
    root = np.sqrt(complex(inner if apart else _NEARLY, 0.0))
    slow, fast = 0.5 + 0.5 / root, 0.5 - 0.5 / root
    one = _pole(0.5 * constant * (1 + root), interval)
    other = _pole(0.5 * constant * (1 - root), interval)
    by = np.zeros((3, 5))
    _add_last(one[0], other[0], by[0])
    _add_signal(one[0], other[0], slow, fast, by[0])
    # By the time constant, then by the shape.
    _add_moved(one, other, 0.5 * (1 + root), 0.5 * (1 - root), slow, fast, by[1])
    if apart:
        _add_moved(one, other, -constant / root, constant / root, slow, fast, by[2])
        turned = root**-3
        _add_signal(one[0], other[0], turned, -turned, by[2])
    return by


@compiled_loop
def _lowpassed(
    constant: float, shape: float, lanes: np.ndarray, interval: float, signal: np.ndarray
) -> np.ndarray:
    n, width = signal.shape
    by = _both_poles(constant, shape, interval)
    a, b, c, d, e = by[0]
    out = np.empty((n, width))
    # Column by column: a value then waits for nothing but the last one.
    for t in range(width):
        forced = np.zeros(n)
        for m in range(2):
            if t and lanes[m] == t:
                _add_recursion(by[m + 1], out[:, 0], signal[:, 0], forced)
        last = before = u = v = signal[0, t]
        out[0, t] = last
        for k in range(1, n):
            now = signal[k, t]
            rest = forced[k] + b * before + c * now + d * u + e * v
            before, last = last, a * last + rest
            out[k, t] = last
            v, u = u, now
    return out


@compiled_loop
def _add_recursion(by: np.ndarray, last: np.ndarray, signal: np.ndarray, out: np.ndarray) -> None:
    """Add what a recursion makes of a signal and its own last values, but for the first."""
    for k in range(1, out.size):
        before = max(k - 2, 0)
        out[k] += by[0] * last[k - 1] + by[1] * last[before]
        out[k] += by[2] * signal[k] + by[3] * signal[k - 1] + by[4] * signal[before]
