"""Each effect against its written-out equation: solved by SciPy, or in closed form."""

import jax
import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from oracles import agree, by_ode, impulse_by_residues, method_of_steps
from scipy import integrate, interpolate, stats

from identifiability.joint.effects import EFFECTS
from identifiability.joint.effects.base import Motion
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.perturbations import (
    Drive,
    Impulse,
    SampledTorque,
    Sinusoid,
    imposed_motion,
)

TIME = np.linspace(0.0, 0.1, 101)
INTERVAL = 1e-3
K, B, I = 50.0, 2.0, 0.1
SINUSOID = Sinusoid(period=0.1).drive(TIME)
# To 0.05 rad and back; the spline through its samples is the polynomial itself.
THERE_AND_BACK = 0.05 * 16e4 * np.polynomial.Polynomial([0, 0, 0.01, -0.2, 1.0])


def applied(t):
    return 20 * np.sin(2 * np.pi * t / 0.1)


def joint(*keys):
    model = KBI()
    for key in keys:
        model = model + EFFECTS[key]()
    return model


def values_of(model, K=K, B=B, I=I, **own):
    """Parameter vector; the only effect's parameters by their own names, others as nominal."""
    values = dict(zip(model.parameter_names, model.nominal, strict=True))
    values |= {"K": K, "B": B, "I": I}
    for name, value in own.items():
        values |= {full: value for full in values if full.split(".")[-1] == name}
    return model.vector(values)


def response(key, drive, *, scheme=None, K=K, B=B, I=I, **own):
    model = joint(key)
    return simulate(model, values_of(model, K, B, I, **own), drive, scheme=scheme)


def recorded(key, p, signal):
    return np.asarray(EFFECTS[key]().record(np.array(p), np.asarray(signal), INTERVAL))


def ramp(velocity):
    return imposed_motion(TIME, velocity * TIME)


def hill(w):
    """Change of a muscle's force when it lengthens at w maximal shortening velocities."""
    if w < 0:
        return (1 + w) / (1 - 4 * w) - 1
    return 0.4 * w / (w + 0.08)


def hill_torque(v, strength, fastest, asymmetry):
    pull, push = hill(v / fastest), hill(-v / fastest)
    return strength * ((1 + asymmetry) * pull - (1 - asymmetry) * push) / 2


def approach(gap):
    return gap / (0.02 if gap > 0 else 2.5 * 0.02)


def halfway(x, width):
    return 0.5 * (1 + x / np.hypot(x, width))


def stopped(q):
    """Rounded springs of 140 and 60 Nm/rad from 13 mrad on and from -7 mrad down."""
    above, below = q - 0.003 - 0.01, -(q - 0.003) - 0.01
    ends = ((x + np.sqrt(x * x + 0.004**2)) / 2 for x in (above, below))
    return 140 * next(ends) - 60 * next(ends)


def most(v):
    return 1 + 0.5 * np.exp(-((v / 0.3) ** 2))


def giving(v, z):
    """Rate of a contact's deflection, of which 3 mrad is the most, and the share that follows."""
    toward = np.tanh(v / 0.05)
    yielding = (v / toward if toward else 0.05) / 0.003 / most(v)
    share = 1 / np.hypot(1, yielding / 1000)
    return share * (v - yielding * z[0]), share


def rubbed(v, z):
    rate, share = giving(v, z)
    way = (share * z[0] / 0.003 + 3 * rate) / most(v) + (1 - share) * np.tanh(v / 0.05)
    if abs(way) > 1:
        way = np.sign(way) * (1 + 0.1 * np.tanh(10 * (abs(way) - 1)))
    return most(v) * way * (1 + 0.2 * way)


