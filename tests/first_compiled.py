"""Compile loops that most tests need, in a process of its own: `python first_compiled.py PART`."""

import sys

import numpy as np

from identifiability.inference.fitting import fit
from identifiability.inference.likelihood.estimate import Stretch, contenders, estimate_noise
from identifiability.inference.likelihood.processes import Process
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Step


def responses() -> None:
    """Responses of models, and what a fit makes of them."""
    drive, values = Step(amplitude=1.0).drive(np.arange(50) / 500), np.array([30.0, 1.0, 0.1])
    observed = observe(drive, simulate(KBI(), values, drive), Noise(1e-3))
    fit(Problem(KBI(), [observed], Prior.physical(KBI())), values[None])


def noises() -> None:
    """Noise of residuals, alone and beside one of known size."""
    random = np.random.default_rng(1)
    residual, slope = random.standard_normal(200), np.linspace(-1, 1, 200)[:, None]
    came_in = Process(np.ones(1), np.array([1.0, -1.0]))
    for beside in (None, np.ones(200)):
        stretches = [Stretch(residual, slope, 0, beside)]
        estimate_noise(stretches, came_in, contenders(carried=(True,))[:2], with_error=True)


PARTS = {"responses": responses, "noises": noises}

if __name__ == "__main__":
    PARTS[sys.argv[1]]()
