"""Probabilities of effect sets: evidence, noise of an imposed angle, something unknown, claims."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from constructed import probabilities
from hidden import JOINT
from hidden import trials as trials_of
from scipy import integrate, signal, stats
from scipy.optimize import least_squares

from identifiability.benchmark.anatomy import Anatomy
from identifiability.benchmark.blind import blind_cases
from identifiability.benchmark.effects import (
    CoulombFriction,
    CubicStiffness,
    MaxwellBranch,
    SensorDelay,
    SensorLowpass,
    SeriesTendon,
    StretchReflex,
)
from identifiability.benchmark.joints import Joint
from identifiability.benchmark.motion import Motion, reaction
from identifiability.benchmark.unknowns import TimeVaryingStiffness
from identifiability.errors import InputError
from identifiability.inference.fitting import inside
from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior import evidence
from identifiability.investigation.posterior.band import Band, band_of
from identifiability.investigation.posterior.beginnings import Beginnings
from identifiability.investigation.posterior.chance import scatter
from identifiability.investigation.posterior.claim import claim_of
from identifiability.investigation.posterior.columns import without
from identifiability.investigation.posterior.descriptions import descriptions_of
from identifiability.investigation.posterior.discrepancy import (
    Discrepancy,
    Discrepant,
    _known,
    discrepancy_of,
)
from identifiability.investigation.posterior.evidence import Evaluated, Evaluator
from identifiability.investigation.posterior.growing import growing_noise
from identifiability.investigation.posterior.laplace import log_volume, moved_by
from identifiability.investigation.posterior.noises import Weighed, raw_residuals
from identifiability.investigation.posterior.prior import Prior, priors_of
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.investigation.posterior.search import _Search
from identifiability.investigation.posterior.signatures import _Left
from identifiability.investigation.posterior.weighing import Weighing
from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation
from identifiability.investigation.wording.describe import describe
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.joint.scheme import Scheme
from identifiability.measurement.filtering import known_noise
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.prepared import prepare_whole_band
from identifiability.measurement.splitting import hold_out
from identifiability.measurement.trials import Trial
from identifiability.progress import silent

ANATOMY = Anatomy(0.08, 6.0, 0.2, 20.0, 0.8)
START = {"K": 20.0, "B": 1.0, "I": 0.07}


def motions(n, seed, rate=250, seconds=0.8, pace=70.0):
    """Times and smooth random movements."""
    random = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    for _ in range(n):
        onsets = 0.1 + np.cumsum(random.uniform(0.1, 0.25, 4))
        onsets = onsets[onsets < seconds - 0.1]
        heights = np.diff(random.uniform(-0.15, 0.15, onsets.size), prepend=0.0)
        yield time, Motion(onsets, heights, pace)


def servo_trials(joint, *, torque_sd=0.0, angle_sd=0.0, seed=1, n=6, **options):
    """Trials of a joint that a servo moves, recorded with white noise in both channels."""
    random = np.random.default_rng([seed, 1])
    out = []
    for i, (time, motion) in enumerate(motions(n, seed, **options)):
        angle, torque = motion.at(time)[0], reaction(joint, motion, time)
        torque = torque + torque_sd * random.standard_normal(time.size)
        angle = angle + angle_sd * random.standard_normal(time.size)
        out.append(Trial(time, torque, angle, driven="angle", name=f"trial {i}"))
    return out


def evaluator_for(trials):
    return evaluator_of(band_of(trials, ()), START)


# The simulator of an imposed motion


def test_a_plain_joint_resists_by_its_inertia_damping_and_stiffness():
    ((time, motion),) = motions(1, 3)
    expected = motion.at(time).T @ [ANATOMY.stiffness, ANATOMY.damping, ANATOMY.inertia]
    assert reaction(Joint(ANATOMY), motion, time) == pytest.approx(expected, abs=1e-12)


def test_derivatives_of_a_motion_are_those_of_its_angle():
    ((_, motion),) = motions(1, 4)
    time = np.linspace(0.0, 0.7, 7001)
    angle, velocity, acceleration = motion.at(time)
    assert np.gradient(angle, time)[1:-1] == pytest.approx(velocity[1:-1], abs=1e-4)
    assert np.gradient(velocity, time)[1:-1] == pytest.approx(acceleration[1:-1], abs=2e-2)


@pytest.mark.parametrize(
    ("hidden", "model", "values"),
    [
        (
            MaxwellBranch(15.0, 0.04),
            KBI() + EFFECTS["maxwell_branch"](),
            {
                "K": 26.0,
                "B": 1.0,
                "I": 0.08,
                "maxwell_branch.stiffness": 15.0,
                "maxwell_branch.time_constant": 0.04,
            },
        ),
        (
            SeriesTendon(60.0),
            KBI() + EFFECTS["series_tendon"](),
            {"K": 20.0, "B": 0.8, "I": 0.08, "series_tendon.stiffness": 60.0},
        ),
    ],
)
def test_the_library_predicts_what_the_simulator_resists(hidden, model, values):
    anatomy = ANATOMY
    if hidden.key == "series_tendon":  # the library's has nothing beside the muscle
        anatomy = replace(ANATOMY, passive_stiffness=0.0, passive_damping=0.0)
    ((time, motion),) = motions(1, 5, rate=1000)
    torque = reaction(Joint(anatomy, (hidden,)), motion, time)
    own = simulate(model, model.vector(values), imposed_motion(time, motion.at(time)[0]))
    assert np.sqrt(np.mean((own - torque) ** 2)) < 2e-3 * np.std(torque)
    other = simulate(
        model, model.vector({**values, "I": 0.085}), imposed_motion(time, motion.at(time)[0])
    )
    assert np.sqrt(np.mean((other - torque) ** 2)) > 5e-3 * np.std(torque)


def test_friction_holds_what_it_held_before():
    motion = Motion(np.array([0.1]), np.array([0.1]), 80.0)
    time = np.arange(800) / 1000
    friction = CoulombFriction(0.5, 0.5, 0.2, "sign")
    added = reaction(Joint(ANATOMY, (friction,)), motion, time) - reaction(
        Joint(ANATOMY), motion, time
    )
    assert np.all(added[:95] == 0)
    assert added[-1] == pytest.approx(0.5)


def test_blind_cases_are_drawn_alike_by_alike_seeds():
    first, again, other = (blind_cases("singles", seed, 4)[1].build() for seed in (5, 5, 6))
    assert np.array_equal(first.fit[0].torque, again.fit[0].torque)
    assert first.parameters != other.parameters
    assert {spec.imposed for spec in blind_cases("nulls", 1, 2)} == {"torque", "angle"}


# Evidence


def test_the_volume_about_a_mode_is_that_of_quadrature():
    precision = np.array([[9.0, 3.0], [3.0, 4.0]])
    inside, _, none = log_volume(precision, np.zeros(2), np.zeros(2, bool))
    assert inside == pytest.approx(np.log(2 * np.pi / np.sqrt(np.linalg.det(precision))))
    assert none == {}
    slope = 1.7  # of the first, at its lower bound 0

    def density(y, x):
        at = np.array([x, y])
        return np.exp(-0.5 * at @ precision @ at - slope * x)

    exact, _ = integrate.dblquad(density, 0, 6, -8, 8)
    found, kept, gains = log_volume(precision, np.array([slope, 0.0]), np.array([True, False]))
    assert found == pytest.approx(np.log(exact), abs=1e-4)
    assert list(kept) == [1]
    # Beyond the bound, with the other where it then is best.
    best = -np.linalg.solve(precision, [slope, 0.0])
    assert best[0] < 0
    assert gains[0] == pytest.approx(-0.5 * best @ precision @ best - slope * best[0])


def test_a_prior_that_speaks_against_the_best_values_moves_the_mode():
    """Likelihood and prior both normal, with other means: the integral is known."""
    prior = Prior("size", 30.0, one_sided=True)
    precision, best = np.array([[0.02, 0.3], [0.3, 9.0]]), np.array([40.0, 1.0])

    def density(y, x):
        off = np.array([x, y]) - best
        return np.exp(prior.log_density(x) - 0.5 * off @ precision @ off)

    exact, _ = integrate.dblquad(density, 0, 120, -6, 6)
    precision += np.diag([prior.sd**-2, 0.0])
    pull = np.array([prior.pull(best[0]), 0.0])
    volume, _, _ = log_volume(precision, -pull, np.zeros(2, bool))
    taken = prior.log_density(best[0]) + volume
    assert taken + moved_by(pull, precision) == pytest.approx(np.log(exact), abs=1e-4)
    assert moved_by(pull, precision) > 0.05
    assert moved_by(1e3 * pull, precision) == 0.0


def test_a_tendon_hardens_as_tendons_do():
    """Not to a wall: what joints have little of is less probable the more it is."""
    evaluator = evaluator_for(servo_trials(Joint(ANATOMY), torque_sd=0.1, n=2))
    model = KBI() + EFFECTS["nonlinear_tendon"]()
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    x = problem.free_vector(dict(zip(model.parameter_names, model.nominal, strict=True)))
    raw, _ = raw_residuals(problem, evaluator.band, x)
    priors = priors_of(problem, x, raw, evaluator.band.scale, evaluator.joint_widths)
    prior = priors[problem.names.index("nonlinear_tendon.hardening")]
    total = integrate.quad(lambda h: np.exp(prior.log_density(h)), 0, 200)[0]
    assert total == pytest.approx(1.0)
    assert prior.log_density(15.0) - prior.log_density(100.0) > 5.0


@pytest.mark.parametrize("key", ["coulomb_friction", "series_tendon"])
def test_a_size_that_shows_in_nothing_has_all_its_room(key):
    """Where a unit of it adds nothing its prior would have no end, and no evidence be a number."""
    evaluator = evaluator_for(servo_trials(Joint(ANATOMY), torque_sd=0.1, n=2))
    model = KBI() + EFFECTS[key]()
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    x = problem.free_vector(dict(zip(model.parameter_names, model.nominal, strict=True)))
    place = problem.names.index(next(name for name in problem.names if name.startswith(key)))
    raw, _ = raw_residuals(problem, evaluator.band, x)
    for columns in raw:
        columns[:, 1 + place] = 0.0
    prior = priors_of(problem, x, raw, evaluator.band.scale, evaluator.joint_widths)[place]
    room = model.parameters[problem.names[place]].upper if key == "coulomb_friction" else 1.0
    assert prior.sd == room


@pytest.mark.parametrize(
    ("key", "hidden"),
    [
        ("maxwell_branch", MaxwellBranch(15.0, 0.04)),
        ("cubic_stiffness", MaxwellBranch(15.0, 0.04)),
        ("quadratic_stiffness", MaxwellBranch(15.0, 0.04)),
        ("nonlinear_tendon", MaxwellBranch(15.0, 0.04)),
        ("sensor_delay", SensorDelay(0.006)),
    ],
)
def test_laplace_agrees_with_sampling(key, hidden):
    """Importance sampling about the mode, by a t distribution, of the same likelihood and prior."""
    evaluator = evaluator_for(servo_trials(Joint(ANATOMY, (hidden,)), torque_sd=0.1, n=4))
    model = KBI() + EFFECTS[key]()
    start = dict(zip(model.parameter_names, model.nominal, strict=True)) | START
    found = evaluator.evaluate(model, [start])
    problem = evaluator.band.problem(model, scheme=found.scheme, probes=evaluator.reference.probes)
    weighed = Weighed(problem, evaluator.band, found.weights)
    scale, widths = evaluator.band.scale, evaluator.joint_widths
    priors = priors_of(problem, found.x, found.raw, scale, widths)

    def log_density(x):
        if np.any(x < problem.lower) or np.any(x > problem.upper):
            return -np.inf
        prior = sum(
            p.log_density(v) - np.log(abs(p.turn(v))) for p, v in zip(priors, x, strict=True)
        )
        return prior - 0.5 * (weighed.squares(x) + found.weights.log_determinant)

    jacobian = weighed.jacobian(found.x)
    curvature = jacobian.T @ jacobian
    turn = np.array([p.turn(v) for p, v in zip(priors, found.x, strict=True)])
    curvature += np.diag([1 / (p.sd * t) ** 2 for p, t in zip(priors, turn, strict=True)])
    size = 1 / np.sqrt(np.diag(curvature))
    shape = 1.2 * np.linalg.inv(curvature * np.outer(size, size))
    proposal = stats.multivariate_t(np.zeros(size.size), shape, df=5, seed=1)
    draws = proposal.rvs(600)
    weights = np.array([log_density(found.x + size * z) for z in draws])
    weights -= proposal.logpdf(draws) - np.sum(np.log(size))
    ratios = np.exp(weights - weights.max())
    sampled = weights.max() + np.log(ratios.mean())
    error = ratios.std() / ratios.mean() / np.sqrt(ratios.size)
    order = found.weights.n_parameters
    n = evaluator.band.n_samples
    taken = found.log_evidence + order * n / (n - order - 2)
    assert error < 0.3
    assert abs(sampled - taken) < 1 + 3 * error


# Errors of the integration


def test_a_model_is_integrated_as_finely_as_telling_it_from_others_asks(monkeypatch):
    """Steps that are too long are found by half of them; without it the evidence is another's."""
    asked, fitted = [], []
    finer, settled = Evaluator._finer, Evaluator.settled

    def asking(problem, found, most):
        asked.append(finer(problem, found, most))
        return asked[-1]

    def fitting(self, problem, *arguments, **options):
        fitted.append(problem.integration)
        return settled(self, problem, *arguments, **options)

    monkeypatch.setattr(Evaluator, "_finer", staticmethod(asking))
    monkeypatch.setattr(Evaluator, "settled", fitting)
    random = np.random.default_rng(5)
    time = np.arange(300) / 200
    torque = 6.0 * np.sign(np.sin(2 * np.pi * 2.5 * time)) * (time > 0.1)
    model = KBI() + EFFECTS["coulomb_friction"]()
    nominal = dict(zip(model.parameter_names, model.nominal, strict=True))
    rubbing = {"torque": 1.0, "velocity": 0.003, "range": 1e-4}
    values = nominal | START | {f"coulomb_friction.{name}": v for name, v in rubbing.items()}
    angle = simulate(model, model.vector(values), SampledTorque(torque).drive(time))
    angle = angle + 3e-6 * random.standard_normal(time.size)
    trial = Trial(time, torque, angle, driven="torque", name="dry")
    evaluator = evaluator_for([trial])
    long, short = Scheme(1, 2), Scheme(64, 4)
    found = evaluator.evaluate(model, [values], scheme=long)
    # Two doublings or more in a row, and one fit in the last of them.
    assert len([scheme for scheme in asked if scheme is not None]) > len(set(fitted)) - 1 > 0
    exact = evaluator.evaluate(model, [values], scheme=short)
    assert found.scheme.is_finer_than(long)
    # Both by one noise: its optimum may be found from one fit and not from the other.
    noise = [one.weights for one in (found, exact)]
    found, exact = (
        evaluator.reweighed(*pair) for pair in zip((found, exact), noise[::-1], strict=True)
    )
    assert abs(found.log_evidence - exact.log_evidence) < 2
    problem = evaluator.band.problem(model, scheme=long)
    start = np.array([problem.free_vector(values)])
    coarse = evaluator.settled(problem, start, exact.weights)
    assert exact.log_evidence - coarse.log_evidence > 20