# Every effect in the joint without delay: its parameters, its number of states, its torque and the
# rates of its states as functions of angle, velocity and states.
OMEGA = 2 * np.pi * 12.0
EQUATIONS = {
    "activation_lag": (
        {"gain": 30.0, "time_constant": 0.02, "off_ratio": 2.5},
        2,
        lambda q, v, z: z[0] - z[1],
        lambda q, v, z: [approach(30 * max(x, 0.0) - a) for x, a in zip((q, -q), z, strict=True)],
    ),
    "coulomb_friction": (
        {
            "torque": 1.0,
            "velocity": 0.05,
            "range": 0.003,
            "damping": 3.0,
            "breakaway": 0.5,
            "breakaway_velocity": 0.3,
            "asymmetry": 0.2,
        },
        1,
        lambda q, v, z: rubbed(v, z),
        lambda q, v, z: [giving(v, z)[0]],
    ),
    "cubic_stiffness": (
        {"coefficient": 3000.0, "centre": -0.02},
        0,
        lambda q, v, z: 3000 * ((q + 0.02) ** 3 - 0.02**3 - 3 * 0.02**2 * q),
        lambda q, v, z: [],
    ),
    "damping_by_angle": (
        {"difference": 1.5, "width": 0.02, "middle": 0.01},
        0,
        lambda q, v, z: 1.5 * (halfway(q - 0.01, 0.02) - halfway(-0.01, 0.02)) * v,
        lambda q, v, z: [],
    ),
    "damping_by_direction": (
        {"difference": -1.0, "velocity": 0.3},
        0,
        lambda q, v, z: -1.0 * (np.hypot(v, 0.3) - 0.3),
        lambda q, v, z: [],
    ),
    "end_stop": (
        {"stiffness": 200.0, "angle": 0.01, "side": 0.4, "rounding": 0.004, "middle": 0.003},
        0,
        lambda q, v, z: stopped(q) - stopped(0.0) - q * np.imag(stopped(1e-30j)) / 1e-30,
        lambda q, v, z: [],
    ),
    "gravity": (
        {"moment": 40.0, "posture": 0.5},
        0,
        lambda q, v, z: 40 * (np.sin(0.5 + q) - np.sin(0.5)),
        lambda q, v, z: [],
    ),
    "hill_force_velocity": (
        {"strength": 10.0, "max_velocity": 5.0, "asymmetry": 0.4},
        0,
        lambda q, v, z: hill_torque(v, 10.0, 5.0, 0.4),
        lambda q, v, z: [],
    ),
    "maxwell_branch": (
        {"stiffness": 80.0, "time_constant": 0.02},
        1,
        lambda q, v, z: 80 * (q - z[0]),
        lambda q, v, z: [(q - z[0]) / 0.02],
    ),
    "quadratic_stiffness": (
        {"coefficient": 100.0, "hardening": 4.0},
        0,
        lambda q, v, z: 200 * (np.exp(4 * q) - 1 - 4 * q) / 16,
        lambda q, v, z: [],
    ),
    "second_mass": (
        {"inertia": 0.03, "frequency": 12.0, "damping_ratio": 0.2},
        2,
        lambda q, v, z: 0.03 * OMEGA * (OMEGA * (q - z[0]) + 0.4 * (v - z[1])),
        lambda q, v, z: [z[1], OMEGA * (OMEGA * (q - z[0]) + 0.4 * (v - z[1]))],
    ),
    "short_range_stiffness": (
        {"stiffness": 100.0, "range": 0.03, "sharpness": 3.0, "renewal": 20.0},
        1,
        lambda q, v, z: 100 * z[0],
        lambda q, v, z: [v - (z[0] * v > 0) * v * abs(z[0] / 0.03) ** 3 - 20 * z[0]],
    ),
}


@pytest.mark.parametrize("key", EQUATIONS)
def test_motion_under_a_torque_is_that_of_the_equation(key):
    own, n, torque, rates = EQUATIONS[key]

    def system(t, x):
        q, v, z = x[0], x[1], x[2:]
        return [v, (applied(t) - K * q - B * v - torque(q, v, z)) / I, *rates(q, v, z)]

    expected = by_ode(system, np.zeros(2 + n), TIME)[0]
    # Where friction turns round it has a corner, which falls inside a step.
    steps = Scheme(32 if key == "coulomb_friction" else 4)
    found = response(key, SINUSOID, scheme=None if joint(key).linear else steps, **own)
    agree(found, expected, 1e-6)
    # The equation is not that of the joint alone.
    assert np.max(np.abs(simulate(KBI(), (K, B, I), SINUSOID) - expected)) > 0.003


@pytest.mark.parametrize("key", EQUATIONS)
def test_torque_of_an_imposed_angle_is_that_of_the_equation(key):
    own, n, torque, rates = EQUATIONS[key]
    angle, velocity = THERE_AND_BACK, THERE_AND_BACK.deriv()
    states = np.zeros((n, TIME.size))
    if n:
        states = by_ode(lambda t, z: rates(angle(t), velocity(t), z), np.zeros(n), TIME)
    q, v, a = angle(TIME), velocity(TIME), angle.deriv(2)(TIME)
    alone = K * q + B * v + I * a
    expected = alone + [torque(*now) for now in zip(q, v, states.T, strict=True)]
    drive = imposed_motion(TIME, angle(TIME))
    agree(response(key, drive, **own), expected, 1e-6)
    assert np.max(np.abs(expected - alone)) > 0.1


