"""One setting of the musculoskeletal model, and the problems of fitting KBI to its response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identifiability.errors import InputError
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise, Reading, matched_noise
from identifiability.measurement.perturbations import Drive, Perturbation
from identifiability.study.approximations import high_frequency, low_frequency

MSM = KBI() + SeriesTendon()


@dataclass(frozen=True)
class Setting:
    """Parameters of the musculoskeletal model (Eq. 1).

    Attributes
    ----------
    K_CE : float
        Stiffness of the contractile element [Nm/rad].
    B_CE : float
        Damping of the contractile element [Nms/rad].
    K_SE : float
        Stiffness of the tendon [Nm/rad].
    I : float
        Inertia [kg m²].
    """

    K_CE: float
    B_CE: float
    K_SE: float
    I: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"found {name} = {value}, expected a number above 0")

    def response(self, drive: Drive) -> np.ndarray:
        """Angle [rad] of the musculoskeletal model, shape (n,)."""
        vector = MSM.vector(
            {"K": self.K_CE, "B": self.B_CE, "I": self.I, "series_tendon.stiffness": self.K_SE}
        )
        return simulate(MSM, vector, drive)

    def starts(self) -> np.ndarray:
        """Starts for a fit of KBI: both analytical approximations and what lies between, (4, 3)."""
        low, high = low_frequency(self), high_frequency(self)
        stiffness, damping = np.array([low[0], high[0]]), np.array([low[1], high[1]])
        middle = np.sqrt([stiffness.prod(), damping.prod()])
        return np.array(
            [
                [*low, 0.7 * self.I],
                [*high, self.I],
                [*middle, 0.95 * self.I],
                [middle[0], 0.2 * middle[1], self.I],
            ]
        )


def error_problem(
    setting: Setting, perturbation: Perturbation, window: float, *, prior: Prior | None = None
) -> Problem:
    """Problem whose cost is half the paper's error criterion E (Eq. 3).

    The integrals over time are taken by Simpson's rule with at least 400 intervals.

    Parameters
    ----------
    setting : Setting
    perturbation : Perturbation
    window : float
        T [s], a multiple of 1 ms.
    prior : Prior, optional
        Bounds of the fit; the physical ones by default.

    Returns
    -------
    Problem
        With ``E = 2 * cost``, and the Hessian of E twice that of the problem.
    """
    samples = _milliseconds(window)
    intervals = samples * max(2, 2 * -(-200 // samples))
    time = np.linspace(0, window, intervals + 1)
    weights = np.ones(intervals + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    drive = perturbation.drive(time)
    response = setting.response(drive)
    scale = Noise(float(np.sqrt(np.sum(weights * response**2))))
    model = KBI()
    return Problem(
        model,
        [observe(drive, response, scale, weights=weights)],
        prior or Prior.physical(model),
    )


def measured_problem(
    setting: Setting,
    perturbation: Perturbation,
    window: float,
    *,
    reading: Reading = "contour",
    dE: float = 1e-3,
    correlation_time: float = 0.0,
    rate: float = 1000.0,
    prior: Prior | None = None,
    seed: int | None = None,
) -> Problem:
    """Problem of fitting KBI to a sampled response with noise matched to dE.

    Parameters
    ----------
    setting : Setting
    perturbation : Perturbation
    window : float
        T [s]; the samples at both ends are included.
    reading : {"contour", "energy"}
        See `matched_noise`.
    dE : float
        Error that the noise is matched to.
    correlation_time : float
        Of the noise [s]; 0 for white noise.
    rate : float
        Sampling rate [Hz].
    prior : Prior, optional
        Uniform within the physical bounds by default.
    seed : int, optional
        Seed of a noise realisation that is added to the response. Without it the response is
        noise-free and the noise enters the likelihood only: the expected measurement.

    Returns
    -------
    Problem
    """
    intervals = round(window * rate)
    if intervals < 3 or abs(intervals - window * rate) > 1e-6:
        raise InputError(
            f"found a window of {window:g} s at {rate:g} Hz, expected at least three whole samples"
        )
    time = np.linspace(0, window, intervals + 1)
    drive = perturbation.drive(time)
    response = setting.response(drive)
    noise = matched_noise(response, reading, dE=dE, correlation_time=correlation_time)
    measured = response
    if seed is not None:
        measured = response + noise.draw(response.size, 1 / rate, seed)
    model = KBI()
    return Problem(model, [observe(drive, measured, noise)], prior or Prior.physical(model))


def _milliseconds(window: float) -> int:
    samples = round(window * 1000)
    if samples < 1 or abs(samples - window * 1000) > 1e-6:
        raise InputError(f"found a window of {window:g} s, expected a multiple of 1 ms")
    return samples
