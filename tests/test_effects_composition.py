"""How effects are added to a joint: names, order, mistakes, and every pair of them together."""

import itertools
import pickle

import numpy as np
import pytest
from kinds import DRIVES, KBI_VALUES, KINDS, nulls_of, respond, values_of
from oracles import agree

from identifiability.errors import InputError
from identifiability.joint.effects.base import Motion
from identifiability.joint.model import KBI, KBI_PARAMETERS


@pytest.fixture(params=sorted(KINDS))
def effect(request):
    return KINDS[request.param]()


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


COUPLINGS = ["backlash", "soft_coupling"]  # of which a joint has one at most
PAIRS = [pair for pair in itertools.combinations(sorted(KINDS), 2) if list(pair) != COUPLINGS]


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_order_of_addition_does_not_matter(first, second):
    pair = KINDS[first](), KINDS[second]()
    model, other = KBI() + pair[0] + pair[1], KBI() + pair[1] + pair[0]
    assert model == other
    assert hash(model) == hash(other)
    assert model.parameter_names == other.parameter_names
    assert repr(model) == repr(other)
    assert (model.without(first), model.without(second)) == (KBI() + pair[1], KBI() + pair[0])


@pytest.mark.parametrize("keys", PAIRS, ids="-".join)
def test_equations_of_a_pair_are_those_of_its_effects(keys):
    model = KBI() + KINDS[keys[0]]() + KINDS[keys[1]]()
    values = values_of(model)
    (K, B, I), *parameters = np.split(values, 3 + np.cumsum([0, *_sizes(model)])[:-1])
    given = [(effect, list(p)) for effect, p in zip(model.effects, parameters, strict=True)]
    # Motions, states and delayed motions that are all different.
    driven, pasts = Motion(0.05, 0.7), [Motion(0.03, -0.4), Motion(-0.02, 0.6)]
    places = [effect.place for effect in model.effects]
    between = 2 * ("coupling" in places) + ("series" in places)
    internal = 0.01 * np.arange(1, 1 + model.n_internal)
    states = np.split(internal[between:], np.cumsum([e.n_states for e in model.effects]))
    found = model.react(values, driven, internal, pasts)
    joint = Motion(*internal[:2]) if "coupling" in places else driven

    def torque(place, motion):
        return sum(
            float(effect.torque(p, motion, own, past))
            for (effect, p), own, past in zip(given, states[:-1], pasts, strict=True)
            if effect.place == place
        )

    def muscle(motion):
        return K * motion.angle + B * motion.velocity + torque("muscle", motion)

    contractile, expected = joint, []
    if "series" in places:
        # The muscle shortens such that it carries the tension.
        contractile = Motion(internal[between - 1], float(found.rates[between - 1]))
        tension = torque("series", Motion(joint.angle - contractile.angle, 0.0))
        assert muscle(contractile) == pytest.approx(tension, rel=1e-9)
        expected = [contractile.velocity]
    beside = sum(float(e.bypass(p, joint)) for e, p in given if e.place == "series")
    resisted = muscle(contractile) + torque("joint", joint) + beside
    for (effect, p), own, past in zip(given, states[:-1], pasts, strict=True):
        seen = contractile if effect.place == "muscle" else joint
        expected += list(effect.rates(p, seen, own, past)) if effect.n_states else []
    if "coupling" in places:
        # The limb behind is moved by what the link carries, with the rest of the inertia.
        stretch = Motion(driven.angle - joint.angle, driven.velocity - joint.velocity)
        carried, share = torque("coupling", stretch), _before(given)
        assert float(model.inertia(values)) == pytest.approx(share * I)
        expected = [joint.velocity, (carried - resisted) / ((1 - share) * I), *expected]
        resisted = carried
    assert float(found.torque) == pytest.approx(resisted)
    np.testing.assert_allclose(found.rates, expected, rtol=1e-9)

    delays = [effect.delay(p) for effect, p in given]
    assert [d if d is None else float(d) for d in model.delays(values)] == delays
    response = recorded = np.random.default_rng(0).standard_normal(12)
    for effect, p in given:
        recorded = effect.record(p, recorded, 1e-3)
    np.testing.assert_array_equal(model.record(values, response, 1e-3), recorded)