# Linear effects


def test_transfer_functions():
    """Impulse responses by residues: angle over torque is the inverse of the impedance."""
    second, lag = np.array([I, B, K]), np.array([0.02, 1.0])
    k, c = 0.03 * OMEGA**2, 2 * 0.2 * 0.03 * OMEGA
    wobble = np.array([0.03, c, k])
    systems = {
        "activation_lag": (lag, np.polyadd(np.polymul(second, lag), [30.0])),
        "maxwell_branch": (lag, np.polyadd(np.polymul(second, lag), [80.0 * 0.02, 0.0])),
        "second_mass": (
            wobble,
            np.polyadd(np.polymul(second, wobble), np.polymul([0.03, 0.0, 0.0], [c, k])),
        ),
    }
    for key, (numerator, denominator) in systems.items():
        expected = impulse_by_residues(scipy.signal.lti(numerator, denominator), TIME)
        # As fast off as on, where activation has no one linear form.
        values = EQUATIONS[key][0] | ({"off_ratio": 1.0} if key == "activation_lag" else {})
        agree(response(key, Impulse(1.0).drive(TIME), **values), expected, 1e-9)


def test_a_linear_tendon_has_the_form_of_a_maxwell_branch():
    """(K + B s) K_SE / (K + B s + K_SE), in partial fractions: stiffness that relaxes from K_SE."""
    tendon = 120.0
    late = K * tendon / (K + tendon)
    expected = response("series_tendon", SINUSOID, stiffness=tendon)
    own = {"stiffness": tendon - late, "time_constant": B / (K + tendon)}
    agree(response("maxwell_branch", SINUSOID, K=late, B=0.0, **own), expected, 1e-9)


# Friction, force-velocity, short-range stiffness


def test_friction_while_sliding_is_constant():
    sliding = TIME > 0.03
    for speed in (-3.0, -1.0, 1.0, 3.0):
        own = {"torque": 0.7, "breakaway": 0.5, "asymmetry": 0.2}
        found = response("coulomb_friction", ramp(speed), **own)
        expected = np.full(TIME.size, 0.7 * np.sign(speed) * (1 + 0.2 * np.sign(speed)))
        agree((found - K * speed * TIME - B * speed)[sliding], expected[sliding], 1e-8)
    # Where it breaks away it is larger: at 0.1 rad/s by breakaway/e.
    own = {"torque": 0.7, "velocity": 0.002, "range": 2e-5, "breakaway": 0.5}
    found = response("coulomb_friction", ramp(0.1), K=0.0, B=0.0, **own)
    agree(found[sliding], np.full(TIME.size, 0.7 * (1 + 0.5 / np.e))[sliding], 1e-9)


def test_friction_dissipates_the_work_of_a_constant_torque():
    drive = imposed_motion(TIME, THERE_AND_BACK(TIME))
    own = {"torque": 0.7, "range": 2e-4, "damping": 15.0}
    torque = response("coulomb_friction", drive, K=0.0, B=0.0, I=1e-12, **own)
    power = torque * THERE_AND_BACK.deriv()(TIME)
    work = np.cumsum(0.5e-3 * (power[1:] + power[:-1]))
    np.testing.assert_allclose(work[-1], 0.7 * 2 * 0.05, rtol=0.01)
    # It gives back no more than its contact can hold as a spring.
    assert np.all(np.maximum.accumulate(work) - work < 0.5 * 0.7 * 2e-4)


def test_friction_holds_what_it_held_where_the_motion_ends():
    """Smoothed by its velocity alone it would fade; a creep far below that velocity is none."""
    end = 0.05
    rise = np.where(end > TIME, TIME / end, 1.0)
    there = imposed_motion(TIME, 0.02 * rise**3 * (10 - 15 * rise + 6 * rise**2))
    own = {"torque": 0.7, "velocity": 1e-4, "range": 1e-3}
    held = response("coulomb_friction", there, K=0.0, B=0.0, I=1e-12, **own)[end + 0.005 < TIME]
    agree(held, np.full(held.size, 0.7), 0.01)
    assert np.ptp(held) > 0.0
    faded = response("coulomb_friction", there, K=0.0, B=0.0, I=1e-12, **(own | {"velocity": 0.3}))
    assert faded[-1] < 1e-3


