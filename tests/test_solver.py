"""Integration: steps that suit the model, their error known, and no inertia lost to friction."""

import itertools
import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from identifiability.benchmark.solver import ALLOWED, measure, questions
from identifiability.errors import InputError
from identifiability.inference.problem import Prior, Problem, observe
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.split import gather
from identifiability.joint.effects import EFFECTS, CoulombFriction, SeriesTendon
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import KBI
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import simulate
from identifiability.joint.scheme import EXACT, MOST_SUBSTEPS, Scheme
from identifiability.measurement.noise import Noise
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial

K, B, I, FRICTION, SMOOTH = 30.0, 0.8, 0.1, 0.3, 0.002
FRICTIONAL = KBI() + CoulombFriction()
TRUTH = FRICTIONAL.vector(
    {
        "K": K,
        "B": B,
        "I": I,
        "coulomb_friction.torque": FRICTION,
        "coulomb_friction.velocity": SMOOTH,
        "coulomb_friction.range": 2e-5,
        "coulomb_friction.breakaway": 0.0,
        "coulomb_friction.asymmetry": 0.0,
    }
)
START = {
    "K": 25.0,
    "B": 1.0,
    "I": 0.08,
    "coulomb_friction.torque": 0.2,
    "coulomb_friction.velocity": 0.03,
    "coulomb_friction.range": 2e-5,
    "coulomb_friction.breakaway": 0.0,
    "coulomb_friction.asymmetry": 0.0,
}


class UndeclaredFriction(CoulombFriction):
    """The same friction, of which the integrator is not told how fast it is."""

    key = "undeclared_friction"

    def pace(self, values):
        return 0.0


# Trials by another integrator

SAMPLES = 301  # at every rate, so that programs are shared


@cache
def trials(rate):
    time = np.arange(SAMPLES) / rate
    lead, width = 30 / rate, 60 / rate
    out = []
    for i, size in enumerate((2.0, -3.0, 4.0)):
        torque = np.where((time > lead) & (time <= lead + width), size, 0.0)

        def rates(t, x, torque=torque):
            applied = np.interp(t, time, torque)
            friction = FRICTION * np.tanh(x[1] / SMOOTH)
            return [x[1], (applied - K * x[0] - B * x[1] - friction) / I]

        angle = solve_ivp(
            rates,
            (0, time[-1]),
            [0.0, 0.0],
            t_eval=time,
            method="LSODA",
            rtol=1e-8,
            atol=1e-10,
            max_step=2e-3,
        ).y[0]
        sd = np.sqrt(1e-4 * np.mean(angle**2))
        noise = np.random.default_rng([rate, i]).normal(0.0, sd, SAMPLES)
        out.append(Trial(time, torque, angle + noise, name=f"{size:g} Nm"))
    return tuple(out)


@pytest.mark.parametrize("rate", [1000, 200])
def test_inertia_beside_friction_is_recovered(rate):
    """Of one second-order step a sample, 0.06 and 0.045 came out."""
    bench = Workbench(gather(trials(rate)))
    found = bench.fit(FRICTIONAL, [START])
    assert found.failure == ""
    assert found.values["I"] == pytest.approx(I, rel=0.02)
    assert found.solver_error < 1e-5
    # No finer than needed, whatever was passed through.
    assert found.scheme.substeps <= 32
    # As one step a sample has it, the true joint is far from its own trials.
    coarse = bench.problem(FRICTIONAL, bench.split.fitted, scheme=Scheme(1, 2))
    fine = bench.problem(FRICTIONAL, bench.split.fitted, scheme=found.scheme)
    costs = [np.sum(p.residuals(TRUTH[list(p.free)]) ** 2) for p in (coarse, fine)]
    assert costs[0] > 3 * costs[1]


def test_half_the_step_finds_what_an_effect_does_not_declare():
    model = KBI() + UndeclaredFriction()
    start = {n.replace("coulomb", "undeclared"): v for n, v in START.items()}
    bench = Workbench(gather(trials(200)))
    assert Scheme.for_model(model, model.vector(start), 1 / 200).substeps == 1
    found = bench.fit(model, [start])
    assert found.scheme.is_finer_than(Scheme(4, 2))
    assert found.values["I"] == pytest.approx(I, rel=0.02)


