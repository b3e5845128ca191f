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

    Exact, because the torques are linear between their samples: each of the two poles p makes of
    a linear torque ``u`` the response ``z' = p z + u``, and the angle is proportional to the
    difference of the two.
    """
    roots = np.sqrt(complex(damping**2 - 4.0 * stiffness * inertia)) * np.array([1.0, -1.0])
    poles = (roots - damping) / (2.0 * inertia)
    powers = poles * INTERVAL
    decays = np.exp(powers)
    before = INTERVAL * (decays * (powers - 1.0) + 1.0) / powers**2
    after = INTERVAL * (decays - 1.0 - powers) / powers**2
    numerator = (
        np.polymul([after[0], before[0]], [1.0, -decays[1]])
        - np.polymul([after[1], before[1]], [1.0, -decays[0]])
    ) / (inertia * (poles[0] - poles[1]))
    denominator = np.poly(decays)
    return [signal.lfilter(numerator.real, denominator.real, load.torque) for load in loads]


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
    return min(
        _misfit(fitted, angles, start + np.array([0.0, shift, 0.0])) for shift in (0.0, -1.0)
    )


def missed_without(
    key: str, joint: Joint, loads: Sequence[Load], angles: Sequence[np.ndarray]
) -> float:
    """Error of the joint without one of its effects, stiffness, damping and inertia refitted.

    The other effects keep their values. Parameters and result as of `missed_by_kbi`.
    """
    rest = joint.without(key)

    def fitted(logs: np.ndarray) -> list[np.ndarray]:
        try:
            return responses(rest.scaled(*np.exp(logs)), loads, rtol=1e-6)
        except ArithmeticError:  # it runs away, which is as good as no answer
            return [np.zeros(angle.size) for angle in angles]

    return _misfit(fitted, angles, np.zeros(3), evaluations=5)


def _misfit(
    fitted: Responses,
    angles: Sequence[np.ndarray],
    start: np.ndarray,
    evaluations: int = 40,
) -> float:
    norms = [np.sqrt(angle @ angle * len(angles)) for angle in angles]

    def residuals(logs: np.ndarray) -> np.ndarray:
        near = np.clip(logs, start - 3.0, start + 3.0)
        return np.concatenate(
            [(y - angle) / norm for y, angle, norm in zip(fitted(near), angles, norms, strict=True)]
        )

    found = optimize.least_squares(
        residuals, start, method="lm", diff_step=1e-3, max_nfev=evaluations
    )
    return float(2.0 * found.cost)