@pytest.mark.parametrize("velocity", [0.03, 0.1, 0.3])
def test_friction_without_give_is_a_function_of_the_velocity(velocity):
    drive = imposed_motion(TIME, THERE_AND_BACK(TIME))
    own = {"torque": 0.7, "velocity": velocity, "range": 2e-5}
    found = response("coulomb_friction", drive, K=0.0, B=0.0, I=1e-12, **own)
    share = 1 / np.hypot(1, velocity / 2e-5 / 1000)  # at rest, where it is largest
    expected = 0.7 * np.tanh(THERE_AND_BACK.deriv()(TIME) / velocity)
    assert np.max(np.abs(found - expected)) < 0.7 * share


def test_hill_relation_has_its_known_values():
    def torque(velocity, asymmetry):
        own = {"strength": 10.0, "max_velocity": 5.0, "asymmetry": asymmetry}
        return response("hill_force_velocity", ramp(velocity), K=0.0, B=0.0, **own)[0]

    # A single muscle: no force left at its fastest shortening, 1.4 times its force far beyond.
    np.testing.assert_allclose(torque(-5.0, 1.0), -10.0, rtol=1e-9)
    np.testing.assert_allclose(torque(5e5, 1.0), 4.0, rtol=1e-5)
    np.testing.assert_allclose(torque(5.0, -1.0), 10.0, rtol=1e-9)
    # One slope at rest, 1 + 1/0.25 from either side; a pair has the same.
    for velocity in (-5e-7, 5e-7):
        for asymmetry in (-1.0, 0.0, 0.3, 1.0):
            np.testing.assert_allclose(torque(velocity, asymmetry) / velocity, 10.0, rtol=1e-5)
    assert torque(0.0, 0.3) == 0.0
    # A balanced pair is odd in the velocity; damping saturates.
    assert torque(-3.0, 0.0) == -torque(3.0, 0.0)
    np.testing.assert_allclose(torque(3.0, 0.0), 5 * (hill(0.6) - hill(-0.6)), rtol=1e-9)


def test_short_range_stiffness_stretches_then_yields():
    # Yielding in proportion to the stretch has a closed form.
    own = {"stiffness": 100.0, "range": 0.02, "sharpness": 1.0, "renewal": 0.0}
    for speed in (-2.0, 2.0):
        found = response("short_range_stiffness", ramp(speed), K=0.0, B=0.0, **own)
        moved = np.abs(speed) * TIME
        expected = np.sign(speed) * 100 * 0.02 * (1 - np.exp(-moved / 0.02))
        agree(found, expected, 1e-6)
        # At 0.2 rad, ten times its range, it has yielded.
        np.testing.assert_allclose(np.abs(found[-1]), 2.0, rtol=1e-4)
    # Elastic for motion that is small beside its range.
    small = 1e-5 * np.sin(2 * np.pi * 20 * TIME) ** 2
    found = response(
        "short_range_stiffness",
        imposed_motion(TIME, small),
        K=0.0,
        B=0.0,
        I=1e-9,
        **own,
    )
    agree(found, 100 * small, 2e-3)


# The stretch reflex

GAINS = {"position_gain": 40.0, "velocity_gain": 2.0, "delay": 0.02, "time_constant": 0.015}


def imposed_step(size, back=None):
    """An angle that jumps to `size` at 20 ms, and back to 0 at a sample `back`."""
    states = np.zeros((TIME.size, 6))
    states[20:back, 0] = size
    return Drive(INTERVAL, np.eye(6, k=1), np.eye(6)[:3], states, np.zeros(TIME.size))


def reflex_torque(drive, **own):
    plain = {"asymmetry": 0.0, "threshold": 0.0, "off_ratio": 1.0, "damping_ratio": 1.0}
    gains = GAINS | plain | own
    return response("stretch_reflex", drive, K=0.0, B=0.0, **gains)


def second_order(time, tau):
    since = np.maximum(time, 0.0) / tau
    return 1 - (1 + since) * np.exp(-since)


def test_reflex_to_a_step_comes_late_and_rises_in_second_order():
    found = reflex_torque(imposed_step(0.1))
    assert np.all(found[:40] == 0.0)
    agree(found, 40 * 0.1 * second_order(TIME - 0.04, 0.015), 1e-9)
    # Less well where the jump arrives inside a step.
    found = reflex_torque(imposed_step(0.1), delay=0.0203)
    agree(found, 40 * 0.1 * second_order(TIME - 0.0403, 0.015), 1e-3)