@pytest.mark.parametrize(("torque", "noise", "finer"), [(0.2, 1e-5, False), (20.0, 3e-5, True)])
def test_no_finer_than_the_record_can_show_however_fast_a_model_may_be(torque, noise, finer):
    """A pace is that of a typical motion; a small one does not come to what is fast."""
    random = np.random.default_rng(6)
    time = np.arange(300) / 100
    torque = torque * np.sign(np.sin(2 * np.pi * 2 * time)) * (time > 0.1)
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = START | {"cubic_stiffness.coefficient": 3e4}
    angle = simulate(model, model.vector(values), SampledTorque(torque).drive(time))
    angle = angle + noise * random.standard_normal(time.size)
    evaluator = evaluator_for([Trial(time, torque, angle, driven="torque", name="cubic")])
    found = evaluator.evaluate(model, [values], scheme=Scheme(1, 4))
    suited = found.problem.suited(found.problem.complete(found.x))
    assert suited.is_finer_than(Scheme(1, 4))
    assert found.scheme.is_finer_than(Scheme(1, 4)) == finer
    exact = evaluator.as_it_is(replace(found, problem=found.problem.with_scheme(Scheme(64, 4))))
    assert abs(found.log_evidence - exact.log_evidence) < 2


# Starts


@pytest.mark.long
def test_shapes_are_sought_with_their_sizes_fitted():
    """The start that is carried on is the one whose sizes, fitted one shape at a time, do best."""
    reflex = StretchReflex(12.0, 0.5, 0.04, 0.012, 0.012, "critically_damped")
    evaluator = evaluator_for(servo_trials(Joint(ANATOMY, (reflex,)), torque_sd=0.02, n=4))
    model = KBI() + EFFECTS["stretch_reflex"]()
    plain = evaluator.evaluate(KBI(), [START])
    starts = starting_values(model, plain.values, most=28, wide=True)
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    points = inside(problem, np.array([problem.free_vector(s) for s in starts]))
    weighed = Weighed(problem, evaluator.band, evaluator.starts[1])
    sizes = [i for i, name in enumerate(problem.names) if not name.endswith(("delay", "constant"))]
    assert len(sizes) == 5

    def fitted(point):
        def residuals(y):
            x = point.copy()
            x[sizes] = y
            return weighed.residuals(x)

        low, high = problem.lower[sizes], problem.upper[sizes]
        return least_squares(residuals, point[sizes], bounds=(low, high), x_scale="jac").cost

    costs = [fitted(point) for point in points]
    first = Beginnings.of(problem, evaluator.band, points).best(evaluator.starts[1], 1)[0]
    left = 0.5 * np.sum(weighed.residuals(first) ** 2)
    assert left == pytest.approx(min(costs), rel=1e-2)
    # As they are, with sizes of next to nothing, starts are told apart by chance.
    as_they_are = np.argmin([weighed.squares(x) for x in points])
    assert costs[as_they_are] > 1.5 * min(costs)
    found = evaluator.evaluate(model, starts)
    assert found.values["stretch_reflex.delay"] == pytest.approx(0.04, abs=6e-3)


