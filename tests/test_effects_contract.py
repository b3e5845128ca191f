"""What every effect in the registry promises; a new effect is tested by being registered."""

import inspect
import pickle
from functools import partial

import jax
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from oracles import agree, central_difference

from identifiability.errors import InputError
from identifiability.joint.effects import EFFECTS
from identifiability.joint.effects.base import Effect
from identifiability.joint.integrator import integrate
from identifiability.joint.model import KBI, KBI_PARAMETERS
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import drive_arrays, exact_response, simulate
from identifiability.measurement.perturbations import Drive, SampledTorque, imposed_motion

# 100 ms of a smooth torque that begins and ends at rest.
TIME = np.linspace(0.0, 0.1, 101)
TORQUE = SampledTorque(10 * np.sin(np.pi * TIME / 0.1) ** 4)
KBI_VALUES = {"K": 50.0, "B": 2.0, "I": 0.1}
SUBSTEPS = 4


class ParallelSpring(Effect):
    """A second spring over the joint: something to combine the registered effects with."""

    key = "parallel_spring"
    place = "joint"
    linear = True
    parameters = (
        Parameter("stiffness", "k", "Nm/rad", 5.0, 0.0, 100.0, "parallel stiffness", null=0.0),
    )

    def torque(self, p, motion, states, delayed):
        return p[0] * motion.angle


@pytest.fixture(params=sorted(EFFECTS))
def effect(request):
    return EFFECTS[request.param]()


def values_of(model, **changes):
    """Parameter vector: the KBI above, effects at their nominal values, some changed by name."""
    nominal = dict(zip(model.parameter_names, model.nominal, strict=True))
    return model.vector(nominal | KBI_VALUES | changes)


def respond(model, values, drive):
    return simulate(model, values, drive, substeps=None if model.linear else SUBSTEPS)


@partial(jax.jit, static_argnums=0)
def jacobian(model, values, arrays, fine):
    def response(x):
        if model.linear:
            return exact_response(model, x, arrays)
        return integrate(model, x, arrays, fine, SUBSTEPS)

    return jax.jacfwd(response)(values)


# What it declares


def test_key_and_place(effect):
    assert EFFECTS[effect.key] is type(effect)
    assert effect.key == effect.key.lower()
    assert effect.key.isidentifier()
    assert effect.place in {"joint", "muscle", "series"}
    assert isinstance(effect.linear, bool)
    assert isinstance(effect.n_states, int)
    assert effect.n_states >= 0


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
    for parameter in effect.parameters:
        assert parameter.name.isidentifier()
        assert parameter.lower <= parameter.nominal <= parameter.upper
        assert np.isfinite([parameter.lower, parameter.nominal, parameter.upper]).all()
        assert len(parameter.description.split()) >= 2
        assert parameter.unit
        assert "deg" not in parameter.unit
        assert "$" not in parameter.symbol
        parser.parse(f"${parameter.symbol}$")
    assert any(parameter.null is not None for parameter in effect.parameters)


# What it does


NULL_CASES = [
    pytest.param(kind(), parameter, id=f"{key}.{parameter.name}")
    for key, kind in sorted(EFFECTS.items())
    for parameter in kind.parameters
    if parameter.null is not None
]


@pytest.mark.parametrize(("effect", "parameter"), NULL_CASES)
def test_it_vanishes_at_its_null_value(effect, parameter):
    model, drive = KBI() + effect, TORQUE.drive(TIME)
    expected = respond(KBI(), values_of(KBI()), drive)
    name = f"{effect.key}.{parameter.name}"

    def distance(value):
        found = respond(model, values_of(model, **{name: value}), drive)
        return np.max(np.abs(found - expected)) / np.max(np.abs(expected))

    # Away from it there is something to see.
    assert distance(parameter.nominal) > 1e-4
    if np.isfinite(parameter.null):
        assert distance(parameter.null) < (1e-9 if model.linear else 1e-6)
        return
    errors = [distance(parameter.nominal * factor) for factor in (1e2, 1e3, 1e4)]
    assert errors[-1] < 1e-3
    np.testing.assert_allclose(errors[0] / errors[1], 10.0, rtol=0.1)
    np.testing.assert_allclose(errors[1] / errors[2], 10.0, rtol=0.1)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_derivatives_are_right(effect, driven):
    model = KBI() + effect
    values = values_of(model)
    if driven == "torque":
        drive = TORQUE.drive(TIME)
    else:
        drive = imposed_motion(TIME, 0.05 * np.sin(np.pi * TIME / 0.1) ** 4)
    found = np.asarray(jacobian(model, values, drive_arrays(drive), drive.refined(SUBSTEPS)))
    size = np.maximum(np.abs(values), 1e-3)
    expected = central_difference(lambda x: respond(model, x, drive), values, size, 1e-4)
    for column in range(values.size):
        agree(found[:, column] * size[column], expected[:, column] * size[column], 1e-6)
    # Each of the effect's own parameters matters.
    assert np.all(np.max(np.abs(found[:, 3:]), axis=0) > 0)


