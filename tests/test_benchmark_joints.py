"""The hidden joints, compared with closed forms, transfer functions and other integrators."""

import ast
import dataclasses
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from oracles import agree
from scipy import integrate, signal

import identifiability.benchmark
from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.cases import QUICK, TIERS, hidden_cases
from identifiability.benchmark.effects import (
    EFFECTS,
    ActivationLag,
    Backlash,
    BristleFriction,
    CoulombFriction,
    Gravity,
    HillForceVelocity,
    MaxwellBranch,
    NonlinearTendon,
    QuadraticStiffness,
    SecondMass,
    SensorDelay,
    SensorDrift,
    SensorLowpass,
    SeriesTendon,
    SoftCoupling,
    StretchReflex,
)
from identifiability.benchmark.joints import Joint, draw_joint
from identifiability.benchmark.protocol import (
    INTERVAL,
    LEAD,
    Recorder,
    multisine,
    prbs,
    pulse,
    record,
    short,
    sinusoid,
    standard,
    step,
)
from identifiability.benchmark.unknowns import (
    UNKNOWNS,
    FractionalDamping,
    QuadraticDrag,
)
from identifiability.benchmark.visibility import kbi_responses, missed_by_kbi, missed_without
from identifiability.errors import InputError
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS as LIBRARY
from identifiability.joint.model import KBI
from identifiability.measurement.trials import Trial

ANATOMY = Anatomy(0.1, 5.0, 0.25, 25.0, 0.75)
TENDINOUS = Anatomy(0.1, 5.0, 0.25, 25.0, 3.0)
LOADS = [pulse(16.0, 50), pulse(-60.0, 5), step(-6.0), sinusoid(20.0), prbs(1.5, 1)]
S = Polynomial([0.0, 1.0])
EVERY = [(key, form) for key, effect in (EFFECTS | UNKNOWNS).items() for form in effect.forms]
# Without link or gap a handle still adds its inertia.
BEYOND_LIMIT = [(key, form) for key, form in EVERY if key not in {"backlash", "soft_coupling"}]


def drawn(key, form, seed=3):
    return draw_joint([key], np.random.default_rng(seed), [form])


def linear(numerator, denominator, load):
    """Response of a transfer function to a torque that is linear between samples."""
    system = signal.TransferFunction(
        Polynomial(numerator).coef[::-1] if np.ndim(numerator) else [numerator],
        denominator.coef[::-1],
    )
    time = np.arange(load.torque.size) * INTERVAL
    return signal.lsim(system.to_ss(), load.torque, time, interp=True)[1]


def resisted(a=ANATOMY):
    return Polynomial([a.stiffness, a.damping, a.inertia])


# Against closed forms


@pytest.mark.parametrize("load", LOADS, ids=lambda load: load.name)
def test_without_effects_it_is_stiffness_damping_and_inertia(load):
    expected = linear(1.0, resisted(), load)
    agree(Joint(ANATOMY).respond(load.torque, INTERVAL), expected, 1e-8)
    agree(kbi_responses([load], ANATOMY.stiffness, ANATOMY.damping, 0.1)[0], expected, 1e-8)


def tendon():
    a, k = TENDINOUS, 80.0
    muscle = Polynomial([a.muscle_stiffness, a.muscle_damping])
    beside = Polynomial([a.passive_stiffness, a.passive_damping, a.inertia])
    return a, SeriesTendon(k), (muscle + k).coef, beside * (muscle + k) + k * muscle


def maxwell():
    lag = Polynomial([1.0, 0.03])
    return ANATOMY, MaxwellBranch(40.0, 0.03), lag.coef, resisted() * lag + 40.0 * 0.03 * S


def activation():
    lag = Polynomial([1.0, 0.02])
    effect = ActivationLag(15.0, 0.02, 0.02, "first_order")
    return ANATOMY, effect, lag.coef, resisted() * lag + 15.0


def second_mass():
    inertia, link = 0.03, Polynomial([120.0, 0.6])
    effect = SecondMass(inertia, *link.coef)
    own = inertia * S**2
    return ANATOMY, effect, (own + link).coef, resisted() * (own + link) + own * link


def soft_coupling():
    handle, link = 0.02, Polynomial([150.0, 0.8])
    effect = SoftCoupling(*link.coef, handle, ANATOMY)
    before = handle * S**2
    return (
        ANATOMY,
        effect,
        (resisted() + link).coef,
        (before + link) * (resisted() + link) - link**2,
    )