@pytest.mark.parametrize("damping", [0.5, 0.8])
def test_reflex_activation_overshoots_as_its_damping_says(damping):
    """Closed form of an underdamped second-order system's answer to a step."""
    found = reflex_torque(imposed_step(0.1), damping_ratio=damping)
    since = np.maximum(TIME - 0.04, 0.0)
    natural = 1 / (damping * 0.015)
    turning = natural * np.sqrt(1 - damping**2)
    swing = np.cos(turning * since) + damping * natural / turning * np.sin(turning * since)
    agree(found, 40 * 0.1 * (1 - np.exp(-damping * natural * since) * swing), 1e-9)


def test_reflex_with_asymmetry_answers_one_direction_more():
    both = reflex_torque(imposed_step(0.1))
    for asymmetry, up, down in ((1.0, 1.0, 0.0), (-1.0, 0.0, 1.0), (0.4, 1.0, 0.6)):
        found = reflex_torque(imposed_step(0.1), asymmetry=asymmetry)
        np.testing.assert_allclose(found, up * both, atol=1e-12)
        found = reflex_torque(imposed_step(-0.1), asymmetry=asymmetry)
        np.testing.assert_allclose(found, -down * both, atol=1e-12)


def test_reflex_threshold_is_a_stretch_velocity():
    for speed in (-1.5, 1.5):
        silent = reflex_torque(ramp(speed), position_gain=0.0, threshold=1.6)
        np.testing.assert_allclose(silent, 0.0, atol=1e-9)
        found = reflex_torque(ramp(speed), position_gain=0.0, threshold=0.5)
        expected = np.sign(speed) * 2 * (1.5 - 0.5) * second_order(TIME - 0.02, 0.015)
        agree(found, expected, 1e-9)


def test_reflex_relaxes_more_slowly_than_it_rises():
    found = reflex_torque(imposed_step(0.1, back=50), off_ratio=3.0)
    up, down = 0.04, 0.07

    def rates(t, a):
        gaps = (4.0 if up <= t < down else 0.0) - a[0], a[0] - a[1]
        return [gap / (0.015 if gap > 0 else 0.045) for gap in gaps]

    agree(found, by_ode(rates, np.zeros(2), TIME, edges=(up, down))[1], 1e-5)
    assert found[-1] > 1.5 * reflex_torque(imposed_step(0.1, back=50))[-1]


def test_motion_with_a_reflex_is_that_of_the_delay_equation():
    refined = {"asymmetry": 0.4, "threshold": 0.3, "off_ratio": 2.0}

    def follow(target, state):
        gap = target - state
        return gap / (0.015 if gap > 0 else 0.03)

    def rates(t, x, past):
        signal = 40 * past[0] + 2 * past[1]
        pull, push = max(signal - 0.6, 0.0), 0.6 * max(-signal - 0.6, 0.0)
        torque = applied(t) - K * x[0] - B * x[1] - (x[3] - x[5])
        muscles = [follow(pull, x[2]), follow(x[2], x[3]), follow(push, x[4]), follow(x[4], x[5])]
        return [x[1], torque / I, *muscles]

    expected = method_of_steps(rates, np.zeros(6), TIME, 0.02, rtol=1e-9)[0]
    found = response("stretch_reflex", SINUSOID, **GAINS, **refined)
    # Its corners fall inside steps.
    agree(found, expected, 1e-5)
    assert np.max(np.abs(response("stretch_reflex", SINUSOID, **GAINS) - found)) > 1e-3


# The nonlinear tendon


def nonlinear_tension(x, stiffness, hardening, asymmetry):
    """Two exponential tendons, one taut at either side, of shares (1 +- asymmetry)/2."""
    pull, push = np.expm1(hardening * x), np.expm1(-hardening * x)
    return stiffness / hardening * ((1 + asymmetry) * pull - (1 - asymmetry) * push) / 2


@pytest.mark.parametrize("asymmetry", [-1.0, 0.0, 0.3, 1.0])
def test_nonlinear_tendon_is_a_pair_of_exponential_tendons(asymmetry):
    effect, stretch = EFFECTS["nonlinear_tendon"](), np.linspace(-0.1, 0.1, 21)
    for hardening in (1e-3, 10.0, 60.0):
        p = (200.0, hardening, asymmetry)
        found = effect.torque(p, Motion(stretch, 0.0), np.zeros(0), Motion(0.0, 0.0))
        agree(found, nonlinear_tension(stretch, *p), 1e-10)