# Descriptions of no mechanism


class Valued:
    """An evaluator whose evidence is given, by the keys of the effects."""

    def __init__(self, **log_evidence):
        self.log_evidence, self.asked, self.coarse = log_evidence, [], None

    def evaluate(self, model, starts, *, refined=(), **how):
        self.asked.append(model.effect_keys)
        key = "+".join(model.effect_keys)
        return evaluated_as(self.log_evidence[key], model, starts[0], tuple(refined))


def test_what_resembles_relaxation_is_held_against_it():
    evaluator = Valued(**{"gravity+relaxation_spectrum": 300.0, "relaxation_spectrum": 90.0})
    found = {}
    for keys in [(), ("gravity",), ("maxwell_branch",), ("gravity", "maxwell_branch")]:
        model = sum((EFFECTS[k]() for k in keys), start=KBI())
        values = dict(zip(model.parameter_names, model.nominal, strict=True))
        found[keys] = evaluated_as(100.0 * len(keys), model, values)
    # The best of every size: of one effect it is the branch.
    found["gravity",] = replace(found["gravity",], log_evidence=50.0)
    weighing = Weighing(evaluator, EFFECTS, found=found)
    weighing.describe()
    assert set(evaluator.asked) == {("gravity", "relaxation_spectrum"), ("relaxation_spectrum",)}
    assert weighing.described[("gravity",)]["relaxation_spectrum"].log_evidence == 300.0
    assert weighing.failures == {}


def test_values_that_no_joint_has_are_not_taken_up():
    """A weight that hangs from a segment of 8 mm, where a further search ends."""
    model = KBI() + EFFECTS["gravity"]()
    fine, impossible = (
        START | {"gravity.moment": moment, "gravity.posture": 1.0} for moment in (6.0, 200.0)
    )
    evaluator = Valued(gravity=30.0)
    evaluator.band = SimpleNamespace(angle_imposed=False)
    known = evaluated_as(20.0, model, fine)
    weighing = Weighing(evaluator, EFFECTS, found={("gravity",): known})
    evaluator.evaluate = lambda *args, **how: evaluated_as(30.0, model, impossible)
    weighing.take_up([("gravity",)])
    assert weighing.found["gravity",] is known
    assert "gravity" in weighing.failures
    evaluator.band.angle_imposed = True
    weighing.take_up([("gravity",)])
    assert weighing.found["gravity",] is known  # it was taken up
    weighing.taken_up.clear()
    weighing.take_up([("gravity",)])
    assert weighing.found["gravity",].log_evidence == 30.0


def test_richer_forms_start_from_what_they_are_a_form_of():
    key = "stiffening_hysteresis"
    model = KBI() + EFFECTS["short_range_stiffness"]()
    values = dict(zip(model.parameter_names, model.nominal, strict=True))
    values["short_range_stiffness.stiffness"] = 17.0
    (loop,) = descriptions_of(evaluated_as(0.0, model, values), (), EFFECTS)
    assert (loop.key, loop.rest, loop.refined) == (key, (), (key,))
    assert loop.starts[0][f"{key}.stiffness"] == 17.0
    assert {s[f"{key}.reversal"] for s in loop.starts} > {0.0}


def test_relaxation_at_several_paces_is_no_news_where_one_was_not_tried():
    model = KBI() + EFFECTS["second_mass"]()
    values = dict(zip(model.parameter_names, model.nominal, strict=True))
    (found,) = descriptions_of(evaluated_as(0.0, model, values), (), EFFECTS)
    assert found.key == "relaxation_spectrum"
    fewer = [key for key in EFFECTS if key != "maxwell_branch"]
    assert not descriptions_of(evaluated_as(0.0, model, values), (), fewer)


