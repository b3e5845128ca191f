"""Angle, velocity and acceleration of an imposed angle, as its samples tell them."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from identifiability.errors import InputError
from identifiability.measurement.perturbations import MOTION_DEGREE, imposed_motion

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
