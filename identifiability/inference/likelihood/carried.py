"""Noise of one channel as it appears in the other, carried over by the joint."""

from __future__ import annotations

import numpy as np
import scipy.signal
from scipy.interpolate import BSpline

from identifiability.inference.likelihood.processes import Process
from identifiability.measurement.perturbations import MOTION_DEGREE, imposed_motion

# The derivatives of a spline of degree 7 fall by 0.54 with every sample that another is away.
_REACH = 15
_ROOM = 10
# A joint without stiffness or damping has no stationary noise: a slow and hardly damped one has.
_SLOWEST_HZ, _LEAST_DAMPING = 0.3, 0.05


def motion_taps(interval: float) -> np.ndarray:
    """Angle, velocity and acceleration of an imposed angle that is 1 at one sample.

    Parameters
    ----------
    interval : float
        Sampling interval [s].

    Returns
    -------
    array, shape (31, 3)
        As `imposed_motion` interpolates it, centred.
    """
    n = 2 * (_REACH + _ROOM) + 1
    unit = np.zeros(n)
    unit[n // 2] = 1.0
    signals = imposed_motion(interval * np.arange(n), unit).signals
    return np.asarray(signals[_ROOM:-_ROOM])


def by_impedance(joint: np.ndarray, interval: float) -> Process:
    """Torque that white noise of an imposed angle adds: K, B and I times its derivatives.

    Parameters
    ----------
    joint : array, shape (3,)
        K, B and I.
    interval : float
        Sampling interval [s].

    Returns
    -------
    Process
        [Nm], for an angle's noise of 1 rad.

    Notes
    -----
    The spline through samples is a filter that looks ahead as far as it looks back. This one has
    the same spectrum and looks back alone, so that few of its samples say all: those of a B-spline
    over its values at the samples (Unser, Aldroubi & Eden 1993, IEEE Trans Signal Process
    41:821-833), each root of which that lies inside the unit circle stands for its inverse too.
    """
    basis = BSpline.basis_element(np.arange(MOTION_DEGREE + 2.0))
    at = np.arange(1.0, MOTION_DEGREE + 1)
    roots = np.roots(basis(at))
    half = np.real(np.poly(roots[np.abs(roots) < 1]))
    moving = np.column_stack([basis(at, nu) / interval**nu for nu in range(3)]) @ joint
    return Process(np.convolve(half, half), np.sum(half) ** 2 * moving)


def by_admittance(joint: np.ndarray, interval: float) -> Process:
    """Angle that white noise of the torque on the joint adds.

    Parameters
    ----------
    joint : array, shape (3,)
        K, B and I. One slower than 0.3 Hz or less damped than 0.05 is taken to be so fast and so
        damped: noise of a joint that nothing holds never becomes stationary.
    interval : float
        Sampling interval [s].

    Returns
    -------
    Process
        [rad], for a torque of 1 Nm, linear between samples.
    """
    inertia = float(joint[2])
    stiffness = max(float(joint[0]), inertia * (2 * np.pi * _SLOWEST_HZ) ** 2)
    damping = max(float(joint[1]), 2 * _LEAST_DAMPING * np.sqrt(stiffness * inertia))
    ma, ar, _ = scipy.signal.cont2discrete(
        ([1.0], [inertia, damping, stiffness]), interval, method="foh"
    )
    return Process(np.asarray(ar).ravel(), np.asarray(ma).ravel())