# Noise of an imposed angle


def whole_band(trials):
    """A likelihood of all that was recorded, which takes nothing off for noise of the angle."""
    fitted = hold_out(prepare_whole_band(trials), 0).fitted
    evaluator = evaluator_of(Band(fitted, 1, {}), START)
    reference = replace(evaluator.reference, probes=[], probe_problem=None)
    starts = tuple(replace(start, gain=0.0, excess=0.0) for start in evaluator.starts)
    return replace(evaluator, reference=reference, starts=starts)


@pytest.mark.parametrize(
    "key", ["sensor_lowpass", pytest.param("second_mass", marks=pytest.mark.long)]
)
def test_noise_of_an_imposed_angle_does_not_pass_for_an_effect(key):
    """A filter makes the noise smaller, a resonance adds what it happens to look like."""
    model = KBI() + EFFECTS[key]()
    start = dict(zip(model.parameter_names, model.nominal, strict=True))
    # A filter sees the motion between the samples, where noise of the angle is larger still: it
    # gains nothing by it even where nothing is taken off, so that a resonance is the control.
    ways = [evaluator_for, whole_band] if key == "second_mass" else [evaluator_for]
    gains = {way: [] for way in ways}
    for seed in range(3):
        trials = servo_trials(
            Joint(ANATOMY), torque_sd=0.1, angle_sd=3e-4, seed=seed, n=8, rate=200, pace=60.0
        )
        for way, out in gains.items():
            evaluator = way(trials)
            plain = evaluator.evaluate(KBI(), [START])
            other = evaluator.evaluate(model, [start | plain.values])
            out.append(other.log_evidence - plain.log_evidence)
    assert max(gains[evaluator_for]) < 3
    assert all(gain > 10 for gain in gains.get(whole_band, []))


# Something unknown


def probabilities_with(joint, **noise):
    """What the discrepancy beside K, B and I adds to their evidence, and its kind."""
    evaluator = evaluator_for(servo_trials(joint, **noise))
    plain = evaluator.evaluate(KBI(), [START])
    beside = discrepancy_of(evaluator, plain).beside(plain)
    return beside.log_evidence - plain.log_evidence, beside


def test_a_torque_that_nothing_names_is_found_and_noise_is_not():
    gain, beside = probabilities_with(Joint(ANATOMY), torque_sd=0.05)
    assert gain < 1
    assert beside.size < 0.01
    # What noise of the angle takes from the inertia is not a torque of its own.
    noisy = {"torque_sd": 0.1, "angle_sd": 3e-4, "n": 8, "rate": 200, "pace": 60.0}
    gain, _ = probabilities_with(Joint(ANATOMY), **noisy)
    assert gain < 3
    swing = Joint(ANATOMY, (TimeVaryingStiffness(8.0, 3.0),))
    gain, beside = probabilities_with(swing, torque_sd=0.05)
    assert gain > 20
    assert beside.kind == "varying"


def test_no_more_is_missing_than_is_left(monkeypatch):
    """Whatever a discrepancy adds that parameters and the noise's colour take back."""
    swing = Joint(ANATOMY, (TimeVaryingStiffness(8.0, 3.0),))
    evaluator = evaluator_for(servo_trials(swing, torque_sd=0.05))
    plain = evaluator.evaluate(KBI(), [START])
    discrepancy, asked = discrepancy_of(evaluator, plain), []

    def adding(size):
        def beside(_, found, most=None, nested=None):
            asked.append(most)
            return Discrepant(1.0 if most is None else 0.0, {"varying": size}, size)

        return beside

    left = plain.weights.estimate.rms / evaluator.band.scale
    for size, most, tolerated in (
        (10 * left, 1.1 * left, True),
        (10 * left, 0.9 * left, False),
        (0.5 * left, 0.6 * left, True),
    ):
        asked.clear()
        monkeypatch.setattr(Discrepancy, "beside", adding(size))
        free, form = discrepancy.inexact(plain, most)
        assert (form is free) == tolerated
        assert asked == ([None] if tolerated else [None, most * evaluator.band.scale])


def test_noise_that_a_resonance_amplifies_is_no_torque_of_its_own():
    """Of noise of the angle no more is taken off than there may be: its slope leads nowhere."""
    trials = servo_trials(Joint(ANATOMY), torque_sd=0.1, angle_sd=1e-5, n=8, rate=200, pace=60.0)
    evaluator = evaluator_for(trials)
    model = KBI() + EFFECTS["second_mass"]()
    plain = evaluator.evaluate(KBI(), [START])
    discrepancy = discrepancy_of(evaluator, plain)
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    frequency = 0.97 * 0.5 / evaluator.band.interval
    narrow = {"inertia": 0.05, "frequency": frequency, "damping_ratio": 0.01}
    start = plain.values | {f"second_mass.{name}": value for name, value in narrow.items()}
    here = evaluator.evaluated(problem, problem.free_vector(start), discrepancy.noise)
    best = evaluator.fitted(problem, here.x[None], discrepancy.noise)
    found = evaluator.evaluated(problem, best, discrepancy.noise)
    probe = here.weights.gain * here.weights.whitened(here.probes)
    most = Weighed(problem, evaluator.band, here.weights).most_taken
    assert probe[:, 0] @ probe[:, 0] > 2 * most  # the control
    # Far from its best values a model comes near what it is there, and not thousands of nats above.
    assert discrepancy.beside(here).log_evidence < found.log_evidence + 50
    assert discrepancy.beside(found).log_evidence < found.log_evidence + 3