def test_a_fit_that_cannot_be_integrated_says_so(monkeypatch):
    split = gather(trials(200))
    rules = replace(split.rules, solver_most=1e-40, solver_least=1e-40)
    monkeypatch.setattr("identifiability.investigation.fits.bench.THOROUGH", 1)
    found = Workbench(replace(split, rules=rules)).fit(FRICTIONAL, [START])
    assert str(MOST_SUBSTEPS) in found.failure
    assert found.values == {}


# Schemes


def test_the_scheme_follows_model_parameters_and_interval():
    linear = KBI() + SeriesTendon()
    assert Scheme.for_model(linear, linear.nominal, 1e-3) == EXACT
    intervals = (5e-4, 1e-3, 5e-3, 1 / 60)
    schemes = [Scheme.for_model(FRICTIONAL, TRUTH, dt) for dt in intervals]
    assert all(b.is_finer_than(a) for a, b in itertools.pairwise(schemes[1:]))
    assert all(s.substeps & (s.substeps - 1) == 0 for s in schemes)
    # As fine as the contact yields (in 1 ms), or turns the joint round as a spring.
    for scheme, dt in zip(schemes, intervals, strict=True):
        assert dt / scheme.substeps <= 1.5e-3
        assert dt / scheme.substeps * np.sqrt(FRICTION / (2e-5 * I)) < 1.0
    harder = TRUTH * np.where(
        np.array(FRICTIONAL.parameter_names) == "coulomb_friction.torque", 99, 1
    )
    assert Scheme.for_model(FRICTIONAL, harder, 5e-3).is_finer_than(schemes[2])
    # Under an imposed angle its contact alone is integrated, in steps that are stable as it yields.
    held = [Scheme.for_model(FRICTIONAL, TRUTH, dt, "angle") for dt in intervals]
    assert all(finer.is_finer_than(scheme) for finer, scheme in zip(schemes, held, strict=True))
    for scheme, dt in zip(held, intervals, strict=True):
        assert 1e3 * dt / scheme.substeps <= (2.0 if scheme.order == 2 else 2.75)
    assert Scheme.for_model(FRICTIONAL, harder, 5e-3, "angle") == held[2]
    # Nothing is of a function of the velocity.
    hill = KBI() + EFFECTS["hill_force_velocity"]()
    assert Scheme.for_model(hill, hill.nominal, 1 / 60, "angle") == Scheme(1, 2)


@pytest.mark.parametrize("key", [k for k, kind in EFFECTS.items() if not kind.linear])
def test_extreme_parameters_have_a_scheme(key):
    model = KBI() + EFFECTS[key]()
    for theta in (model.lower, model.upper, model.nominal, np.zeros(model.nominal.size)):
        scheme = Scheme.for_model(model, np.minimum(theta, 1e300), 1e-3)
        assert 1 <= scheme.substeps <= MOST_SUBSTEPS


@pytest.mark.parametrize("imposed", ["torque", "angle"])
def test_a_nonlinear_model_is_never_linearised(imposed):
    time = np.arange(SAMPLES) / 200
    wave = np.sin(6 * time) ** 3
    drive = SampledTorque(3 * wave).drive(time) if imposed == "torque" else None
    drive = drive or imposed_motion(time, 0.1 * wave)
    expected = simulate(FRICTIONAL, TRUTH, drive)
    seen = [observe(drive, np.zeros(SAMPLES), Noise(1.0))]
    prior = Prior.physical(FRICTIONAL)
    fixed = dict(zip(FRICTIONAL.parameter_names[3:], TRUTH[3:], strict=True))
    problem = Problem(FRICTIONAL, seen, prior, fixed=fixed)
    (found,) = problem.responses(TRUTH[:3])
    error = np.sum((found - expected) ** 2) / np.sum(expected**2)
    assert error < 1e-5
    alone = simulate(KBI(), TRUTH[:3], drive)
    assert np.sum((alone - expected) ** 2) / np.sum(expected**2) > 100 * error + 1e-4
    with pytest.raises(InputError):
        Problem(FRICTIONAL, seen, prior, scheme=EXACT)
    with pytest.raises(InputError):
        simulate(FRICTIONAL, TRUTH, drive, scheme=EXACT)


def test_half_the_step_is_twice_the_steps():
    time = np.arange(SAMPLES) / 200
    drive = SampledTorque(np.sin(6 * time)).drive(time)
    for key in ("coulomb_friction", "stretch_reflex"):
        model = KBI() + EFFECTS[key]()
        seen = [observe(drive, np.zeros(SAMPLES), Noise(1.0))]
        problem = Problem(model, seen, Prior.physical(model))
        assert problem.halved().integration == problem.integration.halved
        (coarse,), (fine,) = (p.responses(p.template) for p in (problem, problem.halved()))
        assert 0 < np.max(np.abs(fine - coarse)) < 0.01 * np.max(np.abs(fine))


