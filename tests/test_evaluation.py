"""Likelihoods by machine code: those of JAX, at one point and at many, and their optima."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from kinds import BUMP, TIME, values_of
from oracles import agree

from identifiability.inference import evaluation
from identifiability.inference.conditional import conditional_optima, one_by_one
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.joint import response
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.native.duals import exponential
from identifiability.joint.response import simulate
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import (
    PERTURBATIONS,
    Impulse,
    SampledTorque,
    imposed_motion,
)
from identifiability.study.setting import Setting, measured_problem

TEAMS = {
    "K, B and I": (),
    "exact": ("series_tendon",),
    "integrated": ("nonlinear_tendon",),
    "delayed": ("stretch_reflex",),
    "recorded": ("sensor_delay", "sensor_drift", "sensor_lowpass"),
}
NOISE = Noise(0.01, correlation_time=0.004)


def model_of(team):
    model = KBI()
    for key in TEAMS[team]:
        model = model + EFFECTS[key]()
    return model


def problem_of(team, driven):
    """Two noisy trials of unlike lengths and intervals, with gaps and unknown constants."""
    model, rng = model_of(team), np.random.default_rng(3)
    observations = []
    for n, interval in ((160, 1e-3), (100, 2e-3)):
        time = interval * np.arange(n)
        shape = np.interp(time, TIME, BUMP)
        drive = {
            "torque": lambda time, shape: SampledTorque(10 * shape).drive(time),
            "angle": lambda time, shape: imposed_motion(time, 0.05 * shape),
            "impulse": lambda time, _: Impulse(0.5, onset=0.01).drive(time),
        }[driven](time, shape)
        measured = simulate(model, values_of(model), drive) + 0.01 * rng.standard_normal(n)
        chosen = np.flatnonzero(np.arange(n) % 7 != 3)
        segment = (chosen > n // 2).astype(int)
        observations.append(observe(drive, measured, NOISE, select=chosen, segment=segment))
    return Problem(model, observations, Prior.physical(model))


def nearby(one, n):
    """Points near the values that made the trials."""
    rng = np.random.default_rng(4)
    return values_of(one.model) * (1 + 0.05 * rng.uniform(-1, 1, (n, one.template.size)))


@pytest.mark.parametrize("driven", ["torque", "angle", "impulse"])
@pytest.mark.parametrize("team", TEAMS)
def test_many_points_are_as_one_by_one(team, driven):
    one = problem_of(team, driven)
    points = nearby(one, 20)
    alone = [-0.5 * np.sum(one.residuals(x) ** 2) for x in points]
    np.testing.assert_allclose(one.log_likelihood(points), alone, rtol=1e-9)


@pytest.mark.parametrize("correlation_time", [0.0, 0.01])
@pytest.mark.parametrize("perturbation", list(PERTURBATIONS))
def test_a_joint_alone_without_offsets_is_as_with_derivatives(perturbation, correlation_time):
    """It has a loop of its own: studies ask for it a thousand million times."""
    setting = Setting(32.0, 3.2, 100.0)
    one = measured_problem(
        setting, PERTURBATIONS[perturbation](), 0.1, correlation_time=correlation_time
    )
    points = setting.starts()
    alone = [-0.5 * np.sum(one.residuals(x) ** 2) for x in points]
    np.testing.assert_allclose(one.log_likelihood(points), alone, rtol=1e-9)
    several = replace(one, observations=one.observations * 2)
    np.testing.assert_allclose(several.log_likelihood(points), 2 * np.array(alone), rtol=1e-9)


# What JAX takes ten seconds to compile is held against it by the contract of effects.
@pytest.mark.parametrize("driven", ["torque", "angle"])
@pytest.mark.parametrize("team", ["K, B and I", "recorded"])
def test_they_are_those_of_jax(team, driven, monkeypatch):
    one, points = problem_of(team, driven), None
    points = nearby(one, 3)
    found = one.log_likelihood(points), one.residuals(points[0]), one.jacobian(points[0])
    monkeypatch.setattr(response, "responses_of", lambda *_: None)
    other = problem_of(team, driven)
    assert other.solved(points, np.ones(points.shape[1], bool)) is None
    np.testing.assert_allclose(found[0], other.log_likelihood(points), rtol=1e-9)
    agree(found[1], other.residuals(points[0]), 1e-9)
    agree(found[2], other.jacobian(points[0]), 1e-8)


@pytest.mark.parametrize("driven", ["torque", "angle"])
@pytest.mark.parametrize("team", ["K, B and I", "integrated", "recorded"])
def test_optima_are_those_of_scipy(team, driven):
    one = problem_of(team, driven)
    free = {
        name: value
        for name, value in zip(one.model.parameter_names, values_of(one.model), strict=True)
        if name not in ("K", "B", "I")
    }
    few = Problem(one.model, one.observations, one.prior, fixed=free)
    points = nearby(one, 4)[:, :3]
    found, expected = (solve(few, (0,), points) for solve in (conditional_optima, one_by_one))
    np.testing.assert_array_equal(found.points[:, 0], points[:, 0])
    np.testing.assert_allclose(found.log_likelihood, expected.log_likelihood, atol=2e-3)
    np.testing.assert_allclose(found.information, expected.information, rtol=0.05)


def test_a_response_without_bound_has_no_likelihood():
    one = problem_of("K, B and I", "torque")
    wild = one.template.copy()
    wild[1] = -1e4
    found = one.log_likelihood(np.array([wild, one.template]))
    assert found[0] == -np.inf
    assert np.isfinite(found[1])


def test_threads_share_the_points(monkeypatch):
    one = problem_of("exact", "torque")
    points = nearby(one, 41)
    together = one.log_likelihood(points)
    monkeypatch.setattr(evaluation, "THREADS", 3)
    monkeypatch.setattr(evaluation, "_WORTH_THREADS", 0)
    np.testing.assert_array_equal(one.log_likelihood(points), together)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.1, 0.5, 3.0, 40.0])
@pytest.mark.parametrize("width", [1, 4])
def test_exponentials_of_all_sizes_and_their_derivatives(size, width):
    rng = np.random.default_rng(5)
    matrix = np.zeros((3, 3, width))
    matrix[:, :, 0] = size * rng.uniform(-0.5, 0.5, (3, 3))
    matrix[:, :, 1:] = rng.uniform(-1, 1, (3, 3, width - 1))
    found = exponential(matrix)
    value = scipy.linalg.expm(matrix[:, :, 0])
    np.testing.assert_allclose(found[:, :, 0], value, atol=1e-13 * np.abs(value).max())
    for t in range(1, width):
        expected = scipy.linalg.expm_frechet(matrix[:, :, 0], matrix[:, :, t])[1]
        np.testing.assert_allclose(found[:, :, t], expected, atol=1e-12 * np.abs(expected).max())