def test_what_a_resonance_makes_noise_scatter_is_known_from_draws_of_it():
    """The sum of squares of many draws, for a model that amplifies a narrow band, and none."""
    rng, sizes, share = np.random.default_rng(1), (120, 81), 0.6
    pole = 0.9 * np.exp(0.8j * np.pi)
    resonance = [1.0, -2 * pole.real, abs(pole) ** 2]

    def draw(n):
        usual = [np.sqrt(share) * rng.standard_normal((size, n)) for size in sizes]
        rung = [0.5 * signal.lfilter([1.0, 0.0, -1.0], resonance, one, axis=0) for one in usual]
        moved = [one + other for one, other in zip(usual, rung, strict=True)]
        return np.concatenate(usual), np.concatenate(moved)

    own = np.sqrt(1 - share) * rng.standard_normal((sum(sizes), 4000))
    usual, moved = draw(4000)
    before, after = (np.var(np.sum((own + part) ** 2, axis=0)) for part in (usual, moved))
    assert after > 3 * before  # else nothing is tested
    found = [scatter(*pair, sizes) for pair in zip(moved.T[:200], usual.T[:200], strict=True)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(np.sqrt(after - before), rel=0.1)
    # That of one draw is of that size.
    assert np.std(found) < 0.5 * np.mean(found)
    alike = [scatter(part, part, sizes) for part in usual.T[:200]]
    assert np.mean(alike) < 0.2 * np.mean(found)


@pytest.mark.parametrize("credited", [True, False])
def test_noise_of_the_angle_that_is_weak_by_chance_is_no_second_mass(credited, monkeypatch):
    """A joint alone, moved, its angle rounded: a seed that nobody had worked on named a mass."""
    case = blind_cases("nulls", 751, 12)[5].build()
    trials = (*case.fit, *case.held_out)
    assert case.truth == ()
    if not credited:
        monkeypatch.setattr(evidence, "_CHANCE", 0.0)  # the control
    joint = {name: case.joint[name] for name in ("K", "B", "I")}
    evaluator = evaluator_of(band_of(trials, ()), joint)
    plain = evaluator.evaluate(KBI(), [joint])
    mass = {"inertia": 0.0018, "frequency": 40.6, "damping_ratio": 0.009}
    start = joint | {f"second_mass.{name}": value for name, value in mass.items()}
    found = evaluator.evaluate(KBI() + EFFECTS["second_mass"](), [start], nested=plain)
    plain = evaluator.reweighed(plain, found.weights)  # as sets are before they are compared
    assert (found.log_evidence < plain.log_evidence + 2) == credited


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_discrepancy_does_not_depend_on_where_the_parameters_were(driven):
    """Those that are best without it, in the noise that there is then, are not best beside it.

    Taken as if they were, something small that is unknown would seem less likely than it is.
    """
    model, values = (
        KBI() + EFFECTS["cubic_stiffness"](),
        JOINT
        | {
            "cubic_stiffness.coefficient": 60.0,
            "cubic_stiffness.centre": 0.0,
        },
    )
    band = band_of(trials_of(model, values, driven=driven), (), lowpass_hz=None)
    evaluator = evaluator_of(band, JOINT)
    plain = evaluator.evaluate(KBI(), [JOINT])
    discrepancy = discrepancy_of(evaluator, plain)
    found = []
    for sds in (-3.0, 0.0, 3.0):
        x = plain.x + sds * np.array(list(plain.sds.values()))
        moved = evaluator.evaluated(plain.problem, x, plain.weights)
        found.append(discrepancy.beside(moved).log_evidence)
    assert min(found) > plain.log_evidence + 10
    # Noise and discrepancy are estimated in turn until a round brings less than half a nat.
    assert np.ptp(found) < 1.5


def test_what_noise_takes_from_weights_is_given_back():
    """Of columns with noise in them the corrected weights are right on average, and as wide."""
    random = np.random.default_rng(8)
    n, truth = 300, np.array([1.5, -0.7])
    clean = random.standard_normal((n, 2)) @ np.diag([1.0, 0.3])
    plain, corrected, spread = [], [], []
    for _ in range(300):
        noise = 0.2 * random.standard_normal((n, 2))
        seen = clean + noise
        # Noise of the columns is in the residual too, with that of the sensor.
        residual = clean @ truth + random.standard_normal(n) + noise @ [0.5, 0.5]
        probe = 0.2 * random.standard_normal((n, 2))
        inner, along = _known(seen.T @ seen, seen.T @ residual, probe, probe @ [0.5, 0.5])
        plain.append(np.linalg.solve(seen.T @ seen, seen.T @ residual))
        corrected.append(np.linalg.solve(inner, along))
        spread.append(np.diag(np.linalg.inv(inner)))
    error = np.std(corrected, axis=0) / np.sqrt(300)
    assert np.all(np.abs(np.mean(corrected, axis=0) - truth) < 4 * error + 0.02)
    assert abs(np.mean(plain, axis=0)[1] - truth[1]) > 10 * error[1]
    # The residual's variance is 1 and the noise's share of it, 1.02.
    ratio = np.var(corrected, axis=0) / np.mean(spread, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.5))


def test_parameters_that_differ_between_trials_are_something_unknown():
    stiffer = replace(ANATOMY, passive_stiffness=2 * ANATOMY.passive_stiffness)
    pair = [
        servo_trials(Joint(a), torque_sd=0.05, seed=i, n=3)
        for i, a in enumerate((ANATOMY, stiffer))
    ]
    gains = {}
    for label, trials in (("alike", pair[0]), ("different", pair[0] + pair[1])):
        evaluator = evaluator_for(trials)
        plain = evaluator.evaluate(KBI(), [START])
        beside = discrepancy_of(evaluator, plain).beside(plain)
        gains[label] = beside.log_evidence - plain.log_evidence
    assert gains["alike"] < 1
    assert gains["different"] > 20
    assert beside.kind == "inconstant"


def test_what_parameters_can_do_is_no_discrepancy():
    """A torque that K, B and I could make as well has no size; one beyond them has."""
    evaluator = evaluator_for(servo_trials(Joint(ANATOMY), torque_sd=0.05))
    plain = evaluator.evaluate(KBI(), [START])
    random = np.random.default_rng(1)
    size = np.std(np.concatenate(plain.raw)[:, 1])
    sizes = []
    for own in (0.0, 0.5):
        parts = []
        for raw in plain.raw:
            theirs = raw[:, 1] / size
            parts.append((theirs + own * random.standard_normal(theirs.size))[:, None])
        white = plain.weights.whitened(parts)
        taken = np.linalg.solve(plain.precision, plain.directions.T @ white)
        sizes.append(np.std(np.concatenate(without(parts, plain, taken))))
    assert sizes[0] < 1e-2
    assert sizes[1] == pytest.approx(0.5, rel=0.2)


def test_noise_is_there_at_rest_as_well():
    random = np.random.default_rng(2)
    motion = np.repeat([0.0, 2.0], 300)
    gains = [growing_noise(random.standard_normal(600), motion, 1.0)[0] for _ in range(200)]
    # Twice the gain is at most chi-squared of one degree of freedom: two standard errors above.
    assert np.mean(np.array(gains) > 1.92) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / 200)
    gain, share = growing_noise(random.standard_normal(600) * (0.3 + motion), motion, 1.0)
    assert gain > 100
    assert share > 0.8
    # No more than it may grow; and what is left where a rounded angle stands says nothing.
    assert growing_noise(random.standard_normal(600) * (0.3 + motion), motion, 0.1)[1] <= 0.1
    still = np.where(motion > 0, 1.0, np.nan)
    assert growing_noise(random.standard_normal(600) * (0.3 + motion), still, 1.0)[0] == 0


def test_a_rounded_angle_stands_still_at_rest_and_does_not_in_motion():
    step = 1e-3
    trials = [
        replace(t, angle=step * np.round(t.angle / step))
        for t in servo_trials(Joint(ANATOMY), torque_sd=0.01, n=2)
    ]
    band = band_of(trials, ())
    assert band.step == pytest.approx(step)
    before = [p.trial.time < 0.08 for p in band.prepared]
    assert all(s[at].all() for s, at in zip(band.stands, before, strict=True))
    assert all(s.mean() < 0.6 for s in band.stands)
    assert not any(s.any() for s in band_of(servo_trials(Joint(ANATOMY), n=2), ()).stands)