def lowpass(form):
    w = 2.0 * np.pi * 20.0
    filters = {
        "first_order": 1.0 + S / w,
        "butterworth": 1.0 + math.sqrt(2.0) * S / w + (S / w) ** 2,
    }
    return ANATOMY, SensorLowpass(20.0, form), 1.0, resisted() * filters[form]


LINEAR = {
    "series_tendon": tendon(),
    "maxwell_branch": maxwell(),
    "activation_lag": activation(),
    "second_mass": second_mass(),
    "soft_coupling": soft_coupling(),
    "sensor_lowpass, first order": lowpass("first_order"),
    "sensor_lowpass, second order": lowpass("butterworth"),
}


@pytest.mark.parametrize("name", LINEAR)
def test_linear_effects_have_their_transfer_functions(name):
    anatomy, effect, numerator, denominator = LINEAR[name]
    for load in (LOADS[0], LOADS[3]):
        found = Joint(anatomy, (effect,)).respond(load.torque, INTERVAL)
        agree(found, linear(numerator, denominator, load), 1e-7)


@pytest.mark.parametrize("form", ["first_order", "critically_damped"])
def test_reflex_in_the_steady_state(form):
    effect = StretchReflex(8.0, 0.9, 0.033, 0.015, 0.015, form)
    frequency, n = 3.0, 5000
    time = np.arange(n) * INTERVAL
    angle = Joint(ANATOMY, (effect,)).respond(np.sin(2 * np.pi * frequency * time), INTERVAL)
    late = slice(4000, 5000)  # three whole periods
    wave = np.exp(-2j * np.pi * frequency * time[late])
    found = 2j * np.mean(angle[late] * wave)
    s = 2j * np.pi * frequency
    order = 1 if form == "first_order" else 2
    feedback = (8.0 + 0.9 * s) * np.exp(-s * 0.033) / (1.0 + 0.015 * s) ** order
    # A sine that is linear between samples is smaller by sinc².
    expected = np.sinc(frequency * INTERVAL) ** 2 / (resisted()(s) + feedback)
    assert abs(found - expected) < 1e-5 * abs(expected)


@pytest.mark.parametrize("form", StretchReflex.forms)
def test_reflex_comes_after_its_delay(form):
    effect = StretchReflex(8.0, 0.9, 0.03, 0.01, 0.02, form)
    load = LOADS[0].torque
    without = Joint(ANATOMY).respond(load, INTERVAL)
    difference = np.abs(Joint(ANATOMY, (effect,)).respond(load, INTERVAL) - without)
    start = LEAD - 1 + 30  # the torque begins to rise one sample before it is up
    assert difference[: start + 1].max() < 1e-9
    assert difference[start + 40] > 1e-3 * np.abs(without).max()


def test_antagonist_reflex_is_slower_to_let_go():
    effect = StretchReflex(1.0, 0.0, 0.03, 0.01, 0.03, "antagonists")

    def past(time):
        return (1.0 if 0.03 <= time <= 0.13 else 0.0), 0.0

    found = integrate.solve_ivp(
        lambda t, y: effect.react(t, 0.0, 0.0, y, past)[1],
        (0.0, 0.26),
        [0.0, 0.0],
        max_step=1e-3,
        t_eval=[0.07, 0.16, 0.19],
    ).y
    assert found[0] == pytest.approx([1 - np.exp(-1.0), 1.0, np.exp(-1.0)], rel=0.03)
    assert np.all(found[1] == 0.0)


def test_sensor_delay_shifts_the_record():
    load = LOADS[4].torque
    late = Joint(ANATOMY, (SensorDelay(0.004),)).respond(load, INTERVAL)
    agree(late[4:], Joint(ANATOMY).respond(load, INTERVAL)[:-4], 1e-8)
    assert np.all(late[:4] == 0.0)


def test_sensor_drift_is_the_same_whatever_the_load():
    drift = SensorDrift(0.01, -0.003, 0.7)
    time = np.arange(600) * INTERVAL
    for load in LOADS[:2]:
        without = Joint(ANATOMY).respond(load.torque, INTERVAL)
        found = Joint(ANATOMY, (drift,)).respond(load.torque, INTERVAL) - without
        assert np.allclose(found, 0.01 * time - 0.003 * np.sin(2 * np.pi * 0.7 * time), atol=1e-15)


