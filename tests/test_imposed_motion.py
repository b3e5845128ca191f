"""Angle, velocity and acceleration of an imposed angle, as its samples tell them."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from identifiability.errors import InputError
from identifiability.measurement.perturbations import MOTION_DEGREE, imposed_motion, propagator

INTERVAL = 0.01
TIME = INTERVAL * np.arange(201)


@pytest.mark.parametrize(("samples_a_cycle", "most"), [(8, 2e-5), (4, 2e-3)])
def test_derivatives_of_a_sine(samples_a_cycle, most):
    frequency = 2 * np.pi / (samples_a_cycle * INTERVAL)
    angle = np.sin(frequency * TIME + 0.3)
    true = np.column_stack(
        [angle, frequency * np.cos(frequency * TIME + 0.3), -(frequency**2) * angle]
    )
    inside = slice(50, 151)
    found = imposed_motion(TIME, 0.7 + angle).signals - [0.7, 0, 0]
    error = np.max(np.abs(found - true)[inside], axis=0) / np.max(np.abs(true), axis=0)
    assert np.all(error < most)
    # The control: a spline of degree five is out by ten times as much.
    fewer = make_interp_spline(TIME, angle, k=MOTION_DEGREE - 2)(TIME, 2) - true[:, 2]
    assert np.max(np.abs(fewer[inside])) > 8 * error[2] * frequency**2


def test_a_held_angle_does_not_move():
    found = imposed_motion(TIME, np.full(TIME.size, 0.7)).signals
    assert np.array_equal(found, np.tile([0.7, 0.0, 0.0], (TIME.size, 1)))


def test_derivatives_chain_into_each_other():
    drive = imposed_motion(TIME, np.sin(5 * TIME))
    assert np.array_equal(drive.generator, np.eye(MOTION_DEGREE + 1, k=1))


def test_too_few_samples():
    with pytest.raises(InputError, match="imposed angle of 7 samples, expected at least 8"):
        imposed_motion(TIME[:7], TIME[:7])


def test_states_within_an_interval_are_those_of_the_spline():
    """To rounding: the smallest entries of what takes them there meet the largest states."""
    time = np.arange(250) / 500
    angle = 0.05 * np.sin(2 * np.pi * 3 * time) ** 3 + 0.025 * np.sin(2 * np.pi * 11 * time) ** 3
    drive = imposed_motion(time, angle)
    spline = make_interp_spline(time, angle, k=MOTION_DEGREE)

    def missed(onward, after, order):
        found = drive.states[:-1] @ (drive.readout @ onward)[order]
        expected = spline(time[:-1] + after, order)
        return np.max(np.abs(found - expected)) / np.max(np.abs(expected))

    for after in drive.interval * np.array([0.125, 0.5, 1.0]):
        onward = propagator(drive.generator, after)
        assert max(missed(onward, after, order) for order in range(3)) < 1e-12
    # The control: the smallest of the entries a fifth too large.
    onward[0, -1] *= 1.2
    assert missed(onward, after, 0) > 1e-10


def test_states_of_an_oscillation_go_on_as_it_does():
    w, time = 12.0, 0.1
    turn = propagator(np.array([[0.0, w], [-w, 0.0]]), time)
    expected = [[np.cos(w * time), np.sin(w * time)], [-np.sin(w * time), np.cos(w * time)]]
    assert np.max(np.abs(turn - expected)) < 1e-15
    assert propagator(np.zeros((0, 0)), 1.0).shape == (0, 0)