@pytest.mark.parametrize(("rounded", "expected"), [(True, 1e-3 / np.sqrt(12)), (False, 4e-4)])
def test_noise_of_the_angle_is_known_from_its_steps_or_its_floor(rounded, expected):
    random = np.random.default_rng(4)
    time = np.arange(4000) / 500
    smooth = 0.3 * np.sin(2 * np.pi * 1.1 * time) + 0.1 * np.sin(2 * np.pi * 2.3 * time)
    noisy = smooth + 4e-4 * random.standard_normal(time.size)
    angle = 1e-3 * np.round(smooth / 1e-3) if rounded else noisy
    trial = Trial(time, 5 * smooth, angle, driven="angle", name="noisy")
    assert known_noise([trial]) == pytest.approx(expected, rel=0.1)
    assert known_noise([replace(trial, angle=smooth)]) < 1e-6


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_of_a_long_record_parts_all_over_it_are_compared(driven):
    ((time, motion),) = motions(1, 5, rate=500, seconds=90.0)
    torque, angle = reaction(Joint(ANATOMY), motion, time), motion.at(time)[0]
    band = band_of([Trial(time, torque, angle, driven=driven)], (), lowpass_hz=None)
    assert band.n_recorded == pytest.approx(band.prepared[0].trial.n_samples / band.every, rel=0.01)
    assert 8_192 / 1.5 < band.n_samples < 1.5 * 8_192
    response = band.prepared[0].response
    for observation, window, span in zip(band.observations, band.windows, band.spans, strict=True):
        np.testing.assert_array_equal(observation.measured[window], response[span])
    begins = [span.start for span in band.spans]
    assert begins == sorted(begins)
    assert begins[0] < 0.2 * response.size
    assert band.spans[-1].stop > 0.8 * response.size
    # One record, with one offset.
    assert [o.continues for o in band.observations] == [False] + [True] * (len(begins) - 1)
    constants = [o.constant for o in band.observations]
    assert np.sum(np.concatenate(constants) ** 2) in (0.0, pytest.approx(1.0))


def test_a_torque_that_is_recorded_late_does_not_hide_the_inertia():
    # K, B and I alone are so poor a picture of it that coloured noise explains all but K.
    trials = servo_trials(Joint(ANATOMY, (SensorLowpass(8.0, "butterworth"),)), torque_sd=0.02)
    evaluator = evaluator_for(trials)
    filtered = {"sensor_lowpass.time_constant": 0.02, "sensor_lowpass.shape": 0.4}
    model = KBI() + EFFECTS["sensor_lowpass"]()
    found = evaluator.evaluate(model, [START | filtered], refined=["sensor_lowpass"])
    assert found.values["K"] == pytest.approx(26.0, rel=0.02)
    assert found.values["I"] == pytest.approx(0.08, rel=0.05)


def test_an_angle_too_coarse_for_its_acceleration_is_said_to_be():
    step = 0.04
    trials = [
        replace(trial, angle=step * np.round(trial.angle / step))
        for trial in servo_trials(Joint(replace(ANATOMY, inertia=0.001)), torque_sd=0.02)
    ]
    with pytest.raises(InputError, match="too coarse for its acceleration"):
        evaluator_for(trials)


def test_what_is_compared_is_exact_for_a_joint_that_is_known():
    # One trial's first movement is too small to be seen as one, and the last ends in motion.
    joint = Joint(ANATOMY, (CubicStiffness(20.0, 0.2, "polynomial"),))
    time = np.arange(400) / 500
    moves = [
        Motion(np.array([0.1, 0.3]), np.array([height, -0.25]), 60.0) for height in (0.2, -0.004)
    ]
    moves.append(Motion(np.array([0.1, 0.75]), np.array([0.1, 0.1]), 60.0))
    trials = [
        Trial(time, reaction(joint, motion, time), motion.at(time)[0], driven="angle")
        for motion in moves
    ]
    band = band_of(trials, ())
    model = KBI() + EFFECTS["cubic_stiffness"]()
    known = {"K": 26.0, "B": 1.0, "I": 0.08, "cubic_stiffness.coefficient": 20 / 3 / 0.2**2}
    problem = band.problem(model)
    residuals = problem.residuals(problem.free_vector(known | {"cubic_stiffness.centre": 0.0}))
    for left in band.compared(problem.by_observation(residuals[:, None]), problem):
        assert np.ptp(left) < 2e-3 * band.scale


def test_no_resonance_is_sought_beyond_what_is_compared():
    """Near the rate of the samples one made up for what lies between them, and was named."""
    trials = servo_trials(Joint(ANATOMY), torque_sd=0.05, n=3, rate=100)
    model = KBI() + EFFECTS["second_mass"]()
    for band in (band_of(trials, ()), replace(band_of(trials, ()), every=2)):
        problem = band.problem(model)
        upper = dict(zip(problem.names, problem.upper, strict=True))["second_mass.frequency"]
        assert upper == pytest.approx(0.5 / band.interval)
        # That is no bound of physiology: what lies there is no value that no joint has.
        ev = replace(evaluator_for(trials), reference=SimpleNamespace(band=band))
        at = [list(problem.names).index(f"second_mass.{n}") for n in ("frequency", "damping_ratio")]
        assert [ev._limits(problem, i) for i in at] == [False, True]
        asked = replace(band, bounds={"second_mass.frequency": (1.0, 9.0)}).problem(model)
        assert asked.upper[list(asked.names).index("second_mass.frequency")] == 9.0


def test_trials_of_several_rates_are_brought_to_the_lowest():
    slow, fast = (servo_trials(Joint(ANATOMY), n=1, rate=r)[0] for r in (250, 500))
    band = band_of([slow, fast], ())
    assert len({p.trial.n_samples for p in band.prepared}) == 1
    with pytest.raises(InputError, match=r"multiples of one; resample them"):
        band_of([slow, servo_trials(Joint(ANATOMY), n=1, rate=330)[0]], ())


def weighing_of(moved, log_evidence, **options):
    """Sets with these predictions and evidence, and nothing else."""
    found = {
        keys: replace(evaluated_as(value, KBI(), {}), raw=[np.asarray(moved[keys], float)[:, None]])
        for keys, value in log_evidence.items()
    }
    return Weighing(None, EFFECTS, found=found, **options)


@pytest.mark.parametrize(
    ("added", "rules", "sure"),
    [(0.05, Rules(), False), (0.5, Rules(), True), (0.05, Rules(equations=0.01), True)],
)
def test_a_small_second_effect_may_only_mend_the_equations_of_the_first(added, rules, sure):
    """Up to a tenth of what the first explains, both are probable; beyond it one is."""
    none, one = np.zeros(4), np.array([1.0, -1.0, 1.0, -1.0])
    both = one + added * np.array([1.0, 1.0, -1.0, -1.0])
    keys = {(): none, ("gravity",): one, ("gravity", "second_mass"): both}
    log_evidence = dict(zip(keys, (0.0, 100.0, 150.0), strict=True))
    named = weighing_of(keys, log_evidence, rules=rules).together.named({})
    odds = np.exp(named["gravity", "second_mass"] - named["gravity",])
    assert odds > 1e6 if sure else 1 < odds < 10


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_sets_that_leave_the_same_are_weighed_by_the_same_noise(driven):
    """Of two that differ by where their noise was sought from, none is more probable for it."""
    evaluator = evaluator_for(trials_of(KBI(), START, noise=0.01, driven=driven))
    found = evaluator.evaluate(KBI(), [START])
    problem = evaluator.band.problem(KBI(), probes=evaluator.reference.probes)
    estimate = found.weights.estimate
    louder = {
        name: part and replace(part, sd=1.25 * part.sd)
        for name, part in (("own", estimate.own), ("carried", estimate.carried))
    }
    astray = replace(found.weights, estimate=replace(estimate, **louder))
    poor = evaluator.evaluated(problem, found.x, astray)
    assert found.log_evidence - 55 < poor.log_evidence < found.log_evidence - 2
    weighing = Weighing(evaluator, EFFECTS, found={(): found, ("gravity",): poor})
    assert weighing._share()
    better = weighing.found["gravity",].log_evidence
    assert better == pytest.approx(found.log_evidence, abs=0.5)
    assert weighing.found[()] is found
    assert not weighing._share()


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_discrepancy_is_weighed_once_until_what_it_follows_from_is_another(driven, monkeypatch):
    evaluator = evaluator_for(trials_of(KBI(), START, noise=0.01, driven=driven))
    found = evaluator.evaluate(KBI(), [START])
    weighing, asked, inexact = Weighing(evaluator, EFFECTS), [], Discrepancy.inexact

    def counted(self, *arguments):
        asked.append(arguments)
        return inexact(self, *arguments)

    monkeypatch.setattr(Discrepancy, "inexact", counted)
    rows = []
    for one in (found, found, replace(found)):
        weighing.found[()] = one
        rows.append([(row.effects, row.log_evidence) for row in weighing.together.posterior().rows])
    assert len(asked) == 2
    assert rows[0] == rows[1] == rows[2]