# Against another integrator


def hill_torque(velocity, flexor=1.2, extensor=0.9, top=9.0, k=0.25, plateau=1.4):
    def relative(lengthening):
        if lengthening <= 0:
            shortening = -lengthening
            return max(0.0, 1 - shortening) / (1 + shortening / k)
        # A rectangular hyperbola through (0, 1) with Hill's slope there, towards the plateau.
        c = (plateau - 1) / (1 + 1 / k)
        return (c + plateau * lengthening) / (c + lengthening)

    along, against = relative(velocity / top), relative(-velocity / top)
    return flexor * along - extensor * against - (flexor - extensor)


def smooth_friction(velocity):
    steady = 0.5 + 0.2 * math.exp(-((velocity / 0.2) ** 2))
    return steady * math.tanh(velocity / 2e-5)


NONLINEAR = {
    "hill_force_velocity": (
        HillForceVelocity(1.2, 0.9, 9.0, 0.25, 1.4),
        lambda q, v: hill_torque(v),
        1e-6,
    ),
    "coulomb_friction": (
        CoulombFriction(0.5, 0.7, 0.2, "stribeck"),
        lambda q, v: smooth_friction(v),
        1e-3,
    ),
    "gravity": (Gravity(20.0, 0.8), lambda q, v: 20 * (np.sin(0.8 + q) - np.sin(0.8)), 1e-6),
    "quadratic_stiffness": (
        QuadraticStiffness(30.0, -1.2, "polynomial"),
        lambda q, v: -18.0 * q**2,
        1e-6,
    ),
    "quadratic_drag": (QuadraticDrag(0.4), lambda q, v: 0.4 * v * abs(v), 1e-6),
}


@pytest.mark.parametrize("name", NONLINEAR)
def test_nonlinear_effects_against_an_implicit_integrator(name):
    effect, torque, rtol = NONLINEAR[name]
    load = pulse(-16.0, 50, 400).torque
    time = np.arange(load.size) * INTERVAL
    corners = [0, LEAD - 1, LEAD, LEAD + 49, LEAD + 50, load.size - 1]
    expected, state = np.zeros(load.size), [0.0, 0.0]
    for left, right in pairwise(corners):
        found = integrate.solve_ivp(
            lambda t, y: (
                y[1],
                (np.interp(t, time, load) - 30.0 * y[0] - 1.0 * y[1] - torque(*y)) / 0.1,
            ),
            (time[left], time[right]),
            state,
            method="LSODA",
            rtol=1e-9,
            atol=1e-12,
            t_eval=time[left : right + 1],
        )
        expected[left : right + 1], state = found.y[0], found.y[:, -1]
    agree(Joint(ANATOMY, (effect,)).respond(load, INTERVAL), expected, rtol)


def test_hill_muscle_behind_a_tendon_carries_the_tendons_load():
    hill, tendon = HillForceVelocity(2.0, 1.5, 9.0, 0.25, 1.4), SeriesTendon(80.0)
    load = pulse(16.0, 50, 300).torque
    time = np.arange(load.size) * INTERVAL
    a = dataclasses.replace(TENDINOUS, muscle_damping=0.8)

    def residual_speed(tension, where):
        """Bisection for the velocity at which the muscle carries the tension."""
        low, high = -500.0, 500.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            torque = a.muscle_stiffness * where + a.muscle_damping * middle
            torque += hill_torque(middle, 2.0, 1.5)
            low, high = (middle, high) if torque < tension else (low, middle)
        return middle

    def rates(t, y):
        tension = 80.0 * (y[0] - y[2])
        net = np.interp(t, time, load) - a.passive_stiffness * y[0] - a.passive_damping * y[1]
        return y[1], (net - tension) / a.inertia, residual_speed(tension, y[2])

    expected = integrate.solve_ivp(
        rates, (0, time[-1]), [0, 0, 0], rtol=1e-7, atol=1e-9, max_step=1e-3, t_eval=time
    ).y[0]
    agree(Joint(a, (hill, tendon)).respond(load, INTERVAL), expected, 1e-5)


@pytest.mark.parametrize(("key", "form"), EVERY)
def test_the_response_is_converged(key, form):
    joint, load = drawn(key, form), LOADS[0].torque
    closer = joint.respond(load, INTERVAL, rtol=1e-11)
    agree(joint.respond(load, INTERVAL), closer, 2e-6)


