"""Fits reach their optimum: no fit with a parameter held ever beats the one with it free."""

from dataclasses import replace

import numpy as np
import pytest
from constructed import probabilities

from identifiability.inference.conditional import one_by_one
from identifiability.investigation.fits import bench as fits_bench
from identifiability.investigation.fits import widths as fits_widths
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import unfitted
from identifiability.investigation.investigate import investigate
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque, imposed_motion
from identifiability.measurement.trials import Trial

TIME = np.arange(300) / 500
JOINT = {"K": 30.0, "B": 1.0, "I": 0.1}
PULSE = np.where((TIME > 0.06) & (TIME < 0.16), np.sin(np.pi * (TIME - 0.06) / 0.1) ** 2, 0.0)
SHIFTED = np.where((TIME > 0.3) & (TIME < 0.5), np.sin(np.pi * (TIME - 0.3) / 0.2) ** 2, 0.0)
SHAKEN = np.sin(2 * np.pi * 20 * TIME) + np.sin(2 * np.pi * 27 * TIME + 1)
TOLERANCE = 0.1  # nats of the noise
# Friction's smoothing speed is passed within a step, which leaves its cost rough.
ROUGH = {"coulomb_friction": 0.2}
ABRUPT = {"torque": 0.3, "velocity": 0.003, "damping": 100.0}  # of friction


def trials(model, values, driven, noise=0.01, shape=PULSE - 0.6 * SHIFTED, seed=1):
    rng = np.random.default_rng(seed)
    theta, out = model.vector(values), []
    for i, size in enumerate((1.0, -2.0)):
        torque, angle = 8 * size * shape, 0.1 * size * shape
        if driven == "torque":
            angle = simulate(model, theta, SampledTorque(torque).drive(TIME))
        else:
            torque = simulate(model, theta, imposed_motion(TIME, angle))
        response = angle if driven == "torque" else torque
        noisy = response + noise * np.std(response) * rng.standard_normal(response.size)
        torque, angle = (torque, noisy) if driven == "torque" else (noisy, angle)
        out.append(Trial(TIME, torque, angle, driven=driven, name=f"t{i}"))
    return out


def fitted(key, driven, changes=None, **experiment):
    """An effect fitted to trials of a joint that has it."""
    model = KBI() + EFFECTS[key]()
    nominal = dict(zip(model.parameter_names, model.nominal, strict=True))
    values = nominal | JOINT | {f"{key}.{name}": value for name, value in (changes or {}).items()}
    data = trials(model, values, driven, **experiment)
    study = Investigation(data[:1], data[1:], library={key: EFFECTS[key]}, lowpass_hz=None)
    return study.bench, study.fit(model)


def problem_of(bench: Workbench, candidate):
    """That of the fitted trials, as the candidate was fitted to them."""
    return bench.problem(
        candidate.model, bench.split.fitted, refined=candidate.refined, scheme=candidate.scheme
    )


def gains_when_held(bench: Workbench, candidate):
    """How much better [nats] fits are that hold one parameter about where the free fit has it."""
    problem = problem_of(bench, candidate)
    best = problem.free_vector(candidate.values)
    residuals, jacobian = problem.residuals(best), problem.jacobian(best)
    cost = 0.5 * residuals @ residuals
    # The weights are not the noise, which is what the fit leaves.
    scale = 0.5 * problem.n_samples / cost
    information = jacobian.T @ jacobian * scale
    size = 1 / np.sqrt(np.diag(information))
    sds = size * np.sqrt(np.diag(np.linalg.pinv(information * np.outer(size, size))))
    gains = {}
    for i, name in enumerate(problem.names):
        values = np.clip(
            best[i] + sds[i] * np.array([-3, -1, -0.3, 0.3, 1, 3]),
            problem.lower[i],
            problem.upper[i],
        )
        if candidate.model.parameters[name].is_delay:
            values = np.append(values, np.linspace(problem.lower[i], problem.upper[i], 7)[1:-1])
        points = np.repeat(best[None], len(values), axis=0)
        points[:, i] = values
        # Twice, as one pass is no more than a few evaluations.
        held = one_by_one(problem, (i,), one_by_one(problem, (i,), points).points)
        gains[name] = scale * (cost + float(held.log_likelihood.max()))
    return gains


@pytest.mark.parametrize("key", EFFECTS)
def test_no_restricted_fit_beats_the_free_one(key):
    bench, free = fitted(key, "torque")
    assert not free.failure
    gains = gains_when_held(bench, free)
    assert max(gains.values()) < ROUGH.get(key, TOLERANCE), gains


@pytest.mark.parametrize("key", ["stretch_reflex", "series_tendon", "sensor_delay"])
def test_nor_where_the_motion_is_imposed(key):
    bench, free = fitted(key, "angle")
    gains = gains_when_held(bench, free)
    assert max(gains.values()) < TOLERANCE, gains


def test_a_tendon_that_hardly_shows_is_found_along_its_ridge():
    """K, B and a stiff tendon make up for each other along a long curved ridge."""
    bench, free = fitted("series_tendon", "torque", {"stiffness": 750.0}, noise=1e-3)
    gains = gains_when_held(bench, free)
    assert max(gains.values()) < TOLERANCE, gains