def test_nonlinear_tendon_has_derivatives_without_hardening():
    effect, stretch = EFFECTS["nonlinear_tendon"](), 0.1

    def tension(p):
        return effect.torque(p, Motion(stretch, 0.0), np.zeros(0), Motion(0.0, 0.0))

    p = np.array([200.0, 0.0, 0.3])
    # The series of the exponentials: K (x + a h x²/2 + h² x³/6).
    expected = [stretch, 200 * 0.3 * stretch**2 / 2, 0.0]
    np.testing.assert_allclose(jax.grad(tension)(p), expected, rtol=1e-12, atol=1e-15)
    second = jax.hessian(tension)(p)
    np.testing.assert_allclose(second[1, 1], 200 * stretch**3 / 3, rtol=1e-12)
    np.testing.assert_allclose(second[1, 2], 200 * stretch**2 / 2, rtol=1e-12)


def test_without_hardening_the_nonlinear_tendon_is_linear():
    expected = response("series_tendon", SINUSOID, stiffness=120.0)
    for asymmetry in (0.0, 1.0):
        own = {"stiffness": 120.0, "hardening": 0.0, "asymmetry": asymmetry}
        agree(response("nonlinear_tendon", SINUSOID, **own), expected, 1e-6)


def test_beside_a_tendon_a_path_acts_at_the_joint():
    own = {"stiffness": 120.0, "hardening": 12.0, "asymmetry": 0.4}
    drive = imposed_motion(TIME, THERE_AND_BACK(TIME))
    alone = response("nonlinear_tendon", drive, **own)
    both = response("nonlinear_tendon", drive, **own, bypass_stiffness=30.0, bypass_damping=0.7)
    rate = THERE_AND_BACK.deriv()(TIME)
    agree(both - alone, 30.0 * THERE_AND_BACK(TIME) + 0.7 * rate, 1e-9)


def test_a_linear_tendon_with_a_path_beside_it_is_a_maxwell_branch():
    """K and B behind a spring relax as a branch does; what it lacks is a damper at the joint."""
    tendon, passive, damping = 120.0, 30.0, 0.7
    both = response(
        "nonlinear_tendon",
        SINUSOID,
        stiffness=tendon,
        hardening=0.0,
        asymmetry=0.0,
        bypass_stiffness=passive,
        bypass_damping=damping,
    )
    in_series = K * tendon / (K + tendon)
    branch = response(
        "maxwell_branch",
        SINUSOID,
        K=passive + in_series,
        B=damping,
        stiffness=tendon - in_series,
        time_constant=B / (K + tendon),
    )
    agree(both, branch, 1e-6)


def test_hill_muscle_with_a_nonlinear_tendon_carries_its_tension():
    """The element's velocity is the root of the balance of torques, found here by bisection."""
    tendon, muscle, damping = (120.0, 20.0, 0.3), (10.0, 5.0, 0.4), 0.1
    model = joint("hill_force_velocity", "nonlinear_tendon")
    own = (*muscle, *tendon, 0.0, 0.0)
    assert [n.split(".")[0] for n in model.parameter_names[3:]] == [
        *["hill_force_velocity"] * 3,
        *["nonlinear_tendon"] * 5,
    ]

    def rates(t, state):
        q, v, x = state
        tension = nonlinear_tension(q - x, *tendon)

        def excess(w):
            return K * x + damping * w + hill_torque(w, *muscle) - tension

        w = scipy.optimize.brentq(excess, -1e4, 1e4, xtol=1e-12, rtol=1e-14)
        return [v, (applied(t) - tension) / I, w]

    expected = by_ode(rates, np.zeros(3), TIME, rtol=1e-9)[0]
    found = simulate(model, np.array([K, damping, I, *own]), SINUSOID)
    agree(found, expected, 1e-6)


def test_short_range_stiffness_with_a_tendon_sees_the_muscles_motion():
    model = joint("series_tendon", "short_range_stiffness")

    def rates(t, state):
        q, v, x, z = state
        tension = 120 * (q - x)
        w = (tension - K * x - 100 * z) / B
        growing = w if w * z > 0 else 0.0
        return [v, (applied(t) - tension) / I, w, w - growing * abs(z) / 0.03 - 20 * z]

    expected = by_ode(rates, np.zeros(4), TIME)[0]
    values = np.array([K, B, I, 120.0, 0.0, 0.0, 100.0, 0.03, 1.0, 20.0])
    agree(simulate(model, values, SINUSOID), expected, 1e-6)


# Between what is driven and the limb