@pytest.mark.parametrize(
    "key", ["nonlinear_tendon", "stretch_reflex", "coulomb_friction", "sensor_delay"]
)
def test_torque_is_linear_between_samples(key):
    joint, load = drawn(key, EFFECTS[key].forms[-1]), LOADS[1].torque
    fine = np.interp(np.arange(4 * load.size - 3) / 4.0, np.arange(load.size), load)
    agree(joint.respond(fine, INTERVAL / 4.0)[::4], joint.respond(load, INTERVAL), 1e-6)


# What each effect must and must not do


def test_friction_holds_what_is_below_it_and_stops_for_good():
    joint = Joint(ANATOMY, (CoulombFriction(0.8, 1.0, 0.2, "stribeck"),))
    assert np.all(joint.respond(step(0.99).torque, INTERVAL) == 0.0)
    assert np.ptp(joint.respond(step(1.05).torque, INTERVAL)) > 1e-3
    angle = joint.respond(step(-6.0, 1500).torque, INTERVAL)
    assert np.all(angle[-300:] == angle[-1])
    assert abs(ANATOMY.stiffness * angle[-1] + 6.0) <= 1.0


def test_uneven_friction_holds_and_brakes_more_one_way():
    friction = CoulombFriction(0.8, 0.8, 0.2, "uneven", 0.25)
    joint = Joint(ANATOMY, (friction,))
    for torque, held in ((0.99, True), (1.01, False), (-0.59, True), (-0.61, False)):
        moved = np.ptp(joint.respond(step(torque).torque, INTERVAL))
        assert (moved == 0.0) == held, torque
    assert (friction.torque(1.0, 1), friction.torque(-1.0, -1)) == pytest.approx((1.0, -0.6))
    other = CoulombFriction(0.8, 0.8, 0.2, "uneven", -0.25)
    assert (other.torque(1.0, 1), other.torque(-1.0, -1)) == pytest.approx((0.6, -1.0))


def test_bristles_hold_by_bending_and_slide_under_a_constant_torque():
    friction = BristleFriction(0.8, 1.0, 0.2, stiffness=800.0, damping=0.5)
    bent, _ = friction.react(0.0, 0.0, 0.0, (5e-4,), None)
    assert bent == pytest.approx(0.4)
    for speed, torque in ((3.0, 0.8), (-3.0, -0.8), (1e-4, 1.0)):
        steady, rates = friction.react(0.0, 0.0, speed, (torque / 800.0,), None)
        assert steady == pytest.approx(torque, rel=1e-3)
        assert rates[0] == pytest.approx(0.0, abs=1e-3 * abs(speed))
    # The joint springs back by what the bristles give, and stays where it slid to.
    joint = Joint(ANATOMY, (friction,))
    angle = joint.respond(np.r_[np.linspace(0, 0.4, 500), np.linspace(0.4, 0, 500)], INTERVAL)
    assert abs(angle[-1]) < 0.5 * angle.max() < 5e-4
    slid = joint.respond(np.r_[np.linspace(0, 6.0, 500), np.linspace(6.0, 0, 1500)], INTERVAL)
    assert slid[-1] > 0.01


def test_uneven_friction_shows_under_a_torque_and_hardly_under_an_angle():
    """While it moves the joint feels a constant more, which is the level of a recorded torque."""
    joint = Joint(ANATOMY, (CoulombFriction(0.8, 0.8, 0.2, "uneven", 0.25),))
    time = INTERVAL * np.arange(1000)
    moved = [
        (torque, joint.respond(torque, INTERVAL))
        for hertz in (1.5, 2.5, 3.5, 1.0)
        for torque in [8.0 * np.sin(2 * np.pi * hertz * time) * (time > 0.1)]
    ]
    model = KBI() + LIBRARY["coulomb_friction"]()
    left = {}
    for driven in ("torque", "angle"):
        trials = [Trial(time, *pair, driven=driven) for pair in moved]
        level = {"coulomb_friction.asymmetry": (-1e-9, 1e-9)}
        even, uneven = (
            Investigation(trials, bounds=bounds).fit(model, refined=True) for bounds in (level, {})
        )
        left[driven] = uneven.fitted.error / even.fitted.error
        # Where the angle is imposed friction turns round between two samples, in none of them.
        within = {"torque": 0.05, "angle": 0.1}[driven]
        assert uneven.values["coulomb_friction.torque"] == pytest.approx(0.8, rel=within)
        if driven == "torque":
            found = uneven.values["coulomb_friction.asymmetry"]
            assert found == pytest.approx(0.25, abs=0.01)
    assert left["torque"] < 0.001
    # All that an angle shows of it is how friction turns round.
    assert left["angle"] > 0.6