# Effects with fields


@dataclass(frozen=True)
class Spring(Effect):
    """A spring whose gain is a field."""

    gain: float = 1.0

    key = "spring"
    title = "a spring"
    place = "joint"
    linear = True
    parameters = (Parameter("stiffness", "k", "Nm/rad", 5.0, 0.0, 100.0, "of it", null=0.0),)

    def torque(self, p, motion, states, delayed):
        return self.gain * p[0] * motion.angle


class PlainSpring(Effect):
    """The same without a dataclass, its gain an array."""

    key = "spring"
    title = "a spring"
    place = "joint"
    linear = True
    parameters = Spring.parameters

    def __init__(self, gain):
        self.gain = np.array(gain)

    def torque(self, p, motion, states, delayed):
        return self.gain * p[0] * motion.angle


@pytest.mark.parametrize("kind", [Spring, PlainSpring])
def test_effects_are_equal_by_their_fields(kind):
    weak, strong = kind(1.0), kind(10.0)
    assert weak == kind(1.0)
    assert hash(weak) == hash(kind(1.0))
    assert weak != strong
    assert repr(weak) != repr(strong)
    assert KBI() + weak != KBI() + strong
    time = np.arange(SAMPLES) / 200
    drive = SampledTorque(np.sin(6 * time)).drive(time)
    theta = np.array([K, B, I, 5.0])
    one, other = (simulate(KBI() + effect, theta, drive) for effect in (weak, strong))
    expected = [simulate(KBI(), [K + 5.0 * g, B, I], drive) for g in (1.0, 10.0)]
    np.testing.assert_allclose([one, other], expected, rtol=1e-9, atol=1e-12)


def declared(**changes):
    attributes = {
        name: getattr(Spring, name) for name in ("key", "title", "place", "linear", "parameters")
    }
    return type("Declared", (Effect,), attributes | changes)


NO_NULL = Parameter("k", "k", "1", 1.0, 0.0, 2.0, "")
WRONG = {
    "a parameter of the joint": {"key": "K"},
    "no name": {"key": "my effect"},
    "no key": {"key": None},
    "no title": {"title": ""},
    "no place": {"place": "elbow"},
    "no word whether linear": {"linear": "yes"},
    "states in series": {"place": "series", "n_states": 1},
    "a list": {"parameters": [NO_NULL]},
    "nothing": {"parameters": ()},
    "no null": {"parameters": (NO_NULL,)},
    "a null out of bounds": {"parameters": (replace(NO_NULL, null=-1.0),)},
    "a plain value out of bounds": {"parameters": (replace(NO_NULL, null=0.0, plain=3.0),)},
    "one name twice": {"parameters": (replace(NO_NULL, null=0.0),) * 2},
    "a name with a space": {"parameters": (replace(NO_NULL, name="a b", null=0.0),)},
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_class_that_cannot_be_right_is_refused(mistake):
    declared()
    with pytest.raises(InputError):
        declared(**WRONG[mistake])


def test_an_effect_that_can_change_is_refused():
    @dataclass
    class Changing(Spring.__base__):
        gain: float = 1.0
        key, title, place, linear = Spring.key, Spring.title, Spring.place, Spring.linear
        parameters = Spring.parameters

    with pytest.raises(InputError):
        KBI() + Changing()


# The benchmark

RECORD = Path(__file__).parents[1] / "results" / "solver.json"


def test_the_benchmark_is_as_recorded():
    record = json.loads(RECORD.read_text())
    rows = {tuple(r[n] for n in ("effect", "speed", "rate", "imposed")): r for r in record["rows"]}
    assert set(rows) == set(questions())
    assert all(r["error"] < ALLOWED for r in rows.values() if r["passes"])
    for question in (
        ("coulomb_friction", "fast", 200, "torque"),
        ("coulomb_friction", "fast", 1000, "torque"),
        ("short_range_stiffness", "fast", 60, "angle"),
    ):
        row, kept = measure(*question), rows[question]
        assert (row.apriori, row.scheme) == (kept["apriori"], kept["scheme"])
        assert row.error == pytest.approx(kept["error"], rel=0.01, abs=1e-12)
        assert row.size == pytest.approx(kept["size"], rel=1e-3)