def test_a_soft_coupling_is_a_link_between_two_bodies():
    """Angle of the first: (limb + link) / (limb first + limb link + link first)."""
    k, tau, share = 400.0, 3e-3, 0.3
    limb, link = np.array([(1 - share) * I, B, K]), np.array([k * tau, k])
    first = np.array([share * I, 0.0, 0.0])
    both = np.polyadd(np.polymul(limb, first), np.polymul(link, np.polyadd(limb, first)))
    expected = impulse_by_residues(scipy.signal.lti(np.polyadd(limb, link), both), TIME)
    own = {"stiffness": k, "time": tau, "share": share}
    agree(response("soft_coupling", Impulse(1.0).drive(TIME), **own), expected, 1e-9)


@pytest.mark.parametrize(("place", "sticky"), [(0.0, 0.0), (0.7, 0.3), (-1.4, 0.0)])
def test_with_play_the_limb_is_left_alone_within_the_gap(place, sticky):
    """From where it rests: in the middle, aside, or pressed against one side by a constant load."""
    k, tau, share, gap, corner = 600.0, 3e-3, 0.3, 0.004, 0.3 * 0.004
    held = place * gap
    pulls = 1 - (1 - sticky) / (1 + (2e-4 / gap) ** 2)
    # Its slope rises from 0 to 1 about the gap, as the distribution of a beta variable does.
    slope = stats.beta(2, 2, loc=-corner, scale=2 * corner)
    comes = interpolate.PchipInterpolator(
        grid := np.linspace(-corner, corner, 4001),
        integrate.cumulative_trapezoid(slope.cdf(grid), grid, initial=0.0),
    )

    def push(beyond, rate):
        depth = comes(np.clip(beyond, -corner, corner)) + np.maximum(beyond - corner, 0.0)
        push = depth + tau * slope.cdf(beyond) * rate
        return k * np.maximum(push, pulls * push)

    def carried(s, rate):
        return push(s - gap, rate) - push(-s - gap, -rate)

    def rates(t, state):
        q, v, x, w = state
        torque, load = carried(q - x, v - w), carried(held, 0.0)
        before, behind = share * I, (1 - share) * I
        pushed = torque - load - K * x - B * w
        return [v, (applied(t) + load - torque) / before, w, pushed / behind]

    expected = by_ode(rates, np.array([held, 0.0, 0.0, 0.0]), TIME)[0] - held
    own = {"stiffness": k, "time": tau, "share": share, "gap": gap, "rounding": 0.3}
    own |= {"stickiness": sticky}
    found = response("backlash", SINUSOID, scheme=Scheme(16), place=place, **own)
    agree(found, expected, 1e-6)
    assert carried(gap / 2, 10.0) == 0
    assert carried(10 * gap, 0.0) == pytest.approx(9 * k * gap)
    # Where it opens it hardly pulls, unless it is sticky.
    opens = carried(1.3 * gap, -1.0)
    assert opens == pytest.approx(pulls * k * (0.3 * gap - tau))


@pytest.mark.parametrize("coupling", ["soft_coupling", "backlash"])
def test_behind_a_coupling_the_limb_has_its_effects(coupling):
    """Under an imposed angle the torque is that of the driven body and of the link."""
    model = joint(coupling, "gravity")
    k, tau, share = 400.0, 3e-3, 0.3
    link = {"stiffness": k, "time": tau, "share": share} | (
        {"gap": 0.0} if coupling == "backlash" else {}
    )
    values = values_of(model, moment=40.0, posture=0.5, **link)
    angle, velocity = THERE_AND_BACK, THERE_AND_BACK.deriv()

    def carried(t, x, w):
        return k * (angle(t) - x + tau * (velocity(t) - w))

    def rates(t, state):
        x, w = state
        weight = 40 * (np.sin(0.5 + x) - np.sin(0.5))
        return [w, (carried(t, x, w) - K * x - B * w - weight) / ((1 - share) * I)]

    limb = by_ode(rates, np.zeros(2), TIME)
    expected = carried(TIME, *limb) + share * I * angle.deriv(2)(TIME)
    agree(simulate(model, values, imposed_motion(TIME, angle(TIME))), expected, 1e-5)


# Sensors


@pytest.mark.parametrize("delay", [0.0, 0.0004, 0.003, 0.0105, -0.0004, -0.0077])
def test_sensor_delay_shifts_a_cubic_exactly(delay):
    cubic = np.polynomial.Polynomial([0.02, 1.0, -8.0, 90.0])
    found = recorded("sensor_delay", [delay], cubic(TIME))
    # Where the four samples around the delayed time are in the record.
    place = TIME / INTERVAL - delay / INTERVAL
    inside = (place >= 1) & (place <= TIME.size - 3)
    assert inside.sum() > 80
    agree(found[inside], cubic(TIME - delay)[inside], 1e-12)
    # Before it the joint was at rest where it begins.
    before = place < -2
    assert np.all(np.abs(found[before] - 0.02) < 1e-12)