def motion(time):
    """A movement from rest, with stops, reversals and two time scales: angle and velocity."""
    w, v = 9.0, 41.0
    angle = 0.1 * (1 - math.cos(w * time)) * math.cos(5.0 * time) + 0.02 * math.sin(v * time) ** 2
    velocity = (
        0.1 * w * math.sin(w * time) * math.cos(5.0 * time)
        - 0.5 * (1 - math.cos(w * time)) * math.sin(5.0 * time)
        + 0.02 * v * math.sin(2 * v * time)
    )
    return angle, velocity


PASSIVE = [
    *(("maxwell_branch", f) for f in EFFECTS["maxwell_branch"].forms),
    *(("short_range_stiffness", f) for f in EFFECTS["short_range_stiffness"].forms),
    *(("cubic_stiffness", f) for f in EFFECTS["cubic_stiffness"].forms),
    ("coulomb_friction", "bristles"),
    ("second_mass", "linear"),
    ("bouc_wen", "stiffening_on_reversal"),
    ("fractional_damping", "spring_pot"),
    ("backlash", "symmetric"),
    ("soft_coupling", "linear"),
    ("damping_by_angle", "half"),
    ("damping_by_direction", "two_values"),
    ("quadratic_drag", "square"),
]


@pytest.mark.parametrize(("key", "form"), PASSIVE)
def test_passive_effects_never_give_more_than_they_got(key, form):
    (effect,) = drawn(key, form).effects
    n = effect.n_states()

    def rates(t, y):
        angle, velocity = motion(t)
        torque, own = effect.react(t, angle, velocity, y[:n].tolist(), None)
        return [*own, torque * velocity]

    work = integrate.solve_ivp(
        rates, (0.0, 2.0), np.zeros(n + 1), rtol=1e-7, atol=1e-9, max_step=2e-3
    ).y[-1]
    assert work.max() > 0.01
    assert work.min() > -1e-6 * work.max()


@pytest.mark.parametrize(
    ("key", "form"), [("gravity", "pendulum"), ("quadratic_stiffness", "exponential")]
)
def test_conservative_effects_give_back_what_they_got(key, form):
    (effect,) = drawn(key, form).effects
    there = np.linspace(0.0, 0.3, 301)
    torque = np.array([effect.react(0.0, q, 0.0, (), None)[0] for q in there])
    moving = np.array([effect.react(0.7, q, -2.0, (), None)[0] for q in there])
    assert torque[0] == 0.0
    assert np.ptp(torque) > 0.0
    assert np.array_equal(torque, moving)


def test_muscles_and_friction_always_brake():
    hill = HillForceVelocity(1.2, 0.9, 9.0, 0.25, 1.4)
    friction = CoulombFriction(0.5, 0.7, 0.2, "stribeck")
    for velocity in (0.01, 0.3, 4.0, 8.9, 9.1, 60.0):
        for way in (velocity, -velocity):
            torque, slope = hill.torque(way)
            assert torque == pytest.approx(hill_torque(way), rel=1e-12)
            assert torque * way > 0
            nearby = (hill.torque(way + 1e-6)[0] - hill.torque(way - 1e-6)[0]) / 2e-6
            assert slope == pytest.approx(nearby, rel=1e-5, abs=1e-9)
        assert 0.5 <= friction.torque(velocity, 1) <= 0.7
        assert friction.torque(velocity, -1) == -friction.torque(velocity, 1)
    # The lengthening muscle holds its plateau, the shortening one nothing.
    assert hill.torque(1e6)[0] == pytest.approx(1.2 * 0.4 + 0.9, rel=1e-4)


