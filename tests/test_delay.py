"""Delayed feedback against the method of steps: responses, convergence, the delay's derivative."""

from functools import partial

import jax
import numpy as np
import pytest
from oracles import agree, central_difference, method_of_steps

from identifiability.errors import InputError
from identifiability.joint.effects.base import Effect
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.integrator import integrate
from identifiability.joint.model import KBI
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import drive_arrays, simulate
from identifiability.joint.scheme import EXACT, Scheme
from identifiability.measurement.perturbations import (
    Impulse,
    SampledTorque,
    Sinusoid,
    imposed_motion,
)

PARAMETERS = (
    Parameter("angle_gain", "g", "Nm/rad", 1.0, -500.0, 500.0, "gain on the angle", null=0.0),
    Parameter("velocity_gain", "h", "Nms/rad", 1.0, -50.0, 50.0, "gain on the velocity", null=0.0),
    Parameter("delay", "d", "s", 0.02, 0.0, 0.2, "loop delay"),
)


class Feedback(Effect):
    """Torque in proportion to the angle and velocity one delay ago."""

    key = "feedback"
    title = "delayed feedback"
    place = "joint"
    linear = True
    parameters = PARAMETERS

    def torque(self, p, motion, states, delayed):
        return p[0] * delayed.angle + p[1] * delayed.velocity

    def delay(self, p):
        return p[2]


class MuscleFeedback(Feedback):
    """The same, in series with a tendon."""

    key = "muscle_feedback"
    place = "muscle"


TIME = np.linspace(0.0, 0.1, 101)
MODEL = KBI() + Feedback()
K, B, I = 50.0, 1.0, 0.1
GAINS = {"angle": (60.0, 0.0), "velocity": (0.0, 2.0)}
# Each as a perturbation, the torque after 0, and the velocity that it starts with.
TORQUES = {
    "impulse": (Impulse(1.0), lambda t: 0.0, 1.0 / I),
    "step": (SampledTorque(np.full(TIME.size, 3.0), hold="zero-order"), lambda t: 3.0, 0.0),
    "sinusoid": (Sinusoid(period=0.1), lambda t: 20 * np.sin(2 * np.pi * t / 0.1), 0.0),
}


def theta(feedback, delay):
    return np.array([K, B, I, *GAINS[feedback], delay])


def by_steps(feedback, torque, delay, time=TIME):
    angle_gain, velocity_gain = GAINS[feedback]
    _, applied, velocity = TORQUES[torque]

    def rates(now, x, past):
        back = angle_gain * past[0] + velocity_gain * past[1]
        return [x[1], (applied(now) - B * x[1] - K * x[0] - back) / I]

    return method_of_steps(rates, [0.0, velocity], time, delay)[0]


def respond(feedback, torque, delay, substeps):
    drive = TORQUES[torque][0].drive(TIME)
    return simulate(MODEL, theta(feedback, delay), drive, scheme=Scheme(substeps))


def errors(feedback, torque, delay, substeps):
    expected = by_steps(feedback, torque, delay)
    size = np.max(np.abs(expected))
    return [np.max(np.abs(respond(feedback, torque, delay, n) - expected)) / size for n in substeps]


def test_without_delay_the_oracle_and_the_model_are_kbi():
    expected = simulate(KBI(), (K, B + 2.0, I), Impulse().drive(TIME))
    agree(by_steps("velocity", "impulse", 1e-9, np.array([0.0, 2e-9])), [0.0, 2e-8], 1e-6)
    agree(respond("velocity", "impulse", 0.0, 2), expected, 1e-4)
    assert not MODEL.linear
    with pytest.raises(InputError):
        simulate(MODEL, theta("velocity", 0.02), Impulse().drive(TIME), scheme=EXACT)


# An impulse makes the velocity jump, and with it the torque of a velocity feedback one delay later.
SMOOTH_ENOUGH = [(f, t) for f in GAINS for t in TORQUES if (f, t) != ("velocity", "impulse")]


@pytest.mark.parametrize(("feedback", "torque"), SMOOTH_ENOUGH)
def test_a_delay_of_whole_steps_converges_with_the_fourth_power(feedback, torque):
    coarse, fine = errors(feedback, torque, 0.02, (1, 2))
    assert coarse < 1e-7
    assert 12 < coarse / fine < 20


@pytest.mark.parametrize("delay", [0.02, 0.0203, 0.0007])
def test_a_delayed_jump_of_the_torque_converges(delay):
    coarse, fine = errors("velocity", "impulse", delay, (1, 4))
    assert coarse < 5e-3
    assert coarse / fine > 10


@pytest.mark.parametrize("torque", ["step", "sinusoid"])
@pytest.mark.parametrize("feedback", GAINS)
@pytest.mark.parametrize("delay", [0.0203, 0.0007])
def test_a_delay_between_steps(feedback, torque, delay):
    coarse, middle, fine = errors(feedback, torque, delay, (1, 2, 4))
    # A delayed corner inside a step costs order; a smooth torque has none to speak of.
    assert fine < (1e-6 if torque == "step" else 2e-9)
    assert coarse / fine > 5
    assert middle < 1.1 * coarse


