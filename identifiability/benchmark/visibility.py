"""Whether a hidden effect matters: what is left when everything else is fitted without it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import optimize, signal

from identifiability.benchmark.joints import Joint
from identifiability.benchmark.protocol import INTERVAL, Load, responses

Responses = Callable[[np.ndarray], Sequence[np.ndarray]]


def kbi_responses(
    loads: Sequence[Load], stiffness: float, damping: float, inertia: float
) -> list[np.ndarray]:
    """Angles (rad) of a joint of stiffness, damping and inertia alone, arrays of shape (n,).

    Exact, because the torques are linear between their samples.
    """
    system = ([1.0], [inertia, damping, stiffness])
    numerator, denominator, _ = signal.cont2discrete(system, INTERVAL, method="foh")
    return [signal.lfilter(numerator.ravel(), denominator, load.torque) for load in loads]


def missed_by_kbi(joint: Joint, loads: Sequence[Load], angles: Sequence[np.ndarray]) -> float:
    """Error of stiffness, damping and inertia fitted to all trials.

    Parameters
    ----------
    joint : Joint
        The joint, whose anatomy is where the fit starts.
    loads : sequence of Load
    angles : sequence of arrays
        Angles (rad) of the joint under these loads, without noise.

    Returns
    -------
    float
        Energy of the difference over energy of the angle, mean over the trials.
    """
    anatomy = joint.anatomy
    start = np.log([anatomy.stiffness, anatomy.damping, anatomy.inertia])

    def fitted(logs: np.ndarray) -> list[np.ndarray]:
        return kbi_responses(loads, *np.exp(logs))

    # A tendon takes most of the muscle's damping away, hence the second start.
    return min(_misfit(fitted, angles, start + [0.0, shift, 0.0]) for shift in (0.0, -1.0))


def missed_without(
    key: str, joint: Joint, loads: Sequence[Load], angles: Sequence[np.ndarray]
) -> float:
    """Error of the joint without one of its effects, stiffness, damping and inertia refitted.

    The other effects keep their values. Parameters and result as of `missed_by_kbi`.
    """
    rest = joint.without(key)

    def fitted(logs: np.ndarray) -> list[np.ndarray]:
        return responses(rest.scaled(*np.exp(logs)), tuple(loads))

    return _misfit(fitted, angles, np.zeros(3), evaluations=24)


def _misfit(
    fitted: Responses,
    angles: Sequence[np.ndarray],
    start: np.ndarray,
    evaluations: int = 120,
) -> float:
    norms = [np.sqrt(angle @ angle * len(angles)) for angle in angles]

    def residuals(logs: np.ndarray) -> np.ndarray:
        near = np.clip(logs, start - 3.0, start + 3.0)
        return np.concatenate(
            [(y - angle) / norm for y, angle, norm in zip(fitted(near), angles, norms, strict=True)]
        )

    found = optimize.least_squares(
        residuals, start, method="lm", diff_step=1e-5, max_nfev=evaluations
    )
    return float(2.0 * found.cost)
