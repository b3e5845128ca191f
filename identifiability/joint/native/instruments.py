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
    for k in range(n):
        place = k - delay / interval
        base = math.floor(place)
        s = place - base
        share = (
            -s * (s - 1) * (s - 2) / 6,
            (s + 1) * (s - 1) * (s - 2) / 2,
            -(s + 1) * s * (s - 2) / 2,
            (s + 1) * s * (s - 1) / 6,
        )
        slope = (
            -(3 * s * s - 6 * s + 2) / 6,
            (3 * s * s - 4 * s - 1) / 2,
            -(3 * s * s - 2 * s - 2) / 2,
            (3 * s * s - 1) / 6,
        )
        for t in range(width):
            out[k, t] = 0.0
        for i in range(4):
            at = min(max(base - 1 + i, 0), n - 1)
            for t in range(width):
                out[k, t] += share[i] * signal[at, t]
            if lane:
                out[k, lane] -= slope[i] * signal[at, 0] / interval
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
def _pole(constant: complex, moved: np.ndarray, interval: float, signal: np.ndarray) -> np.ndarray:
    """One pole, of a time constant with its derivatives."""
    n, width = signal.shape
    there = abs(constant) >= _LEAST
    ratio = interval / (constant if there else complex(_LEAST, 0.0))
    gone = -_expm1(-ratio)
    kept, mean = 1.0 - gone, gone * constant / interval
    keeping, meaning = np.zeros(width, np.complex128), np.zeros(width, np.complex128)
    for t in range(1, width):
        turned = -ratio / constant * moved[t] if there else 0j
        keeping[t] = -kept * turned
        meaning[t] = kept * turned * constant / interval + gone * moved[t] / interval
    out = np.empty((n, width), np.complex128)
    for t in range(width):
        out[0, t] = signal[0, t]
    for k in range(1, n):
        last, next_ = signal[k - 1, 0], signal[k, 0]
        for t in range(width):
            out[k, t] = (
                kept * out[k - 1, t] + (mean - kept) * signal[k - 1, t] + (1 - mean) * signal[k, t]
            )
            if t:
                out[k, t] += keeping[t] * (out[k - 1, 0] - last) + meaning[t] * (last - next_)
    return out


@compiled_loop
def _lowpassed(
    constant: float, shape: float, lanes: np.ndarray, interval: float, signal: np.ndarray
) -> np.ndarray:
    n, width = signal.shape
    inner = 1.0 - 4.0 * shape
    apart = abs(inner) >= _NEARLY
    root = np.sqrt(complex(inner if apart else _NEARLY, 0.0))
    turned = np.zeros(width, np.complex128)
    slow, fast = np.zeros(width, np.complex128), np.zeros(width, np.complex128)
    if lanes[1] and apart:
        turned[lanes[1]] = -2.0 / root
    if lanes[0]:
        slow[lanes[0]], fast[lanes[0]] = 0.5 * (1 + root), 0.5 * (1 - root)
    for t in range(1, width):
        slow[t] += 0.5 * constant * turned[t]
        fast[t] -= 0.5 * constant * turned[t]
    one = _pole(0.5 * constant * (1 + root), slow, interval, signal)
    other = _pole(0.5 * constant * (1 - root), fast, interval, signal)
    out = np.empty((n, width))
    for k in range(n):
        parts = (1 + root) * one[k, 0] - (1 - root) * other[k, 0]
        out[k, 0] = (parts / (2 * root)).real
        for t in range(1, width):
            change = (1 + root) * one[k, t] - (1 - root) * other[k, t]
            change += turned[t] * (one[k, 0] + other[k, 0] - parts / root)
            out[k, t] = (change / (2 * root)).real
    return out