@pytest.mark.parametrize("feedback", GAINS)
def test_a_delay_shorter_than_a_step(feedback):
    for torque in ("step", "sinusoid"):
        coarse, fine = errors(feedback, torque, 0.0003, (1, 4))
        assert coarse < 1e-4
        assert fine < 1e-6
        undelayed = np.max(np.abs(respond(feedback, torque, 0.0, 4)))
        moved = np.max(
            np.abs(respond(feedback, torque, 0.0003, 4) - respond(feedback, torque, 0, 4))
        )
        # The error is far below what the short delay itself changes.
        assert coarse * undelayed < 0.1 * moved


@partial(jax.jit, static_argnums=0)
def jacobian(substeps, values, arrays):
    return jax.jacfwd(lambda x: integrate(MODEL, x, arrays, substeps))(values)


@pytest.mark.parametrize("torque", TORQUES)
@pytest.mark.parametrize("feedback", GAINS)
@pytest.mark.parametrize("delay", [0.0203, 0.0007])
def test_derivatives_are_those_of_the_delay_equation(feedback, torque, delay):
    if (feedback, torque) == ("velocity", "impulse"):
        pytest.skip("the delayed velocity jumps: no derivative of the steps sees a jump move")
    drive, values = TORQUES[torque][0].drive(TIME), theta(feedback, delay)
    derivative = np.asarray(jacobian(4, values, drive_arrays(drive)))
    ends = [by_steps(feedback, torque, delay + shift) for shift in (-1e-5, 1e-5)]
    # First order where a delayed corner of the torque falls inside a step.
    agree(derivative[:, 5], (ends[1] - ends[0]) / 2e-5, 1e-4 if torque == "sinusoid" else 5e-3)

    def model(x):
        return simulate(MODEL, x, drive, scheme=Scheme(4))

    differences = central_difference(model, values, [1.0, 1.0, 0.1, 1.0, 1.0, 1e-3], 1e-3)
    for column in range(5):
        agree(derivative[:, column], differences[:, column], 1e-7)


def test_a_muscle_with_a_tendon_gets_the_joints_delayed_motion():
    delay, gain, stiffness, damping, tendon = 0.02, 2.0, 32.0, 3.2, 100.0
    model = KBI() + MuscleFeedback() + SeriesTendon()

    def rates(now, x, past):
        angle, velocity, element = x
        tension = tendon * (angle - element)
        torque = TORQUES["sinusoid"][1](now)
        back = gain * past[1]
        return [
            velocity,
            (torque - tension) / I,
            (tension - stiffness * element - back) / damping,
        ]

    expected = method_of_steps(rates, np.zeros(3), TIME, delay)[0]
    values = np.array([stiffness, damping, I, 0.0, gain, delay, tendon, 0.0, 0.0])
    assert model.parameter_names[3] == "muscle_feedback.angle_gain"
    found = simulate(model, values, TORQUES["sinusoid"][0].drive(TIME), scheme=Scheme(2))
    agree(found, expected, 1e-7)


# The imposed angle


def test_torque_of_an_imposed_cubic_motion_is_exact():
    cubic = np.polynomial.Polynomial([0.02, 0.0, -8.0, 90.0])
    drive = imposed_motion(TIME, cubic(TIME))
    for delay in (0.0, 0.0003, 0.0203, 0.02):
        # Before the record the angle was held where it begins.
        past = np.maximum(TIME - delay, 0.0)
        expected = K * cubic(TIME) + B * cubic.deriv()(TIME) + I * cubic.deriv(2)(TIME)
        expected += 60.0 * cubic(past) + 2.0 * cubic.deriv()(past)
        found = simulate(MODEL, np.array([K, B, I, 60.0, 2.0, delay]), drive)
        agree(found, expected, 1e-9)


def test_delay_of_an_imposed_motion_has_the_right_derivative():
    cubic = np.polynomial.Polynomial([0.02, 0.0, -8.0, 90.0])
    drive = imposed_motion(TIME, cubic(TIME))
    values = np.array([K, B, I, 60.0, 2.0, 0.0203])
    found = jacobian(4, values, drive_arrays(drive))[:, 5]
    past = TIME - 0.0203
    slope = 60.0 * cubic.deriv()(past) + 2.0 * cubic.deriv(2)(past)
    agree(found, np.where(past < 0, 0.0, -slope), 1e-9)


def test_both_causalities_tell_the_same_story():
    # A smooth torque, so that the spline through the angle is close to it.
    torque = SampledTorque(10 * np.sin(np.pi * TIME / 0.1) ** 4)
    values = theta("velocity", 0.0203)
    angle = simulate(MODEL, values, torque.drive(TIME), scheme=Scheme(4))
    found = simulate(MODEL, values, imposed_motion(TIME, angle))
    assert np.max(np.abs(found - torque.values)[5:-5]) < 0.01
    without = simulate(KBI(), values[:3], imposed_motion(TIME, angle))
    assert np.max(np.abs(without - torque.values)) > 1.0
