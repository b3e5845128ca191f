"""What every effect promises; one in the registry is held to it, and one's own is by listing it."""

import inspect
import itertools
from typing import NamedTuple

import jax
import numpy as np
import pytest
import scipy.linalg
from kinds import (
    DRIVES,
    KBI_VALUES,
    KINDS,
    LINEAR,
    TIME,
    TORQUE,
    nulls_of,
    respond,
    values_of,
)
from matplotlib.mathtext import MathTextParser
from oracles import agree

from identifiability.joint.effects import EFFECTS
from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.integrator import integrate
from identifiability.joint.model import KBI, Model
from identifiability.joint.native.response import responses_of
from identifiability.joint.programs import compiled
from identifiability.joint.response import drive_arrays, exact_response, simulate
from identifiability.joint.scheme import EXACT, Scheme
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion

# Smooth in pieces: their rates have corners, at rest (short range, friction), at the threshold and
# where activation becomes deactivation (reflex). Second derivatives of the steps do not see these.
IN_PIECES = {"backlash", "coulomb_friction", "end_stop", "short_range_stiffness", "stretch_reflex"}
# Sensors that read the response between its samples, and how well: this is no matter of the steps.
BETWEEN_SAMPLES = {"sensor_delay": 3e-4, "sensor_lowpass": 2e-3}
# Bounds within which the joint of KBI_VALUES is stable, where the effect can feed energy into it,
# and a millisecond is a short time for it.
STABLE = {
    "activation_lag.gain": (0.0, 200.0),
    "backlash.stiffness": (1.0, 500.0),
    "backlash.time": (5e-5, 0.005),
    "backlash.share": (0.2, 0.8),
    "coulomb_friction.range": (2e-4, 0.005),
    "coulomb_friction.damping": (0.0, 5.0),
    "cubic_stiffness.coefficient": (0.0, 20000.0),
    "cubic_stiffness.centre": (-0.01, 0.01),
    "damping_by_angle.difference": (-3.9, 3.9),
    "damping_by_direction.difference": (-1.9, 1.9),
    "gravity.moment": (0.0, 100.0),
    "gravity.posture": (-1.5, 1.5),
    "end_stop.stiffness": (0.0, 200.0),
    "end_stop.angle": (0.1, 1.5),  # no joint is held by its stop alone
    "end_stop.middle": (-0.01, 0.01),
    "quadratic_stiffness.coefficient": (-100.0, 200.0),
    "sensor_delay.delay": (0.0, 0.05),  # a negative one reads beyond the end of a record
    "sensor_drift.rate": (-0.1, 0.1),
    "sensor_drift.bend": (-0.1, 0.1),
    "sensor_drift.twist": (-0.1, 0.1),
    "stretch_reflex.position_gain": (0.0, 100.0),
    "stretch_reflex.velocity_gain": (0.0, 5.0),
}


@pytest.fixture(params=sorted(KINDS))
def effect(request):
    return KINDS[request.param]()


@pytest.fixture(params=DRIVES)
def driven(request):
    return request.param


class Response(NamedTuple):
    """Of a model, solved exactly or integrated."""

    model: Model
    exact: bool = False


@compiled
def slopes(kind, values, size, arrays):
    """A response, and its first derivatives with respect to parameters in units of their size."""
    model, exact = kind

    def twice(x):
        theta = values + size * x
        if exact:
            response = exact_response(model, theta, arrays)
        else:
            response = integrate(model, theta, arrays, 1)
        return response, response

    derivatives, response = jax.jacfwd(twice, has_aux=True)(np.zeros(size.size))
    return response, derivatives


@compiled
def bends(kind, values, size, directions, arrays):
    """First and second derivatives of the integrated response along each of some directions."""

    def response(x):
        return integrate(kind.model, values + size * x, arrays, 1)

    def along(direction):
        def first(x):
            return jax.jvp(response, (x,), (direction,))[1]

        return jax.jvp(first, (np.zeros(size.size),), (direction,))

    return jax.vmap(along)(directions)