@pytest.mark.parametrize("form", NonlinearTendon.forms)
def test_a_tendon_pulls_harder_the_more_it_is_stretched(form):
    tendon = NonlinearTendon(60.0, 0.1, 4.5, form)
    stretch = np.linspace(-0.5, 0.5, 1001)
    tension = np.array([tendon.tension(s) for s in stretch])
    slope = np.gradient(tension, stretch)
    assert tension[500] == 0.0
    assert np.all(slope >= -1e-9)
    assert slope[500] == pytest.approx(60.0, rel=1e-3)
    assert np.all(np.abs(np.diff(tension)) <= 0.001 * 180.0 * (1 + 1e-9))
    if form == "toe":
        assert tension.min() == -4.5  # slack
        assert slope[-1] == pytest.approx(180.0)
    else:
        assert np.allclose(tension, -tension[::-1])


def test_a_joint_with_a_nonlinear_tendon_gives_no_energy():
    for form in NonlinearTendon.forms:
        joint = Joint(TENDINOUS, (NonlinearTendon(60.0, 0.1, 4.5, form),))
        load = pulse(-24.0, 50).torque
        angle = joint.respond(load, INTERVAL)
        velocity = np.gradient(angle, INTERVAL)
        supplied = integrate.cumulative_trapezoid(load * velocity, dx=INTERVAL, initial=0.0)
        left = supplied - 0.5 * 0.1 * velocity**2 - 0.5 * 5.0 * angle**2
        assert left[LEAD + 60 :].min() > 0.0
        assert np.abs(angle[-50:]).max() < 0.3 * np.abs(angle).max()


def test_backlash_leaves_the_limb_alone_within_its_play():
    effect = Backlash(900.0, 1.5, 0.02, ANATOMY, 0.01)
    joint = Joint(ANATOMY, (effect,))
    load = pulse(1.0, 5).torque
    angle = joint.respond(load, INTERVAL)
    free = linear(1.0, 0.02 * S**2, pulse(1.0, 5))
    inside = free < 0.01
    agree(angle[inside], free[inside], 1e-7)
    assert angle[-1] < 0.5 * free[-1]


def test_fractional_damping_is_a_power_of_frequency():
    effect = FractionalDamping(3.0, 0.4)
    rates, gains = np.array(effect.rates), np.array(effect.gains)
    spring, dashpot = effect.ends
    for frequency in (0.5, 3.0, 20.0, 210.0, 600.0):
        s = 1j * frequency
        found = spring + dashpot * s + np.sum(gains * s / (s + rates))
        assert abs(found - 3.0 * s**0.4) < 0.01 * abs(3.0 * s**0.4)


@pytest.mark.parametrize(("key", "form"), BEYOND_LIMIT)
def test_effects_vanish_with_their_size(key, form):
    joint, load = drawn(key, form), pulse(16.0, 50, 400).torque
    (effect,) = joint.effects
    without = Joint(joint.anatomy).respond(load, INTERVAL)

    def change(size):
        scaled = Joint(joint.anatomy, (effect.scaled(size),))
        return np.abs(scaled.respond(load, INTERVAL) - without).max()

    assert change(1.0) > 5e-3 * np.abs(without).max()
    assert change(0.01) < 0.04 * change(1.0)


def test_only_what_was_asked_for_can_be_drawn():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="expected one of"):
        draw_joint(["telepathy"], rng)
    with pytest.raises(InputError, match="has the forms"):
        draw_joint(["gravity"], rng, ["cubic"])
    with pytest.raises(InputError, match="once"):
        draw_joint(["series_tendon", "nonlinear_tendon"], rng)
    with pytest.raises(InputError, match="alone"):
        draw_joint(["backlash", "gravity"], rng)
    with pytest.raises(InputError, match="delay"):
        Joint(ANATOMY, (StretchReflex(1.0, 0.1, 5e-4, 0.01, 0.01, "first_order"),)).respond(
            LOADS[0].torque, INTERVAL
        )


# Recording