def test_sensor_lowpass_of_a_ramp_and_a_step():
    tau = 0.007
    ramp_answer = TIME - tau + tau * np.exp(-TIME / tau)
    agree(recorded("sensor_lowpass", [tau, 0.0], TIME), ramp_answer, 1e-12)
    # A step is a ramp of one interval.
    step = np.minimum(TIME / INTERVAL, 1.0)
    expected = np.diff(ramp_answer, prepend=0.0) / INTERVAL
    agree(recorded("sensor_lowpass", [tau, 0.0], step), expected, 1e-12)
    # A steady signal passes as it is, and every signal without the filter.
    agree(recorded("sensor_lowpass", [tau, 0.5], np.full(TIME.size, 0.3)), [0.3] * 101, 1e-12)
    agree(recorded("sensor_lowpass", [0.0, 0.0], step), step, 1e-15)


def test_sensor_lowpass_has_a_derivative_without_its_poles():
    effect, signal = EFFECTS["sensor_lowpass"](), 3.0 * TIME
    found = jax.jacfwd(lambda p: effect.record(p, signal, INTERVAL))(np.zeros(2))
    # A pole that is much faster than the sampling is a delay by its time constant.
    np.testing.assert_allclose(found[1:, 0], -3.0, rtol=1e-9)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-12)


@pytest.mark.parametrize("shape", [0.0, 0.1, 0.25, 0.5, 1.0])
def test_sensor_lowpass_of_second_order(shape):
    tau, signal = 0.008, np.interp(TIME, [0.0, 0.03, 0.05, 0.08], [0.0, 1.0, -0.4, 0.2])
    denominator = [shape * tau**2, tau, 1.0] if shape else [tau, 1.0]
    expected = scipy.signal.lsim(([1.0], denominator), signal, TIME)[1]
    agree(recorded("sensor_lowpass", [tau, shape], signal), expected, 1e-7)


@pytest.mark.parametrize(
    ("key", "own"),
    [("sensor_lowpass", {"time_constant": 0.006}), ("sensor_delay", {"delay": 0.006})],
)
@pytest.mark.parametrize("imposed", ["torque", "angle"])
def test_instruments_with_a_memory_see_the_response_between_samples(key, own, imposed):
    """Of samples 10 ms apart alone a filter made a torque that was wrong by 2 % of its peak."""
    coarse = TIME[::10]
    fine = np.linspace(0.0, 0.1, 10001)
    if imposed == "angle":
        position = THERE_AND_BACK
        drive = imposed_motion(coarse, position(coarse))
        true = K * position(fine) + B * position.deriv()(fine) + I * position.deriv(2)(fine)
    else:
        torque = np.interp(coarse, [0.0, 0.02, 0.03, 0.1], [0.0, 0.0, 9.0, -4.0])
        drive = SampledTorque(torque).drive(coarse)
        applied = np.interp(fine, coarse, torque)
        true = scipy.signal.lsim(([1.0], [I, B, K]), applied, fine)[1]
    if key == "sensor_lowpass":
        start = [own["time_constant"] * true[0]]
        filtered = ([1.0], [own["time_constant"], 1.0])
        expected = scipy.signal.lsim(filtered, true, fine, X0=start)[1][::1000]
    else:
        expected = np.interp(coarse - own["delay"], fine, true)
    agree(response(key, drive, **own), expected, 3e-4)
    agree(response(key, drive, scheme=Scheme(16), **own), expected, 3e-4)


def test_sensor_lowpass_is_a_butterworth_filter_at_one_half():
    cutoff = 25.0  # [Hz]
    numerator, denominator = scipy.signal.butter(2, 2 * np.pi * cutoff, analog=True)
    tau = np.sqrt(2) / (2 * np.pi * cutoff)
    np.testing.assert_allclose(denominator / denominator[-1], [0.5 * tau**2, tau, 1.0])
    np.testing.assert_allclose(numerator / denominator[-1], [1.0])


@pytest.mark.parametrize("drive", [SINUSOID, ramp(0.3)], ids=["torque", "angle"])
def test_sensor_drift_is_a_cubic_in_the_units_of_the_response(drive):
    found = response("sensor_drift", drive, rate=0.2, bend=-0.7, twist=1.3)
    expected = simulate(KBI(), (K, B, I), drive) + 0.2 * TIME - 0.7 * TIME**2 + 1.3 * TIME**3
    agree(found, expected, 1e-12)