class Pretended:
    """A weighing in which every refined form is better by far."""

    def __init__(self, **plain):
        self.found, self.asked = {}, []
        for name, value in plain.items():
            keys = () if name == "nothing" else (name,)
            model = sum((EFFECTS[k]() for k in keys), start=KBI())
            values = dict(zip(model.parameter_names, model.nominal, strict=True))
            self.found[keys] = evaluated_as(value, model, values)

    def weigh(self, jobs):
        for job in jobs:
            self.asked.append(job.model.effect_keys)
            found = evaluated_as(1000.0, job.model, job.starts[0], tuple(job.refined))
            yield self.found.update({job.model.effect_keys: found})


def evaluated_as(value, model, values, refined=()):
    problem = SimpleNamespace(model=model, integration=None)
    weights = SimpleNamespace(estimate=SimpleNamespace(carried_sd=0.0, levels=np.ones(1)))
    return Evaluated(
        problem, values, refined, np.zeros(3), weights, value, value, None, None, None, None, []
    )


def test_a_set_that_comes_near_by_another_way_is_enlarged_too():
    """Two effects may be taken for a third one and its correction."""
    weighing = Pretended(nothing=0.0, cubic_stiffness=86.0, gravity=84.0, sensor_delay=20.0)
    pairs = {
        ("cubic_stiffness", "hill_force_velocity"): 98.0,
        ("cubic_stiffness", "sensor_delay"): 97.0,
        ("gravity", "sensor_delay"): 96.0,
    }
    nominal = {"K": 1.0, "B": 1.0, "I": 1.0}
    weighing.found |= {keys: evaluated_as(value, KBI(), nominal) for keys, value in pairs.items()}
    search = _Search(weighing, EFFECTS, silent)
    assert search.contenders(1) == [("cubic_stiffness",), ("gravity",)]
    assert search.contenders(2) == [
        ("cubic_stiffness", "hill_force_velocity"),
        ("gravity", "sensor_delay"),
    ]
    # What is far behind is not.
    weighing.found["gravity", "sensor_delay"] = evaluated_as(80.0, KBI(), nominal)
    assert search.contenders(2) == [("cubic_stiffness", "hill_force_velocity")]


def test_sets_are_compared_in_one_form():
    """What was refined first does not keep from being refined what it was level with before."""
    weighing = Pretended(nothing=0.0, stretch_reflex=300.0, activation_lag=290.0, gravity=100.0)
    search = _Search(weighing, EFFECTS, silent)
    search.add("nothing", [])
    search._refine(1)
    assert weighing.asked == [("stretch_reflex",), ("activation_lag",)]


@pytest.mark.parametrize(("pair", "poor"), [(1050.0, False), (1900.0, True)])
def test_what_a_second_effect_only_mends_is_not_replaced_by_it(pair, poor):
    weighing = Pretended(nothing=0.0, cubic_stiffness=1000.0, coulomb_friction=20.0)
    keys = ("coulomb_friction", "cubic_stiffness")
    weighing.found[keys] = evaluated_as(pair, KBI(), {})
    assert _Search(weighing, EFFECTS, silent).was_poor(keys) == poor


# Priors


def test_a_segment_weighs_what_its_inertia_says():
    """Hand, forearm with hand, leg and body as Winter 2009 has them, within a factor of 1.4."""
    for inertia, moment in [(0.0055, 0.42), (0.074, 2.8), (0.62, 14.0), (3.3, 49.0), (71.0, 660.0)]:
        ((median, _),) = EFFECTS["gravity"]().typical({"I": inertia}).values()
        assert 1 / 1.4 < median / moment < 1.4


def test_a_second_mass_is_what_wobbles_beside_a_joint():
    """One with all but all inertia, held by a damper, is what a filter of the torque looks like."""

    def log_prior(own, second, damping):
        typical = EFFECTS["second_mass"]().typical({"I": own})
        given = zip(("inertia", "damping_ratio"), (second, damping), strict=True)
        return sum(
            Prior("typical", spread, median).log_density(value)
            for (name, value) in given
            for median, spread in [typical[f"second_mass.{name}"]]
        )

    tissue = log_prior(0.1, 0.03, 0.2)
    # A limb in a light cuff may still be one; a filter may not.
    assert tissue - log_prior(0.01, 0.02, 0.5) < 2.0
    assert tissue - log_prior(1.3e-4, 0.0105, 2.94) > 6.0


def test_priors_of_what_is_typical_integrate_to_one_over_its_logarithm():
    prior = Prior("typical", 1.3, 2.5)
    total = integrate.quad(lambda u: np.exp(prior.log_density(np.exp(u))), -15, 15, points=[1.0])
    assert total[0] == pytest.approx(1.0)
    assert prior.log_density(2.5) > prior.log_density(2.4)
    assert prior.turn(2.4) == pytest.approx(2.4)
    assert np.isfinite(prior.log_density(0.0))


def test_the_signature_of_what_diverges_has_no_size_but_a_shape():
    ev = evaluator_for(servo_trials(Joint(ANATOMY)))
    found = ev.by_least_squares(ev.begun(KBI(), [START]))
    left = _Left(ev, found, ev.white)
    change = np.random.default_rng(4).standard_normal(ev.band.n_samples)
    expected = left.removed(change)
    assert expected > 0
    assert left.removed(1e200 * change) == pytest.approx(expected)
    assert left.removed(0 * change) == 0.0
    assert left.removed(np.inf * change) == 0.0


def test_noise_that_is_most_of_a_response_is_improbable():
    """Or long memory could make noise of a response."""
    ev = evaluator_for(servo_trials(Joint(ANATOMY), torque_sd=0.05))
    problem = ev.band.problem(KBI())
    x = problem.free_vector(START)
    weights = ev.starts[0]
    share = (weights.estimate.rms / ev.band.scale) ** 2
    doubled = replace(weights, estimate=replace(weights.estimate, rms=2 * weights.estimate.rms))
    less = ev.evaluated(problem, x, weights).log_evidence
    less -= ev.evaluated(problem, x, doubled).log_evidence
    assert less == pytest.approx(3 * share / 0.02, rel=1e-6)


# Claims