def differences(results, step):
    """Derivative from results at -2, -1, 1 and 2 steps, along the first axis."""
    return np.tensordot([1.0, -8.0, 8.0, -1.0], results, axes=1) / (12 * step)


def halved(drive):
    """The first half of the same drive, at twice the rate: of as many samples."""
    half = scipy.linalg.expm(drive.generator * drive.interval / 2)
    states = np.stack([drive.states, drive.states @ half.T], axis=1)
    states = states.reshape(-1, states.shape[-1])[: len(drive.states)]
    return Drive(drive.interval / 2, drive.generator, drive.readout, states, drive.impulses)


# What it declares


def test_key_place_and_kind(effect):
    assert KINDS[effect.key] is type(effect)
    assert effect.key == effect.key.lower()
    assert effect.key.isidentifier()
    assert effect.place in {"joint", "muscle", "series", "coupling", "sensor"}
    assert effect.kind == ("measurement" if effect.place == "sensor" else "physics")
    assert isinstance(effect.linear, bool)
    assert isinstance(effect.n_states, int)
    assert effect.n_states >= 0
    # What it says itself, or the effect of which it is a richer form.
    own = {name for kind in set(type(effect).__mro__) - set(Effect.__mro__) for name in vars(kind)}
    assert ("rates" in own) == (effect.n_states > 0)
    if effect.place == "sensor":
        assert "record" in own
        assert not {"torque", "rates", "delay"} & own
    else:
        assert "torque" in own
        assert "record" not in own
    if effect.place == "series":
        assert effect.n_states == 0


def test_title_reads_in_a_sentence(effect):
    first = effect.title.split()[0]
    assert first.islower() or first.endswith("'s"), "begins like a sentence, not like a name"
    assert effect.title == effect.title.strip(" .,;:")
    assert 1 < len(f"The joint may have {effect.title}.".split()) <= 15


def test_what_it_is_confused_with_is_registered(effect):
    for keys in (effect.confused_with, effect.equivalent, effect.refines):
        assert isinstance(keys, tuple)
        assert len(set(keys)) == len(keys)
        assert set(keys) <= set(EFFECTS) - {effect.key}
    assert set(effect.equivalent) | set(effect.refines) <= set(effect.confused_with)
    if effect.key in EFFECTS:
        assert effect.confused_with
        for key in effect.equivalent:
            assert effect.key in EFFECTS[key].equivalent


def test_docstring_says_what_it_is(effect):
    own = type(effect).__doc__
    assert own
    assert own != Effect.__doc__
    assert len(inspect.cleandoc(own)) > 60


def test_references_can_be_found(effect):
    assert effect.references
    for reference in effect.references:
        # An author, and a year of four digits.
        assert any(word.strip("(),.:").isdigit() for word in reference.split())
        assert len(reference) > 20


def test_parameters_are_declared_sanely(effect):
    assert effect.parameters
    names = [parameter.name for parameter in effect.parameters]
    assert len(set(names)) == len(names)
    parser = MathTextParser("agg")
    for p in effect.parameters:
        assert p.name.isidentifier()
        assert p.lower <= p.nominal <= p.upper
        assert np.isfinite([p.lower, p.nominal, p.upper]).all()
        assert p.plain is None or p.lower <= p.plain <= p.upper
        assert p.null is None or np.isinf(p.null) or p.lower <= p.null <= p.upper
        assert len(p.description.split()) >= 2
        assert p.unit
        assert "deg" not in p.unit
        assert "$" not in p.symbol
        parser.parse(f"${p.symbol}$")
    # It can vanish, and has more to it than refinements.
    assert nulls_of(effect)
    assert any(p.plain is None for p in effect.parameters)


