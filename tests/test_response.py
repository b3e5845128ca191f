"""Responses against closed forms, transfer functions and independent integrators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles import (
    agree,
    central_difference,
    kbi_impulse,
    kbi_sinusoid,
    kbi_step,
    kbi_transfer,
    msm_by_ode,
    msm_transfer,
)

from identifiability.errors import InputError
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.joint.effects.series_tendon import SeriesTendon
from identifiability.joint.exponentials import matrix_exponential
from identifiability.joint.model import KBI
from identifiability.joint.response import (
    drive_arrays,
    exact_response,
    simulate,
)
from identifiability.joint.scheme import EXACT, Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import (
    PERTURBATIONS,
    DoublePulse,
    Drive,
    Impulse,
    Pulse,
    SampledTorque,
    Sinusoid,
    Step,
    imposed_motion,
    multisine,
    prbs,
)

# One grid for nearly everything: each new length costs a compilation.
TIME = np.linspace(0.0, 0.1, 101)
DT = 1e-3
MSM = KBI() + SeriesTendon()
KBI_VALUES = np.array([54.98, 0.355, 0.0986])
MSM_VALUES = np.array([32.0, 3.2, 0.1, 100.0, 5.0, 0.1])  # with a path beside the muscle

REGIMES = {
    "underdamped": (54.98, 0.355, 0.0986),
    "overdamped": (50.0, 10.0, 0.1),
    "strongly overdamped": (50.0, 50.0, 0.005),
    "critical": (10.0, 2.0, 0.1),
    "nearly critical": (10.0 * (1 + 1e-9), 2.0, 0.1),
    "no stiffness": (0.0, 1.0, 0.1),
    "no damping": (50.0, 0.0, 0.1),
    "inertia alone": (0.0, 0.0, 0.1),
    "negative stiffness": (-50.0, 1.0, 0.1),
    "negative damping": (50.0, -2.0, 0.1),
}

# Every perturbation off its defaults, as torque of time, its edges, and its closed form.
TORQUES = {
    "impulse": (Impulse(0.7), lambda t: 0.0, ()),
    "step": (Step(3.0), lambda t: 3.0, ()),
    "pulse": (Pulse(20.0, 0.02), lambda t: 20.0 * (t < 0.02), (0.02,)),
    "double_pulse": (
        DoublePulse(15.0, 0.015),
        lambda t: 15.0 * (t < 0.015) - 15.0 * (0.015 <= t < 0.03),
        (0.015, 0.03),
    ),
    "sinusoid": (Sinusoid(), lambda t: 20.0 * np.sin(2 * np.pi * t / 0.03), ()),
}
KBI_FORMS = {
    "impulse": lambda *kbi: kbi_impulse(TIME, *kbi, 0.7),
    "step": lambda *kbi: kbi_step(TIME, *kbi, 3.0),
    "pulse": lambda *kbi: kbi_step(TIME, *kbi, 20.0) - kbi_step(TIME - 0.02, *kbi, 20.0),
    "double_pulse": lambda *kbi: (
        kbi_step(TIME, *kbi, 15.0)
        - 2 * kbi_step(TIME - 0.015, *kbi, 15.0)
        + kbi_step(TIME - 0.03, *kbi, 15.0)
    ),
    "sinusoid": lambda *kbi: kbi_sinusoid(TIME, *kbi),
}
SAMPLED = {
    "first-order": multisine(TIME, amplitude=5.0, frequencies=np.arange(1, 30) * 10.0, seed=3),
    "zero-order": multisine(
        TIME, amplitude=5.0, frequencies=np.arange(1, 30) * 10.0, seed=3, hold="zero-order"
    ),
    "prbs": prbs(TIME, amplitude=5.0, dwell=0.007, seed=5),
}
ALL_TORQUES = {key: made for key, (made, _, _) in TORQUES.items()} | SAMPLED


def test_every_perturbation_is_covered():
    assert set(TORQUES) == set(KBI_FORMS) == set(PERTURBATIONS)


# Closed forms and transfer functions


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("key", TORQUES)
def test_kbi_is_its_closed_form(key, regime):
    values = REGIMES[regime]
    agree(simulate(KBI(), values, TORQUES[key][0].drive(TIME)), KBI_FORMS[key](*values), 1e-10)


def test_a_wrong_sign_of_the_damping_is_noticed():
    K, B, I = REGIMES["underdamped"]
    wrong = simulate(KBI(), (K, -B, I), TORQUES["impulse"][0].drive(TIME))
    with pytest.raises(AssertionError):
        agree(wrong, KBI_FORMS["impulse"](K, B, I), 1e-10)


@pytest.mark.parametrize(
    ("model", "values", "transfer"),
    [(KBI(), KBI_VALUES, kbi_transfer), (MSM, MSM_VALUES, msm_transfer)],
    ids=["kbi", "msm"],
)
@pytest.mark.parametrize("key", ["impulse", "step", *SAMPLED])
def test_transfer_function(model, values, transfer, key):
    system = transfer(*values)
    made = ALL_TORQUES[key]
    if key == "impulse":
        expected = 0.7 * scipy.signal.impulse(system, T=TIME)[1]
    elif key == "step":
        expected = 3.0 * scipy.signal.step(system, T=TIME)[1]
    else:
        first_order = made.hold == "first-order"
        expected = scipy.signal.lsim(system, made.values, TIME, interp=first_order)[1]
    agree(simulate(model, values, made.drive(TIME)), expected, 1e-9)


@pytest.mark.parametrize("key", TORQUES)
def test_msm_is_its_third_order_ode(key):
    made, torque, edges = TORQUES[key]
    size = 0.7 if key == "impulse" else 0.0
    expected = msm_by_ode(TIME, *MSM_VALUES, torque, edges, size)
    agree(simulate(MSM, MSM_VALUES, made.drive(TIME)), expected, 2e-9)


def test_msm_without_damping_is_two_springs_in_series():
    K, I, K_SE = 32.0, 0.1, 100.0
    found = simulate(MSM, (K, 0.0, I, K_SE, 0.0, 0.0), Impulse().drive(TIME))
    agree(found, kbi_impulse(TIME, K * K_SE / (K + K_SE), 0.0, I), 1e-6)


def test_matrix_exponential():
    rng = np.random.default_rng(1)
    for scale in (1e-12, 1e-3, 1.0, 30.0):
        matrix = scale * rng.standard_normal((4, 4))
        agree(matrix_exponential(jnp.asarray(matrix)), scipy.linalg.expm(matrix), 1e-12)
    defective = np.array([[-2.0, 1.0], [0.0, -2.0]])
    agree(matrix_exponential(jnp.asarray(defective)), scipy.linalg.expm(defective), 1e-14)
    agree(matrix_exponential(jnp.zeros((3, 3))), np.eye(3), 1e-16)


# The general integrator


def smooth_motion(t):
    """An angle with rest before it and after it, and no corner up to its third derivative."""
    return 0.05 * np.sin(np.pi * np.clip(t / 0.08, 0, 1)) ** 6


@pytest.mark.parametrize(("model", "values"), [(KBI(), KBI_VALUES), (MSM, MSM_VALUES)])
@pytest.mark.parametrize("key", [*ALL_TORQUES, "imposed angle"])
def test_integrator_agrees_with_exact_response(model, values, key):
    if key == "imposed angle":
        drive = imposed_motion(TIME, smooth_motion(TIME))
    else:
        drive = ALL_TORQUES[key].drive(TIME)
    agree(simulate(model, values, drive, scheme=Scheme(16)), simulate(model, values, drive), 1e-9)


def test_integrator_is_of_fourth_order():
    drive = Sinusoid().drive(TIME)
    exact = simulate(MSM, MSM_VALUES, drive)
    coarse, fine = (
        np.max(np.abs(simulate(MSM, MSM_VALUES, drive, scheme=Scheme(n)) - exact)) for n in (1, 2)
    )
    assert 12 < coarse / fine < 20


# Properties of a linear joint at rest

row_of_torques = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).uniform(-10, 10, TIME.size)
)
msm_values = st.tuples(
    st.floats(0, 300),
    st.floats(0.5, 50),
    st.floats(0.02, 1),
    st.floats(10, 2000),
    st.floats(0, 100),
    st.floats(0, 2),
)


@given(msm_values, row_of_torques, row_of_torques, st.floats(-3, 3), st.floats(-3, 3))
def test_superposition(values, one, other, a, b):
    def respond(torque):
        return simulate(MSM, values, SampledTorque(torque).drive(TIME))

    parts = np.stack([a * respond(one), b * respond(other)])
    whole = respond(a * one + b * other)
    assert np.max(np.abs(whole - parts.sum(axis=0))) <= 1e-10 * max(np.max(np.abs(parts)), 1e-12)


@given(msm_values, st.integers(0, 60), st.sampled_from(sorted(PERTURBATIONS)))
def test_a_later_onset_shifts_the_response(values, samples, key):
    perturbation = PERTURBATIONS[key]
    now = simulate(MSM, values, perturbation().drive(TIME))
    later = simulate(MSM, values, perturbation(onset=samples * DT).drive(TIME))
    assert np.all(later[:samples] == 0)
    agree(later[samples:], now[: TIME.size - samples], 1e-10)


@given(msm_values, st.floats(-100, 100), st.sampled_from(sorted(PERTURBATIONS)))
def test_response_is_proportional_to_the_torque(values, factor, key):
    made = PERTURBATIONS[key]
    field = "size" if key == "impulse" else "amplitude"
    unit = simulate(MSM, values, made(**{field: 1.0}).drive(TIME))
    found = simulate(MSM, values, made(**{field: factor}).drive(TIME))
    error = np.max(np.abs(found - factor * unit))
    # The smallest numbers have fewer digits.
    assert error <= 1e-12 * abs(factor) * np.max(np.abs(unit)) + np.finfo(float).tiny


def test_the_start_of_the_clock_does_not_matter():
    at_zero = simulate(KBI(), KBI_VALUES, Impulse().drive(TIME))
    later = simulate(KBI(), KBI_VALUES, Impulse(onset=5.0).drive(TIME + 5.0))
    agree(later, at_zero, 1e-9)


@pytest.mark.parametrize("scheme", [EXACT, Scheme(1)])
def test_a_batch_equals_one_by_one(scheme):
    rng = np.random.default_rng(0)
    batch = MSM_VALUES * rng.uniform(0.2, 5, (2, 3, MSM_VALUES.size))
    drive = Step().drive(TIME)
    found = simulate(MSM, batch, drive, scheme=scheme)
    assert found.shape == (2, 3, TIME.size)
    for index in np.ndindex(2, 3):
        agree(found[index], simulate(MSM, batch[index], drive, scheme=scheme), 1e-12)


def test_wrong_shapes_are_refused():
    drive = Impulse().drive(TIME)
    with pytest.raises(InputError, match=r"shape \(6,\), expected \(\.\.\., 3\)"):
        simulate(KBI(), MSM_VALUES, drive)


# Derivatives


def exact_jacobian(model, values, drive):
    arrays = drive_arrays(drive)
    return np.asarray(jax.jit(jax.jacfwd(lambda x: exact_response(model, x, arrays)))(values))


@pytest.mark.parametrize(
    ("model", "values"),
    [
        (KBI(), KBI_VALUES),
        (KBI(), np.array([10.0, 2.0, 0.1])),
        (KBI(), np.array([0.0, 0.0, 0.1])),
        (MSM, MSM_VALUES),
    ],
    ids=["kbi", "kbi, critical", "inertia alone", "msm"],
)
@pytest.mark.parametrize("key", ["impulse", "sinusoid", "imposed angle"])
def test_gradient_of_the_exact_response(model, values, key):
    if key == "imposed angle":
        drive = imposed_motion(TIME, smooth_motion(TIME))
    else:
        drive = ALL_TORQUES[key].drive(TIME)
    found = exact_jacobian(model, jnp.asarray(values), drive)
    size = np.maximum(values, [1.0, 0.1, 0.01, 1.0, 1.0, 0.1][: values.size])
    expected = central_difference(lambda x: simulate(model, x, drive), values, size, 1e-3)
    for column in range(values.size):
        agree(found[:, column], expected[:, column], 1e-7)


@pytest.mark.parametrize(
    ("model", "values"),
    [(KBI(), KBI_VALUES), (KBI(), np.array([10.0, 2.0, 0.1])), (MSM, MSM_VALUES)],
    ids=["kbi", "kbi, critical", "msm"],
)
def test_gradient_and_hessian_of_a_problem(model, values):
    # Data of another joint, so that the residual does not vanish.
    drive = Impulse().drive(TIME)
    measured = kbi_impulse(TIME, 40.0, 1.5, 0.09)
    problem = Problem(model, [observe(drive, measured, Noise(0.01))], Prior.physical(model))
    jacobian, hessian = problem.jacobian(values), problem.hessian(values)
    size = np.asarray(values)
    expected = central_difference(problem.residuals, values, size, 1e-3)

    def gradient(x):
        return problem.jacobian(x).T @ problem.residuals(x)

    second = central_difference(gradient, values, size, 1e-3)
    agree(jacobian * size, expected * size, 1e-8)
    agree(hessian * np.outer(size, size), second * np.outer(size, size), 1e-7)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-8, atol=1e-10 * np.abs(hessian).max())


# The other causality


@pytest.mark.parametrize("regime", ["underdamped", "overdamped", "no stiffness", "no damping"])
def test_torque_for_a_cubic_motion_is_exact(regime):
    K, B, I = REGIMES[regime]
    cubic = np.polynomial.Polynomial([0.0, 0.3, -8.0, 90.0])
    expected = K * cubic(TIME) + B * cubic.deriv()(TIME) + I * cubic.deriv(2)(TIME)
    agree(simulate(KBI(), (K, B, I), imposed_motion(TIME, cubic(TIME))), expected, 1e-9)


def test_torque_of_a_held_angle_is_that_of_the_springs():
    held = imposed_motion(TIME, np.full(TIME.size, 0.2))
    K, _, _, K_SE, beside, _ = MSM_VALUES
    expected = np.full(TIME.size, 0.2 * (K * K_SE / (K + K_SE) + beside))
    agree(simulate(MSM, MSM_VALUES, held), expected, 1e-10)
    agree(simulate(MSM, MSM_VALUES, held, scheme=Scheme(1)), expected, 1e-10)


@pytest.mark.parametrize(("model", "values"), [(KBI(), KBI_VALUES), (MSM, MSM_VALUES)])
def test_torque_from_the_simulated_angle_is_the_imposed_one(model, values):
    errors = []
    for window in (0.4, 0.2):
        # The same number of samples over a shorter time: the spline's error falls as interval².
        time = np.linspace(0.0, window, TIME.size)
        torque = SampledTorque(10.0 * np.sin(2 * np.pi * time / 0.4) ** 4)
        angle = simulate(model, values, torque.drive(time))
        found = simulate(model, values, imposed_motion(time, angle))
        errors.append(np.max(np.abs(found - torque.values)[5:-5]))
    assert errors[1] < 0.003 * 10.0
    assert errors[1] < 0.4 * errors[0]


# No parameter vector within the bounds leads to a response that is not a number


def within_bounds(model):
    return st.tuples(*(st.floats(p.lower, p.upper) for p in model.parameters.values()))


@settings(max_examples=60)
@given(within_bounds(KBI()), within_bounds(MSM), st.sampled_from(sorted(PERTURBATIONS)))
@example((0.0, 0.0, 0.005), (0.0, 0.0, 0.005, 20000.0, 0.0, 0.0), "impulse")
@example((2000.0, 0.0, 0.005), (2000.0, 0.0, 0.005, 20000.0, 0.0, 0.0), "sinusoid")
@example((0.0, 50.0, 0.005), (0.0, 50.0, 0.005, 1.0, 0.0, 0.0), "sinusoid")
@example((2000.0, 50.0, 1.0), (2000.0, 1e-300, 1.0, 1.0, 0.0, 0.0), "step")
@example((2000.0, 5e-324, 1.0), (0.0, 1e-10, 1.0, 1.0, 0.0, 0.0), "double_pulse")
def test_no_response_is_ever_nan(kbi, msm, key):
    drive = PERTURBATIONS[key]().drive(TIME)
    largest = 20.0 * TIME[-1] / 0.005 * TIME[-1]  # that torque on the least inertia all the time
    for model, values in ((KBI(), kbi), (MSM, msm)):
        response = simulate(model, values, drive)
        assert np.all(np.isfinite(response))
        if key != "impulse":
            assert np.max(np.abs(response)) <= largest


IMPULSE = Impulse().drive(TIME)
ANYTHING = np.zeros(TIME.size)
KBI_PROBLEM, MSM_PROBLEM = (
    Problem(model, [observe(IMPULSE, ANYTHING, Noise(1.0))], Prior.physical(model))
    for model in (KBI(), MSM)
)


@settings(max_examples=60)
@given(within_bounds(KBI()), within_bounds(MSM))
@example((0.0, 0.0, 0.005), (0.0, 0.0, 0.005, 20000.0, 0.0, 0.0))
@example((10.0, 2.0, 0.1), (10.0, 2.0, 0.1, 20000.0, 0.0, 0.0))
@example((2000.0, 0.0, 0.005), (2000.0, 1e-10, 0.005, 20000.0, 0.0, 0.0))
def test_no_derivative_is_ever_nan(kbi, msm):
    for problem, values in ((KBI_PROBLEM, kbi), (MSM_PROBLEM, msm)):
        assert np.all(np.isfinite(problem.jacobian(values)))
        assert np.all(np.isfinite(problem.hessian(values)))


# Time grids


def test_edges_must_lie_on_samples():
    with pytest.raises(InputError, match="between two samples"):
        Pulse(duration=0.0105).drive(TIME)
    with pytest.raises(InputError, match="before the grid starts"):
        Impulse(onset=-0.01).drive(TIME)
    with pytest.raises(InputError, match="not uniform"):
        Step().drive(np.array([0.0, 1.0, 3.0]))


@pytest.mark.parametrize("key", ALL_TORQUES)
def test_signals_of_a_drive_are_its_torque(key):
    drive = ALL_TORQUES[key].drive(TIME)
    assert isinstance(drive, Drive)
    if key in TORQUES:
        # At an edge the drive already has the value after it.
        torque = np.array([TORQUES[key][1](t + 1e-9) for t in TIME])
        np.testing.assert_allclose(drive.signals[:, 0], torque, atol=1e-4)
    else:
        np.testing.assert_allclose(drive.signals[:, 0], ALL_TORQUES[key].values)
    assert drive.impulses.sum() == (0.7 if key == "impulse" else 0.0)


def test_an_event_after_the_end_has_no_effect():
    for perturbation in (Impulse(onset=0.2), Step(onset=0.2), Sinusoid(onset=0.2)):
        assert np.all(simulate(KBI(), KBI_VALUES, perturbation.drive(TIME)) == 0)