def test_a_delay_is_found_beyond_the_next_ripple():
    """Shaken at 20 and 27 Hz: waves of 40 to 50 ms along the delay, and ripples of a sample."""
    true = {"delay": 0.033, "time_constant": 0.01}
    bench, free = fitted("stretch_reflex", "angle", true, shape=SHAKEN)
    gains = gains_when_held(bench, free)
    assert max(gains.values()) < TOLERANCE, gains
    assert free.values["stretch_reflex.delay"] == pytest.approx(true["delay"], abs=2e-3)


def test_what_was_weighed_is_fitted_from_its_delay(monkeypatch):
    """Its delay was sought when it was weighed; fits from elsewhere seek it over its range."""
    true = {"delay": 0.033, "time_constant": 0.01}
    bench, free = fitted("stretch_reflex", "angle", true, shape=SHAKEN)
    weighed = unfitted(free.model, free.values, free.refined, free.scheme)
    sought = []
    profiled = fits_bench.delays_profiled

    def counted(*arguments, **options):
        sought.append(arguments)
        return profiled(*arguments, **options)

    monkeypatch.setattr(fits_bench, "delays_profiled", counted)
    found = bench.finish(weighed)
    assert not sought
    assert found.fitted.weighted == pytest.approx(free.fitted.weighted, rel=1e-4)
    again = Workbench(bench.split).fit(free.model, [free.values], refined=free.refined)
    assert sought
    assert again.fitted.weighted == pytest.approx(free.fitted.weighted, rel=1e-4)


def moved_by_half_the_step(bench, candidate):
    """By how many nats the fitted trials are more or less likely in half the step."""
    problem = problem_of(bench, candidate)
    x = problem.free_vector(candidate.values)
    costs = [float(np.sum(p.residuals(x) ** 2)) for p in (problem, problem.halved())]
    return abs(0.5 * problem.n_samples * np.log(costs[1] / costs[0]))


def test_half_the_step_is_as_likely():
    """Too long a step leaves ripples in the cost of a model with corners, where fits end."""
    bench, free = fitted("coulomb_friction", "torque", ABRUPT)
    assert moved_by_half_the_step(bench, free) < bench.rules.solver_nats
    # So sharp a limit is met too, and not because it would be met anyway.
    moved = {}
    for limit in (0.02, np.inf):
        rules = replace(bench.rules, solver_nats=limit)
        other = Workbench(replace(bench.split, rules=rules))
        moved[limit] = moved_by_half_the_step(other, other.fit(free.model, [free.values]))
    assert moved[0.02] < 0.02 < moved[np.inf]


@pytest.mark.parts_fail
@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_widths_of_too_long_a_record_are_refused_and_the_rest_goes_on(driven, monkeypatch):
    data = trials(KBI(), JOINT, driven)
    monkeypatch.setattr(fits_widths, "_MOST_WORK", 100)
    found = investigate(data[:1], data[1:], library={}, most=0)
    assert found.widths is None
    assert "too many to profile and to sample 3 parameters" in found.failures["widths"]
    assert set(found.failures) == {"widths"}
    assert found.verdict.kind == "nothing_missing"


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_lower_optimum_that_widths_meet_is_taken_up(driven):
    """Whatever led the fit astray: the model that is shown leaves the least that is known."""
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 900.0, "cubic_stiffness.centre": 0.0}
    data = trials(model, values, driven, shape=3 * (PULSE - 0.6 * SHIFTED))
    study = Investigation(
        data[:1], data[1:], library={"cubic_stiffness": EFFECTS["cubic_stiffness"]}
    )
    best = study.fit(model)
    widths = study.widths(best)
    assert study.lower(best, widths) is None
    astray = best.values | {"K": 2 * best.values["K"], "I": 0.7 * best.values["I"]}
    left = study.bench.residual(model, astray, study.split.fitted, (), best.scheme)
    known = study.lower(replace(best, values=astray, fitted=left), widths)
    assert known == pytest.approx(best.values, rel=1e-3)
    # Where it was weighed is a place that no fit leaves: it starts from the other as well.
    made_up = probabilities((("cubic_stiffness",), 1.0))
    weighed = replace(made_up.sets["cubic_stiffness",], candidate=unfitted(model, astray))
    posterior = replace(made_up, sets={**made_up.sets, ("cubic_stiffness",): weighed})
    study.bench = Stuck(study.bench)
    assert study.climb(posterior).final.values == pytest.approx(astray)
    found = study.climb(posterior, also=known)
    assert found.final.values == pytest.approx(best.values, rel=1e-3)
    assert found.final.fitted.weighted < left.weighted


class Stuck:
    """A workbench whose fits end where they began, at the best of their starts."""

    def __init__(self, bench):
        self.bench = bench

    def __getattr__(self, name):
        return getattr(self.bench, name)

    def fit(self, model, starts, *, refined=()):
        found = self.bench.fit(model, starts, refined=refined)
        ends = [
            replace(found, values=dict(start), fitted=self.left(model, start, found))
            for start in starts
        ]
        return min(ends, key=lambda one: one.fitted.weighted)

    def finish(self, candidate):
        if candidate.free:
            return candidate
        return self.fit(candidate.model, [candidate.values], refined=candidate.refined)

    def left(self, model, values, found):
        return self.residual(model, values, self.split.fitted, found.refined, found.scheme)