def test_affine_in_velocity_is_true(effect):
    if effect.place != "muscle" or not effect.affine_in_velocity:
        return
    p = [parameter.nominal for parameter in effect.parameters]
    states, past = np.full(effect.n_states, 0.01), Motion(0.0, 0.0)
    torque = [effect.torque(p, Motion(0.1, v), states, past) for v in (-20.0, 0.0, 20.0)]
    assert abs(torque[0] - 2 * torque[1] + torque[2]) <= 1e-12 * max(np.abs(torque))


# What it does


def test_it_vanishes_at_its_null_values(effect, driven):
    model, drive, null = KBI() + effect, DRIVES[driven], nulls_of(effect)
    expected = simulate(KBI(), values_of(KBI()), drive)

    def distance(changes, by=respond):
        found = by(model, values_of(model, **changes), drive)
        return np.max(np.abs(found - expected)) / np.max(np.abs(expected))

    # Away from them there is something to see.
    assert distance({}) > 1e-4
    if np.all(np.isfinite(list(null.values()))):
        assert distance(null) < 1e-9
        return
    # An infinite value is approached with its inverse, in steps that follow a stiff link.
    finite = {name: value for name, value in null.items() if np.isfinite(value)}
    (name,) = set(null) - set(finite)
    nominal = dict(zip(model.parameter_names, model.nominal, strict=True))
    factors = (30.0, 90.0, 270.0) if effect.place == "coupling" else (10.0, 30.0, 90.0)
    errors = [distance(finite | {name: nominal[name] * f}, by=simulate) for f in factors]
    assert errors[-1] < 5e-3
    np.testing.assert_allclose(errors[0] / errors[1], 3.0, rtol=0.1)
    np.testing.assert_allclose(errors[1] / errors[2], 3.0, rtol=0.1)


SETTLING = [key for key, kind in KINDS.items() if kind().settling(dict.fromkeys("KBI", 1.0))]


@pytest.mark.parametrize("key", SETTLING)
def test_states_settle_as_slowly_as_is_said(key):
    """They are linear in themselves, and no step that follows from their rate is unstable."""
    effect, rng = KINDS[key](), np.random.default_rng(3)
    lower, upper = (
        np.array([getattr(p, end) for p in effect.parameters]) for end in ("lower", "upper")
    )

    def slopes_at(theta, velocity, states):
        motion = Motion(0.0, velocity)
        return jax.jacfwd(lambda z: effect.rates(theta, motion, z, motion))(states)

    quick, most = jax.jit(slopes_at), 0.0
    for _ in range(500):
        theta = lower + (upper - lower) * rng.uniform(0, 1, lower.size) ** 4
        velocity = rng.choice([-1, 1]) * 10 ** rng.uniform(-5, 2)
        one, other = (
            np.asarray(quick(theta, velocity, size * rng.standard_normal(effect.n_states)))
            for size in (1e-4, 1.0)
        )
        np.testing.assert_allclose(one, other, rtol=1e-9)
        paces = -np.linalg.eigvals(one).real
        assert np.all(paces >= 0)
        most = max(most, float(np.max(paces)))
    values = dict.fromkeys("KBI", 1.0)
    assert 0.5 * effect.settling(values) < most <= effect.settling(values)


def test_some_effect_settles_so():
    assert SETTLING


# Derivatives are taken of few models, of several effects each, for they take long to compile.
def _team(key):
    if key in IN_PIECES:
        return "in pieces"
    if key in LINEAR:
        return "linear"
    return "with memory" if KINDS[key]().has_memory else "without memory"


TEAMS = {team: [key for key in sorted(KINDS) if _team(key) == team] for team in map(_team, KINDS)}


@pytest.fixture(params=sorted(TEAMS))
def team(request):
    return request.param


def joint(team):
    return sum((KINDS[key]() for key in TEAMS[team]), start=KBI())