def _before(given):
    return next(float(effect.before(p)) for effect, p in given if effect.place == "coupling")


def _sizes(model):
    return [len(effect.parameters) for effect in model.effects]


# Integrated in every session: a tendon with what acts on the muscle, with friction and with a
# delay; two with states of their own; two sensors. All pairs on demand.
INTEGRATED = {
    ("coulomb_friction", "nonlinear_tendon"),
    ("hill_force_velocity", "series_tendon"),
    ("maxwell_branch", "second_mass"),
    ("sensor_delay", "sensor_lowpass"),
    ("series_tendon", "stretch_reflex"),
}


@pytest.mark.parametrize(
    ("first", "second"),
    [pytest.param(*p, marks=() if p in INTEGRATED else pytest.mark.long) for p in PAIRS],
)
def test_pairs_compose(first, second):
    pair = KINDS[first](), KINDS[second]()
    model, alone = KBI() + pair[0] + pair[1], (KBI() + pair[1], KBI() + pair[0])
    nominal = dict(zip(model.parameter_names, values_of(model), strict=True))
    strengths = [next(iter(nulls_of(effect))) for effect in pair]
    stronger = [values_of(model, **{name: 1.5 * nominal[name]}) for name in strengths]
    vanished = [values_of(model, **nulls_of(effect)) for effect in pair]
    rows = np.where(np.isfinite(vanished), vanished, 1e7)
    drive = DRIVES["torque"]
    both, *changed = respond(model, np.stack([values_of(model), *stronger, *rows]), drive)
    assert np.all(np.isfinite([both, *changed]))
    for found in changed[:2]:
        assert np.max(np.abs(found - both)) > 1e-5 * np.max(np.abs(both))
    for effect, rest, found in zip(pair, alone, changed[2:], strict=True):
        if effect.place == rest.effects[0].place == "series":
            continue  # two tendons lie side by side: an infinite one leaves nothing to the other
        rtol = 1e-3 if effect.place in {"series", "coupling"} else 1e-9
        agree(found, respond(rest, values_of(rest), drive), rtol)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_all_effects_compose(coupling):
    chosen = [kind() for key, kind in KINDS.items() if key == coupling or key not in COUPLINGS]
    model = KBI().plus(chosen)
    assert len(set(model.parameter_names)) == 3 + sum(len(e.parameters) for e in chosen)
    assert model.effect_keys == tuple(sorted(effect.key for effect in chosen))
    nominal = dict(zip(model.parameter_names, values_of(model), strict=True))
    strengths = [next(iter(nulls_of(effect))) for effect in model.effects]
    rows = [values_of(model), *(values_of(model, **{n: 1.5 * nominal[n]}) for n in strengths)]
    both, *changed = respond(model, np.stack(rows), DRIVES["torque"])
    assert np.all(np.isfinite(both))
    for found in changed:
        assert np.max(np.abs(found - both)) > 1e-5 * np.max(np.abs(both))


def test_adding_it_twice_is_refused(effect):
    with pytest.raises(InputError, match=f"already has the effect '{effect.key}'; add it once"):
        KBI() + effect + effect


def test_a_joint_has_one_coupling():
    one, other = (KINDS[key]() for key in COUPLINGS)
    model = KBI() + one
    assert not model.takes(other)
    assert not model.takes(one)
    assert KBI().takes(other)
    with pytest.raises(InputError, match="already has the coupling 'backlash' before the limb"):
        model + other


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
    assert copy.parameters == model.parameters


def test_effects_without_fields_are_equal_by_kind(effect):
    assert effect == type(effect)()
    others = [kind() for key, kind in KINDS.items() if key != effect.key]
    assert effect not in others


def test_values_must_be_given_for_exactly_the_parameters(effect):
    model = KBI() + effect
    with pytest.raises(InputError, match="give exactly one value for each"):
        model.vector(KBI_VALUES)