def test_the_protocols():
    protocol = standard()
    names = [load.name for load in protocol.fit]
    assert names == [
        *("pulse5 +60", "pulse5 -60", "pulse50 +4", "pulse50 +16", "pulse50 -16"),
        *("step +3", "step -6", "sine30 +20", "prbs +1.5", "multisine +5"),
    ]
    names = [load.name for load in protocol.held_out]
    assert names == [
        *("pulse5 +30", "pulse50 -9.6", "step +6", "sine30 -20", "prbs +4", "pulse50 +24"),
    ]
    assert (len(short().fit), len(short().held_out)) == (6, 2)
    assert {load.torque.size for load in (*short().fit, *short().held_out)} == {500}
    for load in (*protocol.fit, *protocol.held_out, *short().fit, *short().held_out):
        assert np.all(load.torque[:LEAD] == 0.0)
        assert np.abs(load.torque).max() == pytest.approx(abs(load.amplitude), rel=0.01)
        assert np.any(load.torque[LEAD : LEAD + 3] != 0.0)
    fitted, held_out = protocol.fit[8].torque, protocol.held_out[4].torque
    assert not np.array_equal(np.sign(fitted), np.sign(held_out))


def test_the_multisine_ends_at_20_hz_and_is_not_peaked():
    torque = multisine(5.0, 2).torque[LEAD:]
    power = np.abs(np.fft.rfft(torque)) ** 2
    frequency = np.fft.rfftfreq(torque.size, INTERVAL)
    assert power[frequency > 20.5].sum() < 1e-9 * power.sum()
    assert np.abs(torque).max() / torque.std() < 2.5


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_noise_has_its_energy_and_its_correlation(correlation):
    angle = Joint(ANATOMY).respond(LOADS[4].torque, INTERVAL)
    recorder = Recorder(1e-3, correlation=correlation)
    noise = np.array(
        [
            record(LOADS[4], angle, recorder, np.random.default_rng(seed)).angle - angle
            for seed in range(100)
        ]
    )
    assert np.mean(noise**2) / np.mean(angle**2) == pytest.approx(1e-3, rel=0.05)
    starts, ends = np.mean(noise[:, :50] ** 2), np.mean(noise[:, -50:] ** 2)
    assert starts == pytest.approx(ends, rel=0.3)  # the same throughout a trial
    found = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
    assert found == pytest.approx(correlation, abs=0.02)


def test_what_else_a_recorder_does():
    angle = Joint(ANATOMY).respond(LOADS[0].torque, INTERVAL)
    rng = np.random.default_rng(0)
    rounded = record(LOADS[0], angle, Recorder(1e-6, resolution=1e-3), rng).angle
    assert np.allclose(rounded, 1e-3 * np.round(rounded / 1e-3), atol=1e-12)
    assert np.abs(rounded - angle).max() < 1e-3
    trial = record(LOADS[0], angle, Recorder(1e-6, torque_noise=0.01), rng)
    error = trial.torque - LOADS[0].torque
    assert error.std() == pytest.approx(0.01 * np.sqrt(np.mean(LOADS[0].torque ** 2)), rel=0.1)
    humming = record(LOADS[0], angle, Recorder(1e-6, hum=3.0), rng).angle - angle
    spectrum = np.abs(np.fft.rfft(humming))
    assert np.fft.rfftfreq(humming.size, INTERVAL)[spectrum.argmax()] == pytest.approx(50.0)


# Cases


def test_the_tiers():
    tiers = {tier: hidden_cases(tier, 7) for tier in TIERS}
    assert {tier: len(specs) for tier, specs in tiers.items()} == {
        "singles": 61,
        "controls": 100,
        "pairs": 30,
        "unknown": 12,
        "quick": len(QUICK),
        "nulls": 100,
    }
    everything = [spec for tier in TIERS if tier != "quick" for spec in tiers[tier]]
    assert len({spec.name for spec in everything}) == len(everything)
    assert len({spec.stream for spec in everything}) == len(everything)
    for spec in everything:
        home = {"known": EFFECTS, "unknown": UNKNOWNS}.get(spec.kind, {})
        assert set(spec.keys) <= set(home)
        assert bool(spec.keys) == (spec.kind in ("known", "unknown"))
        assert bool(spec.variation) == (spec.kind == "unrepeatable")
    assert {spec.keys[0] for spec in tiers["singles"]} == set(EFFECTS)
    assert {(spec.keys[0], spec.forms[0]) for spec in tiers["singles"]} == {
        (key, form) for key, form in EVERY if key in EFFECTS
    }
    assert {len(spec.keys) for spec in tiers["pairs"]} == {2, 3}
    assert {spec.keys[0] for spec in tiers["unknown"]} == set(list(UNKNOWNS)[:5])
    assert {(spec.kind, spec.recorder.correlation) for spec in tiers["nulls"]} == {("none", 0.0)}
    assert {spec.kind for spec in tiers["quick"]} == {"none", "known", "unknown"}
    with pytest.raises(InputError, match="tier"):
        hidden_cases("impossible", 0)