def test_no_answer_before_its_cause(effect):
    model, cut = KBI() + effect, 60
    values = values_of(model)
    torque = np.random.default_rng(0).uniform(-5, 5, TIME.size)
    changed = torque.copy()
    changed[cut:] += 3.0
    one, other = (
        respond(model, values, SampledTorque(t, hold="zero-order").drive(TIME))
        for t in (torque, changed)
    )
    assert np.array_equal(one[: cut + 1], other[: cut + 1])
    assert not np.array_equal(one, other)


def test_no_answer_before_its_cause_when_the_angle_is_imposed(effect):
    model, cut = KBI() + effect, 60
    values = values_of(model)
    drive = imposed_motion(TIME, 0.05 * np.sin(np.pi * TIME / 0.1) ** 4)
    states = drive.states.copy()
    states[cut:, 0] += 0.01
    changed = Drive(drive.interval, drive.generator, drive.readout, states, drive.impulses)
    one, other = (respond(model, values, d) for d in (drive, changed))
    assert np.array_equal(one[:cut], other[:cut])
    assert not np.array_equal(one[cut:], other[cut:])


def test_both_causalities_tell_the_same_story(effect):
    model = KBI() + effect
    values = values_of(model)
    angle = respond(model, values, TORQUE.drive(TIME))
    assert np.all(np.isfinite(angle))
    found = respond(model, values, imposed_motion(TIME, angle))
    # As far as a spline through the samples of the angle goes, worst near its ends.
    assert np.max(np.abs(found - TORQUE.values)[5:-5]) < 0.01 * 10.0


def test_integrated_and_exact_responses_agree(effect):
    model = KBI() + effect
    if not model.linear:
        pytest.skip("there is no exact response")
    drive = TORQUE.drive(TIME)
    found = simulate(model, values_of(model), drive, substeps=SUBSTEPS)
    agree(found, simulate(model, values_of(model), drive), 1e-6)


# How it is added


def test_it_composes(effect):
    model = KBI() + effect
    assert model.effects == (effect,)
    expected = [p.name for p in KBI_PARAMETERS]
    expected += [f"{effect.key}.{p.name}" for p in effect.parameters]
    assert list(model.parameter_names) == expected
    assert model.without(effect.key) == KBI()
    assert model.references == effect.references
    with pytest.raises(InputError, match=f"no effect '{effect.key}'"):
        KBI().without(effect.key)


def test_the_order_of_addition_does_not_matter(effect):
    one = KBI() + effect + ParallelSpring()
    other = KBI() + ParallelSpring() + effect
    assert one == other
    assert hash(one) == hash(other)
    assert one.parameter_names == other.parameter_names
    assert repr(one) == repr(other)
    # Beside a spring that lies over the whole joint the effect is as it was.
    silent = values_of(one, **{"parallel_spring.stiffness": 0.0})
    alone = KBI() + effect
    drive = TORQUE.drive(TIME)
    agree(respond(one, silent, drive), respond(alone, values_of(alone), drive), 1e-9)


def test_all_registered_effects_together_have_distinct_names():
    model = KBI()
    for kind in EFFECTS.values():
        model = model + kind()
    assert len(set(model.parameter_names)) == 3 + sum(len(e.parameters) for e in EFFECTS.values())
    assert model.effect_keys == tuple(sorted(EFFECTS))


def test_adding_it_twice_is_refused(effect):
    with pytest.raises(InputError, match=f"already has the effect '{effect.key}'; add it once"):
        KBI() + effect + effect


def test_adding_the_class_is_explained(effect):
    kind = type(effect)
    with pytest.raises(TypeError, match=f"found the class {kind.__name__}; write for example"):
        KBI() + kind


def test_adding_something_else_is_explained():
    with pytest.raises(TypeError, match="only effects can be added to a joint model, found 3"):
        KBI() + 3


def test_it_pickles(effect):
    model = KBI() + effect
    copy = pickle.loads(pickle.dumps(model))
    assert copy == model
    assert hash(copy) == hash(model)
    drive = TORQUE.drive(TIME)
    found, expected = (respond(m, values_of(model), drive) for m in (copy, model))
    assert np.array_equal(found, expected)


def test_effects_are_equal_by_kind_alone(effect):
    assert effect == type(effect)()
    assert effect != ParallelSpring()


def test_values_must_be_given_for_exactly_the_parameters(effect):
    model = KBI() + effect
    with pytest.raises(InputError, match="give exactly one value for each"):
        model.vector(KBI_VALUES)