@pytest.mark.parametrize(
    ("rows", "kind", "sets"),
    [
        ([((), 0.97), (("gravity",), 0.03)], "nothing", ()),
        ([(("gravity",), 0.94), ((), 0.06)], "nothing", ()),
        ([(("gravity",), 0.96), ((), 0.04)], "effects", (("gravity",),)),
        ([(("gravity",), 0.94), (None, 0.06)], "unknown", ()),
        ([(None, 1.0)], "unknown", ()),
        (
            [(("gravity",), 0.6), (("cubic_stiffness",), 0.37), ((), 0.03)],
            "effects",
            (("gravity", "cubic_stiffness"),),
        ),
        # One effect is sure, whether there is a second is not.
        (
            [(("gravity",), 0.6), (("gravity", "second_mass"), 0.4)],
            "effects",
            (("gravity",),),
        ),
        # Of two one is sure; what the other is, is one of two.
        (
            [
                (("gravity", "second_mass"), 0.7),
                (("coulomb_friction", "second_mass"), 0.27),
                ((), 0.03),
            ],
            "effects",
            (("gravity", "coulomb_friction"), ("second_mass",)),
        ),
        (
            [(("gravity", "second_mass"), 0.6), (("coulomb_friction", "sensor_delay"), 0.4)],
            "undecided",
            (),
        ),
        # One or the other, or both: that it is one of them is sure.
        (
            [
                (("sensor_delay", "sensor_lowpass"), 0.5),
                (("sensor_delay",), 0.2),
                (("sensor_lowpass",), 0.3),
            ],
            "effects",
            (("sensor_delay", "sensor_lowpass"),),
        ),
        # Effects of one form are named together.
        ([(("series_tendon",), 1.0)], "effects", (("series_tendon", "maxwell_branch"),)),
    ],
)
def test_no_more_is_named_than_is_probable(rows, kind, sets):
    found = claim_of(probabilities(*rows), EFFECTS, 0.95)
    assert (found.kind, found.sets) == (kind, sets)
    if kind == "effects":
        assert found.probability >= 0.95


def test_what_is_there_whatever_else_is_stands_beside_something_unknown():
    """What no model does without is said; the effect that only some have is not."""
    found = replace(
        probabilities((None, 0.7), (("gravity", "coulomb_friction"), 0.3)),
        unknown=("coulomb_friction", "cubic_stiffness", "gravity"),
        beside_unknown={
            ("coulomb_friction", "cubic_stiffness", "gravity"): 0.6,
            ("cubic_stiffness", "gravity"): 0.1,
        },
        sets={("coulomb_friction", "gravity"): None, ("gravity",): None, (): None},
    )
    assert found.present("gravity") == pytest.approx(1.0)
    assert found.present("coulomb_friction") == pytest.approx(0.9)
    claim = claim_of(found, EFFECTS, 0.95)
    assert (claim.kind, claim.present, claim.sets) == ("unknown", ("gravity",), ())
    # The error is shown with the most probable of them, as a clue.
    assert claim.effects == found.unknown
    assert claim_of(found, EFFECTS, 0.85).present == ("coulomb_friction", "gravity")
    # Where nothing is sure, nothing is said to be; what comes nearest is shown.
    unsure = claim_of(replace(found, beside_unknown={(): 0.7}), EFFECTS, 0.95)
    assert (unsure.present, unsure.effects) == ((), found.unknown)


def test_what_is_likely_beside_what_is_claimed_is_a_clue():
    """What is likely there is in the model that is shown, and claimed nowhere."""
    likely, unlikely = (
        probabilities((("gravity", "coulomb_friction"), p), (("gravity",), 1 - p))
        for p in (0.8, 0.3)
    )
    claim = claim_of(likely, EFFECTS, 0.95)
    assert claim.sets == (("gravity",),)
    assert claim.effects == ("gravity", "coulomb_friction")
    assert claim_of(unlikely, EFFECTS, 0.95).effects == ("gravity",)
    assert (claim.instead, claim_of(unlikely, EFFECTS, 0.95).instead) == ((), ())


def test_of_several_that_may_be_a_clue_the_most_probable_is_shown():
    """That one of them is there is likely, and of none it is: the others may be in its place."""
    beside = {"second_mass": 0.35, "coulomb_friction": 0.25, "cubic_stiffness": 0.02}
    rows = [(("gravity",), 0.38), *((tuple(sorted(("gravity", k))), p) for k, p in beside.items())]
    claim = claim_of(probabilities(*rows), EFFECTS, 0.95)
    assert claim.sets == (("gravity",),)
    assert claim.effects == ("gravity", "second_mass")
    assert claim.instead == ("coulomb_friction",)
    # Where it is likely that nothing more is there, none of them is shown.
    few = [(("gravity",), 0.62), *((keys, p / 2) for keys, p in rows[1:])]
    unlikely = claim_of(probabilities(*few), EFFECTS, 0.95)
    assert (unlikely.effects, unlikely.instead) == (("gravity",), ())


def test_effects_that_are_claimed_each_need_one_of_their_own():
    found = probabilities((("gravity", "second_mass"), 0.5), (("gravity",), 0.5))
    assert found.claim([["gravity"]]) == pytest.approx(1.0)
    assert found.claim([["gravity"], ["gravity", "second_mass"]]) == pytest.approx(0.5)
    assert found.claim([["coulomb_friction"]]) == 0.0


def test_probabilities_in_words():
    found = probabilities((("gravity",), 0.9), ((), 0.07), (None, 0.029), (("second_mass",), 1e-3))
    assert describe(found) == (
        "That gravity is missing has a probability of 90 %.",
        "That nothing is missing has a probability of 7 %.",
        "That something unknown is missing has a probability of 3 %.",
    )


# The whole way


@pytest.mark.long
@pytest.mark.parametrize(
    ("hidden", "expected"),
    [((), "nothing"), ((MaxwellBranch(15.0, 0.04),), "effects")],
)
def test_a_servo_with_a_noisy_angle(hidden, expected):
    trials = servo_trials(Joint(ANATOMY, hidden), torque_sd=0.05, angle_sd=1e-4, n=8)
    study = Investigation(trials)
    found = study.weigh()
    assert sum(row.probability for row in found.rows) == pytest.approx(1.0)
    claim = study.claim(found)
    assert claim.kind == expected
    if hidden:
        assert "maxwell_branch" in claim.sets[0]


def test_a_model_with_a_discrepancy_begins_where_a_smaller_one_ended():
    """What holds of models holds of them with a discrepancy: none is less probable by a miss."""
    swing = Joint(ANATOMY, (TimeVaryingStiffness(8.0, 3.0),))
    evaluator = evaluator_for(servo_trials(swing, torque_sd=0.005))
    plain = evaluator.evaluate(KBI(), [START])
    model = KBI() + EFFECTS["cubic_stiffness"]()
    more = evaluator.evaluate(
        model, [plain.values | {"cubic_stiffness.coefficient": 1.0, "cubic_stiffness.centre": 0.0}]
    )
    discrepancy = discrepancy_of(evaluator, plain)
    smaller = discrepancy.beside(plain)
    alone, begun = discrepancy.beside(more), discrepancy.beside(more, nested=smaller)
    assert smaller._reached is not None
    assert begun.log_evidence >= alone.log_evidence
    # It is the smaller one's but for the cubic's own parameters, which cost some nats.
    assert begun.log_evidence > smaller.log_evidence - 25
