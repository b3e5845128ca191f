"""Answers found another way, which tests compare the package with: closed forms, ODEs, differences.

Nothing here uses the package.
"""

from itertools import pairwise

import numpy as np
import scipy.integrate
import scipy.signal


def agree(found, expected, rtol):
    """Fail unless the largest difference is at most `rtol` of the largest expected value."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape
    assert np.all(np.isfinite(found))
    assert np.max(np.abs(found - expected)) <= rtol * np.max(np.abs(expected))


def kbi_propagators(t, K, B, I):
    """Angle after a unit initial angle and after a unit initial velocity, for any damping.

    With ``s = r +/- delta`` the roots of ``I s² + B s + K``.
    """
    r = -B / (2 * I)
    delta = np.sqrt(np.asarray(B**2 / (4 * I**2) - K / I, complex))
    slow = np.exp((r + delta) * t)
    safe = np.where(delta == 0, 1, delta)
    from_velocity = slow * np.where(delta == 0, t, -np.expm1(-2 * safe * t) / (2 * safe))
    from_angle = slow * (1 + np.exp(-2 * delta * t)) / 2 - r * from_velocity
    return from_angle.real, from_velocity.real


def kbi_impulse(t, K, B, I, size=1.0):
    """Angle after a torque impulse at 0."""
    return size / I * kbi_propagators(t, K, B, I)[1]


def kbi_step(t, K, B, I, amplitude=1.0):
    """Angle after a torque step at 0; 0 before it."""
    since = np.maximum(t, 0.0)
    if K != 0:
        return amplitude / K * (1 - kbi_propagators(since, K, B, I)[0])
    if B != 0:
        return amplitude / B * (since + I / B * np.expm1(-B / I * since))
    return amplitude / I * since**2 / 2


def kbi_sinusoid(t, K, B, I, amplitude=20.0, period=0.03):
    """Angle under a sinusoidal torque that begins at 0."""
    w = 2 * np.pi / period
    gain = amplitude / (K - I * w**2 + 1j * w * B)
    from_angle, from_velocity = kbi_propagators(t, K, B, I)
    steady = (gain * np.exp(1j * w * t)).imag
    return steady - gain.imag * from_angle - (1j * w * gain).imag * from_velocity


def kbi_transfer(K, B, I):
    """Eq. 2 of Kistemaker & Rozendaal (2011): angle over torque."""
    return scipy.signal.lti([1.0], [I, B, K])


def msm_transfer(K, B, I, K_SE, K_P=0.0, B_P=0.0):
    """Eq. 1 of Kistemaker & Rozendaal (2011), and a path beside the muscle: angle over torque."""
    numerator = [B, K + K_SE]
    denominator = np.polyadd(np.polymul([B, K], [K_SE]), np.polymul([I, B_P, K_P], [B, K + K_SE]))
    return scipy.signal.lti(numerator, denominator)


def impulse_by_residues(system, t):
    """Impulse response of a transfer function with distinct poles."""
    poles = np.roots(system.den)
    residues = np.polyval(system.num, poles) / np.polyval(np.polyder(system.den), poles)
    return (np.exp(np.multiply.outer(t, poles)) @ residues).real


def msm_by_ode(t, K, B, I, K_SE, K_P, B_P, torque, edges=(), impulse=0.0):
    """Angle of the musculoskeletal model, as the third-order ODE of its transfer function.

    With x defined by ``den(d/dt) x = torque`` the angle is ``num(d/dt) x``. The integration stops
    and starts again at `edges`; `torque` is continuous from the right.
    """
    lead = I * B

    def rates(time, x, drive):
        rest = (I * (K + K_SE) + B_P * B) * x[2] + (K * K_SE + K_P * (K + K_SE)) * x[0]
        rest += (B * K_SE + K_P * B + B_P * (K + K_SE)) * x[1]
        return [x[1], x[2], (drive(time) - rest) / lead]

    stops = [t[0], *(e for e in edges if t[0] < e < t[-1]), t[-1]]
    x, angle = np.array([0.0, 0.0, impulse / lead]), np.zeros(len(t))
    for begin, end in pairwise(stops):
        # Just inside the section, so that a jump at its end is not felt before it.
        drive = _within(torque, begin, end)
        inside = (t >= begin - 1e-12) & (t <= end + 1e-12)
        result = scipy.integrate.solve_ivp(
            rates,
            (begin, end),
            x,
            method="DOP853",
            args=(drive,),
            t_eval=np.clip(t[inside], begin, end),
            rtol=1e-11,
            atol=1e-16,
            max_step=2e-3,
        )
        angle[inside] = B * result.y[1] + (K + K_SE) * result.y[0]
        x = result.y[:, -1]
    return angle


def _within(torque, begin, end):
    hair = 1e-9 * (end - begin)
    return lambda time: torque(min(max(time, begin + hair), end - hair))


def central_difference(function, x, size, relative=1e-5):
    """Derivatives of an array-valued function, last axis: parameters; error of fourth order."""
    x, columns = np.asarray(x, float), []
    for i, scale in enumerate(size):
        h = np.zeros_like(x)
        h[i] = relative * scale
        near = np.asarray(function(x + h)) - np.asarray(function(x - h))
        far = np.asarray(function(x + 2 * h)) - np.asarray(function(x - 2 * h))
        columns.append((8 * near - far) / (12 * h[i]))
    return np.stack(columns, axis=-1)


def by_ode(rates, start, t, edges=(), rtol=1e-11):
    """States of an ordinary differential equation, shape (states, n), stopping at `edges`."""
    stops = [t[0], *edges, t[-1]]
    x, found = np.asarray(start, float), np.zeros((len(start), len(t)))
    for begin, end in pairwise(stops):
        inside = (t >= begin - 1e-12) & (t <= end + 1e-12)
        result = scipy.integrate.solve_ivp(
            lambda time, x, end=end: rates(min(time, end - 1e-12), x),
            (begin, end),
            x,
            method="DOP853",
            t_eval=np.append(np.clip(t[inside], begin, end)[:-1], end),
            rtol=rtol,
            atol=1e-4 * rtol,
            max_step=1e-3,
        )
        found[:, inside] = result.y
        x = result.y[:, -1]
    return found


def method_of_steps(rates, start, t, delay, rtol=1e-12):
    """States of a delay differential equation that was at rest before 0, shape (states, n).

    ``rates(time, x, past)`` gets the states one delay ago. The integration stops and starts again
    at every multiple of the delay, where the past has its corners.
    """
    stops = np.append(np.arange(0.0, t[-1] - 1e-9 * delay, delay), t[-1])
    x, found, before = np.asarray(start, float), np.zeros((len(start), len(t))), None
    for begin, end in pairwise(stops):

        def section(time, x, before=before):
            past = np.zeros_like(x) if before is None else before(time - delay)
            return rates(time, x, past)

        result = scipy.integrate.solve_ivp(
            section,
            (begin, end),
            x,
            method="DOP853",
            rtol=rtol,
            atol=1e-3 * rtol,
            dense_output=True,
        )
        inside = (t >= begin - 1e-12) & (t <= end + 1e-12)
        if inside.any():
            found[:, inside] = result.sol(np.clip(t[inside], begin, end))
        x, before = result.y[:, -1], result.sol
    return found