def test_derivatives_are_right(team, driven):
    model, drive = joint(team), DRIVES[driven]
    values = values_of(model)
    size = np.abs(values)
    # A wide difference could reach over a corner.
    step = 1e-5 if team == "in pieces" else 1e-4
    shifts = step * np.array([-2, -1, 1, 2])
    points = values + shifts[:, None, None] * np.diag(size)
    expected = differences(respond(model, points, drive), step).T
    response, found = map(np.asarray, slopes(Response(model), values, size, drive_arrays(drive)))
    for column in range(values.size):
        agree(found[:, column], expected[:, column], 1e-6)
    # Machine code and JAX take the same steps.
    both = np.column_stack([response, found / size])
    code = responses_of(model, tuple(range(values.size)), [drive], Scheme(1)).at(values)[0]
    for column in range(values.size + 1):
        agree(code[:, column], both[:, column], 1e-9)
    # Each of the effects' own parameters matters.
    assert np.all(np.max(np.abs(found[:, 3:]), axis=0) > 1e-7 * np.max(np.abs(found)))


# Fits and widths of what is not linear take differences of first derivatives, for these take half a
# minute to compile. Linear models have exact responses, whose second derivatives are tested with
# these.
@pytest.mark.long
@pytest.mark.parametrize("team", sorted(set(TEAMS) - {"in pieces", "linear"}))
def test_second_derivatives_are_right(team):
    model = joint(team)
    values, step = values_of(model), 1e-4
    size, k = np.abs(values), values.size
    askew = np.random.default_rng(0).uniform(0.5, 1.0, k)
    given = size, np.vstack([np.eye(k), askew]), drive_arrays(DRIVES["torque"])
    seconds = np.asarray(bends(Response(model), values, *given)[1])
    moved = [values + shift * askew * size for shift in step * np.array([-2, -1, 1, 2])]
    nearby = [np.asarray(bends(Response(model), at, *given)[0])[-1] for at in moved]
    agree(seconds[-1], differences(nearby, step), 1e-6)


def test_integrated_and_exact_responses_agree(driven):
    model, drive = joint("linear"), DRIVES[driven]
    values = values_of(model)
    # Steps are exact for a torque that is linear within them, but not for an imposed motion.
    rtol = 1e-9 if driven == "torque" else 1e-6
    size = np.abs(values)
    response, expected = slopes(Response(model, exact=True), values, size, drive_arrays(drive))
    exact, steps = (
        responses_of(model, tuple(range(values.size)), [drive], scheme).at(values)[0]
        for scheme in (EXACT, Scheme(1))
    )
    for found, tolerance in ((exact, 1e-9), (steps, rtol)):
        agree(found[:, 0], response, tolerance)
        agree(found[:, 1:] * size, expected, tolerance)


def test_no_answer_before_its_cause(effect):
    model, cut = KBI() + effect, 120
    torque = np.random.default_rng(0).uniform(-5, 5, TIME.size)
    changed = torque.copy()
    changed[cut:] += 3.0
    one, other = (
        respond(model, values_of(model), SampledTorque(t, hold="zero-order").drive(TIME))
        for t in (torque, changed)
    )
    assert np.array_equal(one[: cut + 1], other[: cut + 1])
    assert not np.array_equal(one, other)


def test_no_answer_before_its_cause_when_the_angle_is_imposed(effect):
    model, cut, drive = KBI() + effect, 120, DRIVES["angle"]
    states = drive.states.copy()
    states[cut:, 0] += 0.01
    changed = Drive(drive.interval, drive.generator, drive.readout, states, drive.impulses)
    one, other = (respond(model, values_of(model), d) for d in (drive, changed))
    assert np.array_equal(one[:cut], other[:cut])
    assert not np.array_equal(one[cut:], other[cut:])