def test_a_case_is_made_of_its_seed_alone():
    specs = {seed: hidden_cases("quick", seed) for seed in (1, 2)}
    first, again, other = (
        specs[1][4].build(),
        hidden_cases("quick", 1)[4].build(),
        specs[2][4].build(),
    )
    for one, two in zip((*first.fit, *first.held_out), (*again.fit, *again.held_out), strict=True):
        assert one.angle.tobytes() == two.angle.tobytes()
        assert one.torque.tobytes() == two.torque.tobytes()
    assert first.parameters == again.parameters
    assert not np.array_equal(first.fit[0].angle, other.fit[0].angle)
    assert first.parameters["inertia"] != other.parameters["inertia"]


@pytest.mark.parametrize("number", range(len(QUICK)))
def test_quick_cases_can_be_built(number):
    spec = hidden_cases("quick", 5)[number]
    case = spec.build()
    assert (case.name, case.truth, case.kind) == (spec.name, spec.keys, spec.kind)
    assert (len(case.fit), len(case.held_out)) == (6, 2)
    assert not case.weak
    assert {trial.driven for trial in case.fit} == {"torque"}
    for key in case.truth:
        assert any(name.startswith(f"{key}.") for name in case.parameters)
    for trial, load in zip(case.fit, short().fit, strict=True):
        assert np.array_equal(trial.torque, load.torque)
        assert trial.condition == load.kind
        assert np.abs(trial.angle).max() < 1.0


def test_stiffness_and_damping_vary_where_they_should():
    spec = dataclasses.replace(hidden_cases("controls", 3)[17], protocol="short")
    assert spec.kind == "unrepeatable"
    varied = spec.build()
    same = dataclasses.replace(spec, variation=0.0).build()
    change = [
        np.std(a.angle - b.angle) / np.std(b.angle)
        for a, b in zip(varied.fit, same.fit, strict=True)
    ]
    assert 0.005 < np.median(change) < 0.1
    assert len(set(change)) == len(change)


def test_an_effect_below_the_noise_is_weak():
    spec = hidden_cases("quick", 5)[2]
    assert spec.keys == ("series_tendon",)
    assert not spec.build().weak
    drowned = dataclasses.replace(spec, recorder=Recorder(0.3))
    assert drowned.build().weak


def test_what_a_fit_without_the_effect_misses():
    loads = standard().fit[3:7]
    plain = Joint(ANATOMY)
    angles = [plain.respond(load.torque, INTERVAL) for load in loads]
    elsewhere = plain.scaled(1.3, 0.6, 0.9)
    assert missed_by_kbi(elsewhere, loads, angles) < 1e-10
    gravity, friction = Gravity(20.0, 0.8), CoulombFriction(0.5, 0.5, 0.2, "sign")
    both = Joint(ANATOMY, (gravity, friction))
    angles = [both.respond(load.torque, INTERVAL) for load in loads]
    missed = [missed_without(key, both, loads, angles) for key in both.keys]
    assert missed_by_kbi(both, loads, angles) > max(missed) > 0
    assert min(missed) > 1e-4
    # One effect alone is missed as much by either measure.
    alone = both.without("coulomb_friction")
    angles = [alone.respond(load.torque, INTERVAL) for load in loads]
    found = missed_without("gravity", alone, loads, angles)
    assert found == pytest.approx(missed_by_kbi(alone, loads, angles), rel=0.05)


def test_it_shares_no_equations_with_what_it_judges():
    folder = Path(identifiability.benchmark.__file__).parent
    imported = set()
    judging = [
        "score",
        "solver",
        "coverage",
        "calibration",
        "nulls",
        "seeds",
        "responses",
        "speed",
        "peers",
        "durations",
        "real",
    ]
    for path in {*folder.glob("*.py")} - {folder / f"{name}.py" for name in judging}:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported.add(node.module)
            elif isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
    own = {name for name in imported if name.startswith("identifiability.")}
    assert {".".join(name.split(".")[:2]) for name in own} <= {
        "identifiability.benchmark",
        "identifiability.errors",
        "identifiability.measurement",
    }
    assert not [name for name in imported if name.split(".")[0] in ("jax", "jaxlib")]
