"""Effects that no torque and angle tell apart: which they are is found by fits, not declared."""

import numpy as np
import pytest

from identifiability.inference.fitting import fit
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.inference.starts import plain_values
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import SampledTorque

TIME = np.arange(600) / 500
JOINT = {"K": 20.0, "B": 0.8, "I": 0.08}
HIDDEN = {
    "series_tendon": {"stiffness": 60.0},
    "maxwell_branch": {"stiffness": 15.0, "time_constant": 0.04},
    "activation_lag": {"gain": 15.0, "time_constant": 0.05},
    "second_mass": {"inertia": 0.02, "frequency": 6.0, "damping_ratio": 0.3},
}
NEAR = 1e-4  # of the response: what two forms of one response differ by, once fitted
APART = 1.5e-3
# What mimics what, in any joint. A tendon is a Maxwell branch without damping beside it (Fung,
# ch. 2). A mass on a dashpot alone is a stiffness that arrives late, beside a stiffer and
# less damped joint: no form of its own, but a limit that probabilities have to tell apart.
MIMICS = {("maxwell_branch", "series_tendon"), ("second_mass", "activation_lag")}


def model_of(key):
    return KBI() + EFFECTS[key]()


def mimicked(key, hidden, joint):
    """Share of the response of a joint with a hidden effect that another effect leaves, fitted."""
    random = np.random.default_rng(1)
    torque = np.repeat(random.uniform(-2, 2, 30), 20)
    torque[:25] = 0.0
    drive = SampledTorque(torque).drive(TIME)
    truth = model_of(hidden)
    plain = dict(zip(truth.parameter_names, truth.nominal, strict=True))
    values = plain | joint | {f"{hidden}.{name}": v for name, v in HIDDEN[hidden].items()}
    response = simulate(truth, truth.vector(values), drive)
    model = model_of(key)
    scale = float(np.std(response))
    problem = Problem(
        model,
        [observe(drive, response, Noise(scale))],
        Prior.physical(model),
        fixed=plain_values(model, ()),
    )
    starts = []
    for factor in (0.3, 1.0, 3.0):
        start = dict(zip(model.parameter_names, model.nominal, strict=True)) | joint
        for name, parameter in model.parameters.items():
            if name not in joint and parameter.plain is None:
                start[name] = np.clip(factor * start[name], parameter.lower, parameter.upper)
        starts.append(problem.free_vector(start))
    found = fit(problem, np.array(starts))
    return float(np.sqrt(2 * found.cost / TIME.size))


@pytest.mark.parametrize("hidden", HIDDEN)
@pytest.mark.parametrize("key", HIDDEN)
def test_only_effects_of_one_form_mimic_each_other(key, hidden):
    left = mimicked(key, hidden, JOINT)
    assert left < NEAR if key == hidden or (key, hidden) in MIMICS else left > APART


def test_a_branch_without_damping_beside_it_is_a_tendon():
    assert mimicked("series_tendon", "maxwell_branch", JOINT | {"B": 0.0}) < NEAR


def test_every_effect_that_is_declared_of_one_form_is_tried_here():
    declared = {key for key, effect in EFFECTS.items() if effect.equivalent}
    assert declared == {"series_tendon", "maxwell_branch"}
    assert declared <= set(HIDDEN)