def test_only_a_negative_sensor_delay_answers_before_its_cause():
    # It stands for an imposed signal that was recorded late, so this is what it has to do.
    model = KBI() + EFFECTS["sensor_delay"]()
    values = values_of(model, **{"sensor_delay.delay": -0.02})
    cut = 120
    drive = SampledTorque(np.where(np.arange(TIME.size) < cut, 0.0, 3.0), hold="zero-order")
    answered = np.flatnonzero(respond(model, values, drive.drive(TIME)))[0]
    assert cut - 22 <= answered <= cut - 18


def test_a_joint_left_alone_or_held_is_at_rest(effect):
    if effect.key == "sensor_drift":
        pytest.skip("it drifts")
    model, drive = KBI() + effect, SampledTorque(np.zeros(TIME.size)).drive(TIME)
    assert np.all(respond(model, values_of(model), drive) == 0.0)
    drive = imposed_motion(TIME, np.full(TIME.size, 0.1))
    torque = respond(model, values_of(model), drive)
    agree(torque, np.full(TIME.size, torque[-1]), 1e-9)
    assert torque[-1] > 1.0


def box(effect):
    """Parameter vectors: every combination of each parameter's bounds and nominal value."""
    spans = []
    for p in effect.parameters:
        lower, upper = STABLE.get(f"{effect.key}.{p.name}", (p.lower, p.upper))
        spans.append(sorted({lower, float(np.clip(p.nominal, lower, upper)), upper}))
    return np.array([(*KBI_VALUES.values(), *own) for own in itertools.product(*spans)])


@pytest.mark.parametrize("order", [4, 2])
def test_steps_of_a_millisecond_are_stable(effect, driven, order):
    model, values, drive = KBI() + effect, box(effect), DRIVES[driven]
    if order == 2 and (effect.linear or (driven == "angle" and model.n_internal == 0)):
        pytest.skip("what is linear, or has no states, is solved alike by steps of either order")
    found = respond(model, values, drive, order)
    assert np.all(np.isfinite(found))
    if driven == "torque":
        # A joint that gives no energy moves no farther than its inertia would without the rest.
        inertia = np.array([model.inertia(v) for v in values])
        free = np.cumsum(np.cumsum(TORQUE))[-1] * 1e-6 / inertia
        assert np.all(np.max(np.abs(found), axis=1) <= free)
    # Half the step does not tell a different story, not even in the corners of the box.
    finer = respond(model, values, halved(drive), order)[:, ::2]
    change = np.max(np.abs(found[:, :101] - finer), axis=1) / np.max(np.abs(found), axis=1)
    assert np.max(change) < {4: 0.05, 2: 0.5}[order]
    # At typical values steps of a millisecond are enough.
    typical = values_of(model)
    coarse, finer = (respond(model, typical, d, order) for d in (drive, halved(drive)))
    # Where the effect is in pieces its corners fall inside steps, and a contact is the sharpest.
    corner = 3e-4 if effect.key == "backlash" else 1e-5 if effect.key in IN_PIECES else 1e-6
    # Two stages see it at its ends only, which is worst where the angle is imposed.
    rough = 2e-3 if (effect.key, driven) == ("backlash", "angle") else 1e-3
    fine = {4: corner, 2: rough}[order]
    agree(coarse[:101], finer[::2], BETWEEN_SAMPLES.get(effect.key, fine))


def test_both_causalities_tell_the_same_story(effect):
    if effect.kind == "measurement":
        pytest.skip("it distorts the response, which is the angle in one case, the torque in other")
    model = KBI() + effect
    angle = respond(model, values_of(model), DRIVES["torque"])
    found = respond(model, values_of(model), imposed_motion(TIME, angle))
    # As far as a spline through the samples of the angle goes: friction and contact bend it.
    agree(found, TORQUE, 5e-3 if effect.key in {"backlash", "coulomb_friction"} else 5e-4)
    without = simulate(KBI(), values_of(KBI()), imposed_motion(TIME, angle))
    assert np.max(np.abs(without - TORQUE)) > 10 * np.max(np.abs(found - TORQUE))
