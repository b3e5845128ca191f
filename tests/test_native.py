"""Machine code of models: as JAX has it, for every operation, scheme, drive and parameter."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kinds import DRIVES, TIME, ParallelSpring, respond, values_of
from oracles import agree

from identifiability.inference.problem import Prior, Problem, observe
from identifiability.joint.effects import EFFECTS
from identifiability.joint.integrator import integrate
from identifiability.joint.model import KBI
from identifiability.joint.native import kernel, response
from identifiability.joint.native.expressions import Graph
from identifiability.joint.native.kernel import kernel_of
from identifiability.joint.native.machine import LANES, Code, Row
from identifiability.joint.native.response import responses_of
from identifiability.joint.native.tracing import Untraceable, expressions_of
from identifiability.joint.response import drive_arrays, simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import Impulse

# Functions of two numbers; at equal ones maximum and minimum have a tie, at 0 others a corner.
FUNCTIONS = {
    "sum": lambda x, y: 3.0 * x + y - 2.0,
    "product": lambda x, y: x * y * x,
    "quotient": lambda x, y: x / (y + 3.0),
    "negative": lambda x, y: -x - (-y),
    "power": lambda x, y: (x + 3.0) ** y,
    "power of a number": lambda x, y: jnp.abs(x) ** 1.5 + 0.0 * y,
    "powers": lambda x, y: x**3 + (y + 3.0) ** -2 + x**0 + jnp.square(y),
    "root": lambda x, y: jnp.sqrt(x + 3.0) + jax.lax.rsqrt(y + 3.0),
    "exponential": lambda x, y: jnp.exp(x) + jnp.expm1(y),
    "logarithm": lambda x, y: jnp.log(x + 3.0) + jnp.log1p(y + 3.0),
    "circle": lambda x, y: jnp.sin(x) * jnp.cos(y) + jnp.tan(0.3 * x) + jnp.arctan(y),
    "hyperbola": lambda x, y: jnp.sinh(x) + jnp.cosh(y) * jnp.tanh(x),
    "logistic": lambda x, y: jax.nn.sigmoid(x * y),
    "larger": lambda x, y: jnp.maximum(x, y) * 2.0 + jnp.maximum(x, 0.0),
    "smaller": lambda x, y: jnp.minimum(x, y) * 2.0 + jnp.minimum(y, 0.0),
    "clipped": lambda x, y: jnp.clip(x, -0.5, 0.5) + jax.lax.clamp(-1.0, y, 1.0),
    "size": lambda x, y: jnp.abs(x) + jnp.sign(y) * x,
    "steps": lambda x, y: jnp.floor(x) * y + jnp.ceil(y) * x,
    "choice": lambda x, y: jnp.where((x > y) & ~(x <= 0.0), x * x, y * y * y),
    "other choice": lambda x, y: jnp.where((x == y) | (x >= 1.0) | (y != y), x, 2.0 * y),
    "truth": lambda x, y: (x < y) * x + jnp.heaviside(y, 0.5) * x + jnp.isfinite(x) * y,
    "held": lambda x, y: jax.lax.stop_gradient(x) * y + x,
    "arrays": lambda x, y: jnp.sum(jnp.stack([x, y, x * y])[::-1] * jnp.arange(3.0)),
    "matrices": lambda x, y: (jnp.array([[x, 2.0], [1.0, y]]) @ jnp.array([y, x]))[1],
    "nested": lambda x, y: jax.jit(lambda a: jnp.concatenate([a, a**2]).T[1])(jnp.array([x, y])),
    "derivative": lambda x, y: jax.grad(lambda a: jnp.tanh(a * y) * a)(x),
}
POINTS = [(0.7, -0.4), (-1.3, 2.2), (0.0, 0.0), (0.5, 0.5), (1.0, 0.0), (0.0, -1.0)]


def machine_of(function):
    """A function of two numbers as code of its value and first and second derivatives."""
    traced = jax.make_jaxpr(function)(0.0, 0.0)
    graph = Graph()
    given = [np.array(graph.input(i), object) for i in range(2)]
    outputs = [expressions_of(graph, traced, given)[0].item()]
    outputs += graph.derivatives(outputs, [0, 1])[0]
    outputs += [one for row in graph.derivatives(outputs[1:], [0, 1]) for one in row]
    return Code(graph, [Row(one, (), ()) for one in outputs], LANES)


@pytest.fixture(scope="module")
def expected_by_jax():
    """Value, first and second derivatives of all functions at all points, compiled once."""

    def all_of(function):
        def value(z):
            return function(z[0], z[1])

        first = jax.jacfwd(value)
        return lambda z: jnp.concatenate(
            [jnp.atleast_1d(value(z)), first(z), jax.jacfwd(first)(z).ravel()]
        )

    every = jax.jit(jax.vmap(lambda z: {name: all_of(f)(z) for name, f in FUNCTIONS.items()}))
    return every(jnp.array(POINTS))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_value_and_derivatives_of_every_operation(name, expected_by_jax):
    code = machine_of(FUNCTIONS[name])
    for point, expected in zip(POINTS, np.asarray(expected_by_jax[name]), strict=True):
        found = code(np.array(point))[:, 0]
        # Where there is no derivative, it matters that there is none, and not how it is said.
        there = np.isfinite(expected)
        np.testing.assert_allclose(found[there], expected[there], rtol=1e-12, atol=1e-12)
        assert not np.any(np.isfinite(found[~there]) & (found[~there] != 0.0)), point


def test_what_is_no_number_stays_none():
    code = machine_of(lambda x, y: jnp.maximum(x, 0.0) + jnp.minimum(y, 1.0))
    assert np.isnan(code(np.array([np.nan, 0.0]))[0, 0])
    assert np.isnan(code(np.array([0.0, np.nan]))[0, 0])


def test_equal_expressions_are_one():
    graph = Graph()
    x, y = graph.input(0), graph.input(1)
    assert graph.of("mul", x, y) == graph.of("mul", x, y)
    assert graph.of("add", x, graph.constant(0.0)) == x
    assert graph.value(graph.of("sub", graph.constant(3.0), graph.constant(1.0))) == 2.0
    # 0 times something is kept: it may be no number.
    assert graph.value(graph.of("mul", graph.constant(0.0), y)) is None


def test_an_unknown_operation_is_said():
    traced = jax.make_jaxpr(lambda x: jax.lax.erf_inv(x))(0.1)
    with pytest.raises(Untraceable, match="erf_inv"):
        expressions_of(Graph(), traced, [np.array(0, object)])


# Responses


@pytest.mark.parametrize("driven", DRIVES)
def test_steps_of_second_order_are_those_of_jax(driven):
    # Those of fourth order are held against JAX with all effects, in the contract.
    model = KBI() + EFFECTS["stretch_reflex"]()
    values, drive = values_of(model), DRIVES[driven]
    expected = jax.jit(lambda theta: integrate(model, theta, drive_arrays(drive), 2, 2))(values)
    agree(simulate(model, values, drive, scheme=Scheme(2, 2)), expected, 1e-11)


def test_an_impulse_moves_what_the_inertia_lets_it():
    model = KBI() + EFFECTS["nonlinear_tendon"]()
    values, drive = values_of(model), Impulse(0.5, onset=0.01).drive(TIME)
    scheme, step = Scheme(2), 1e-5
    found = responses_of(model, (2,), [drive], scheme).at(values)[0]
    moved = [
        simulate(model, values + shift * np.eye(values.size)[2], drive, scheme=scheme)
        for shift in (step, -step)
    ]
    agree(found[:, 1], (moved[0] - moved[1]) / (2 * step), 1e-7)
    expected = integrate(model, values, drive_arrays(drive), 2)
    agree(found[:, 0], expected, 1e-11)


def test_derivatives_are_by_the_free_parameters_alone():
    model = KBI() + EFFECTS["nonlinear_tendon"]()
    values, drives = values_of(model), [DRIVES["torque"]]
    every = responses_of(model, tuple(range(values.size)), drives, Scheme(1)).at(values)[0]
    some = responses_of(model, (1, 4), drives, Scheme(1)).at(values)[0]
    agree(some, every[:, [0, 2, 5]], 1e-13)


@pytest.mark.parametrize("driven", DRIVES)
def test_long_responses_are_the_same_by_several_threads(driven, monkeypatch):
    model = KBI() + EFFECTS["stretch_reflex"]()
    values, whole = values_of(model), DRIVES[driven]
    drives = [
        replace(whole, states=whole.states[:n], impulses=whole.impulses[:n])
        for n in (201, 90, 150, 40)
    ]
    alone = [responses_of(model, (0, 7), [drive], Scheme(2)).at(values)[0] for drive in drives]
    monkeypatch.setattr(response, "_WORTH_THREADS", 2 * sum(len(one) for one in alone))
    shared = responses_of(model, (0, 7), drives, Scheme(2))
    assert [len(part.starts) - 1 for part in shared._parts] == [1, 3]
    for one, other in zip(shared.at(values), alone, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not responses_of(model, (0, 7), drives, Scheme(1))._parts


class Unusual(ParallelSpring):
    """The same spring, by an operation that machine code does not know."""

    key = "unusual_spring"

    def torque(self, p, motion, states, delayed):
        return p[0] * jax.lax.cond(p[0] > 0.0, lambda a: a, lambda a: 2.0 * a, motion.angle)


@pytest.mark.parametrize("driven", DRIVES)
def test_what_it_does_not_know_jax_computes(driven):
    drive, known, unusual = DRIVES[driven], KBI() + ParallelSpring(), KBI() + Unusual()
    assert kernel_of(known, ()) is not None
    assert kernel_of(unusual, ()) is None
    agree(
        respond(unusual, values_of(unusual), drive), respond(known, values_of(known), drive), 1e-11
    )
    both = [
        Problem(model, [observe(drive, np.zeros(TIME.size), Noise(1.0))], Prior.physical(model))
        for model in (known, unusual)
    ]
    x = both[0].template
    agree(both[1].residuals(x), both[0].residuals(x), 1e-11)
    agree(both[1].jacobian(x), both[0].jacobian(x), 1e-9)
    agree(both[1].responses(x)[0], both[0].responses(x)[0], 1e-11)


@pytest.mark.parametrize("key", EFFECTS)
def test_every_effect_has_machine_code(key):
    assert kernel_of(KBI() + EFFECTS[key](), ()) is not None


def test_a_model_that_would_take_long_to_compile_is_left_to_jax(monkeypatch):
    monkeypatch.setattr(kernel, "_MOST", 3)
    assert kernel_of(KBI() + EFFECTS["gravity"](), (0, 1, 4)) is None


def test_few_kernels_are_kept(monkeypatch):
    monkeypatch.setattr(kernel, "_kept", {})
    monkeypatch.setattr(kernel, "_MOST_KEPT", 2)
    first = kernel_of(KBI(), (0,))
    assert kernel_of(KBI(), (0,)) is first
    kernel_of(KBI(), (1,))
    assert kernel_of(KBI(), (0,)) is first
    kernel_of(KBI(), (2,))
    assert set(kernel._kept) == {(KBI(), (0,)), (KBI(), (2,))}
