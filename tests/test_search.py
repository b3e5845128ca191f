"""No optimum is missed unseen, and no effect is named that was never left out."""

from dataclasses import replace

import numpy as np
import pytest
from constructed import probabilities
from hidden import CONDITIONS, HELD, JOINT, PAIR, study_of_a_pair, trials

from identifiability.errors import InputError
from identifiability.inference.likelihood.processes import Process
from identifiability.inference.starts import nested_values
from identifiability.investigation.fits.candidate import unfitted
from identifiability.investigation.ladder.climb import found_of
from identifiability.investigation.posterior import evidence
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.evidence import SHOWN, Evaluator
from identifiability.investigation.posterior.jobs import exchanged
from identifiability.investigation.posterior.search import _Search
from identifiability.investigation.posterior.signatures import strongest
from identifiability.investigation.posterior.weighing import Job, Weighing
from identifiability.investigation.session import Investigation
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.joint.scheme import MOST_SUBSTEPS, Scheme
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial
from identifiability.progress import silent

KEYS = ("cubic_stiffness", "sensor_delay", "second_mass")
LIBRARY = {key: EFFECTS[key] for key in KEYS}


@pytest.mark.parametrize("key", list(EFFECTS))
def test_a_smaller_model_is_in_a_larger_one(key):
    """The larger one may be integrated in steps, and a tendon has an end to its stiffness."""
    study = study_of_a_pair("torque", KEYS)
    evaluator = study._evaluator(1)
    plain = evaluator.evaluate(KBI(), [study.baseline.values])
    model = KBI() + EFFECTS[key]()
    problem = evaluator.band.problem(model)
    point = problem.free_vector(nested_values(model, plain.values))
    left = plain.weights.whitened(
        plain.weights.band.stretches(problem.by_observation(problem.residuals(point)[:, None]))
    )
    assert left[:, 0] @ left[:, 0] == pytest.approx(plain.white @ plain.white, rel=0.02)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_model_is_no_less_likely_than_one_it_contains(driven, monkeypatch):
    """Where its fit is led astray, which is made to happen here, it starts again from there."""
    study = study_of_a_pair(driven, KEYS)
    evaluator = study._evaluator(1)
    small = KBI() + EFFECTS["cubic_stiffness"]()
    nested = evaluator.evaluate(small, [study.baseline.values | nested_values(small, JOINT)])
    large = small + EFFECTS["sensor_delay"]()
    astray = nested_values(large, nested.values) | {"sensor_delay.delay": 0.03, "I": 1.0}
    monkeypatch.setattr(evidence, "EVALUATIONS", 1)
    fitted = Evaluator.fitted
    monkeypatch.setattr(Evaluator, "fitted", lambda *given: fitted(*given[:4], 0))
    alone = evaluator.evaluate(large, [astray], resolved=False)
    assert alone.log_likelihood < nested.log_likelihood - 10  # else nothing is tested
    beside = evaluator.evaluate(large, [astray], resolved=False, nested=nested)
    assert beside.log_likelihood > nested.log_likelihood - 0.5


STIFF = JOINT | {
    "soft_coupling.stiffness": 2e4,
    "soft_coupling.time": 0.002,
    "soft_coupling.share": 0.2,
}
# Nats by which noise, which has optima of its own, made the two differ in 130 studies.
OF_NOISE = 5.0


def gain_by_search_and_from_the_truth(model, values, driven):
    """Evidence over that of K, B and I of a hidden effect: as it is found, and as it might be."""
    rng = np.random.default_rng(811)
    data, held = (
        trials(model, values, rng, conditions=some, driven=driven, like=(KBI(), JOINT))
        for some in (CONDITIONS, HELD)
    )
    library = {key: EFFECTS[key] for key in model.effect_keys}
    study = Investigation(data, held, library=library, lowpass_hz=None)
    sets = study.weigh().sets
    known = study._evaluator(1).evaluate(model, [values])
    found, plain = (sets[keys].log_evidence for keys in (tuple(library), ()))
    return found - plain, known.log_evidence - plain


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_link_is_found_that_is_far_stiffer_than_the_joint(driven):
    """From softer ones the way leads away from it, past resonances in the record's band."""
    model = KBI() + EFFECTS["soft_coupling"]()
    found, known = gain_by_search_and_from_the_truth(model, STIFF, driven)
    assert known > 100  # else nothing is tested
    assert found > known - OF_NOISE


SHARES = (0.1, 0.3, 1.0, 3.0)
STIFFNESSES = (60.0, 200.0, 600.0, 2e3, 7e3, 2e4, 7e4)


@pytest.mark.long
@pytest.mark.parametrize("driven", ["torque", "angle"])
@pytest.mark.parametrize("key", [key for key in EFFECTS if key != "backlash"])
def test_the_search_finds_what_a_fit_from_the_truth_finds(key, driven):
    """Of whatever size an effect is."""
    model = KBI() + EFFECTS[key]()
    values = dict(zip(model.parameter_names, map(float, model.nominal), strict=True)) | JOINT
    values |= {n: p.plain for n, p in model.parameters.items() if p.plain is not None}
    size = next(n for n, p in model.parameters.items() if p.null is not None and p.plain is None)
    p = model.parameters[size]
    sizes = STIFFNESSES
    if np.isfinite(p.null):
        sizes = [p.null + share * (p.nominal - p.null) for share in SHARES]
    for one in sizes:
        if p.lower <= one <= p.upper:
            found, known = gain_by_search_and_from_the_truth(model, values | {size: one}, driven)
            assert found > known - OF_NOISE, one


def test_steps_too_long_for_a_larger_model_are_no_missed_optimum():
    """What a linear model has exactly is not lost where a spring beside it needs steps."""
    model = KBI() + EFFECTS["soft_coupling"]()
    values = STIFF | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    larger = model + EFFECTS["cubic_stiffness"]()
    data = trials(larger, values, 821, driven="angle", like=(KBI(), JOINT))
    library = {key: EFFECTS[key] for key in larger.effect_keys}
    study = Investigation(data[:3], data[3:], library=library, lowpass_hz=None)
    evaluator = study._evaluator(1)
    nested = evaluator.evaluate(model, [STIFF])
    start = nested_values(larger, nested.values)
    alone = evaluator.evaluate(larger, [start], resolved=False)
    assert alone.log_likelihood < nested.log_likelihood - 10  # else nothing is tested
    beside = evaluator.evaluate(larger, [start], resolved=False, nested=nested)
    assert beside.log_likelihood > nested.log_likelihood - 0.5


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_each_effect_of_the_most_probable_set_is_left_out(driven):
    """Of three effects one is not there; the pair without it was not weighed on the way."""
    study = study_of_a_pair(driven, KEYS)
    weighing = Weighing(study._evaluator(1), LIBRARY, study.baseline.keys, study.bench.rules)
    search = _Search(weighing, LIBRARY, silent)
    baseline = study.baseline
    search.add("K, B and I", [Job(baseline.model, [baseline.values])])
    search.enlarge(())
    model = KBI()
    for key in KEYS:
        model = model + EFFECTS[key]()
    search.add("three", [Job(model, [nested_values(model, PAIR)])])
    truth = ("cubic_stiffness", "sensor_delay")
    assert truth not in weighing.found
    search.leave_out()
    pairs = {keys for keys in weighing.found if len(keys) == 2}
    assert len(pairs) == 3
    # With no more than these in the library a second mass of nothing is as probable as none.
    found = weighing.found
    assert max(found, key=lambda keys: found[keys].log_evidence) == truth
    assert truth in search.enlarged


def test_beside_a_look_alike_the_others_keep_their_forms():
    """Against a set in rich forms the same in plain ones would stand no chance."""
    study = study_of_a_pair("torque", KEYS)
    model = KBI() + EFFECTS["hill_force_velocity"]() + EFFECTS["sensor_delay"]()
    start = nested_values(model, study.baseline.values)
    refined = model.refinable(("hill_force_velocity",))
    found = study._evaluator(1).evaluate(model, [start], refined=refined, resolved=False)
    values = found.values | {"hill_force_velocity.asymmetry": 0.4}
    found = replace(found, values=values)
    for key, rest in (("sensor_delay", refined), ("hill_force_velocity", ())):
        job = exchanged(found, key, EFFECTS["second_mass"](), {})
        assert job.refined == rest
        kept = [start.get("hill_force_velocity.asymmetry") for start in job.starts]
        assert (0.4 in kept) == bool(rest)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_look_alike_stands_in_for_each_effect_of_the_most_probable_sets(driven):
    """Both effects of a pair may be second best alone: one at a time never leads to it."""
    keys = ("cubic_stiffness", "sensor_delay", "sensor_lowpass")
    library = {key: EFFECTS[key] for key in keys}
    study = study_of_a_pair(driven, keys)
    weighing = Weighing(study._evaluator(1), library, study.baseline.keys, study.bench.rules)
    search = _Search(weighing, library, silent)
    cubic = KBI() + EFFECTS["cubic_stiffness"]()
    both = cubic + EFFECTS["sensor_lowpass"]()
    starts = [nested_values(model, PAIR) for model in (KBI(), cubic, both)]
    starts[2]["sensor_lowpass.time_constant"] = 0.004
    search.add("way", [Job(m, [v]) for m, v in zip((KBI(), cubic, both), starts, strict=True)])
    truth = ("cubic_stiffness", "sensor_delay")
    assert truth not in weighing.found
    search.exchange(2)
    assert max(weighing.found, key=weighing.together.score) == truth
    # Neither the pair that it came from nor itself has anything left to be exchanged.
    known = dict(weighing.found)
    search.exchange(2)
    assert weighing.found == known


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_model_is_fitted_in_the_noise_of_K_B_and_I_as_well(driven):
    """What it is fitted in first is another model's, and may be such that nothing is missing."""
    study = study_of_a_pair(driven, KEYS)
    evaluator = study._evaluator(1)
    model = KBI() + EFFECTS["cubic_stiffness"]()
    problem, start = evaluator.band.problem(model), [nested_values(model, PAIR)]
    own, white = evaluator.starts
    assert own.contenders[0].order != white.contenders[0].order  # else nothing is tested
    begun = evaluator._begun(problem, start, white)
    assert [weights for _, weights in begun] == [white, white, own]
    assert [weights for _, weights in evaluator._begun(problem, start, None)] == [
        own,
        white,
    ]


def test_a_richer_form_that_is_worse_in_the_end_is_none():
    """What is taken up is weighed in its plain form too: the noise has changed since it lost."""
    keys = ("cubic_stiffness",)
    study = study_of_a_pair("torque", keys)
    weighing = Weighing(study._evaluator(1), keys)
    model = KBI() + EFFECTS["cubic_stiffness"]()
    start = nested_values(model, JOINT)
    astray = start | {"cubic_stiffness.centre": 0.15}
    assert len(list(weighing.weigh([Job(KBI(), [nested_values(KBI(), JOINT)])]))) == 1
    evaluated = study._evaluator(1).evaluate
    plain = evaluated(model, [start])
    weighing.found[keys] = evaluated(model, [astray], refined=keys)
    assert weighing.found[keys].log_evidence < plain.log_evidence  # else nothing is tested
    weighing.take_up([keys])
    assert weighing.found[keys].refined == ()
    assert weighing.found[keys].log_evidence > plain.log_evidence - 0.5


@pytest.mark.parametrize(("driven", "shown"), [("torque", True), ("angle", False)])
def test_play_that_only_hides_the_noise_of_an_imposed_angle_is_none(driven, shown):
    """A joint that is at rest within a gap does not feel how the angle is recorded."""
    keys = ("backlash",)
    study = study_of_a_pair(driven, keys)
    weighing = Weighing(study._evaluator(1), keys)
    model = KBI() + EFFECTS["backlash"]()
    link = {
        "stiffness": 300.0,
        "time": 0.002,
        "share": 0.2,
        "gap": 2e-6,
        "rounding": 0.1,
        "place": 0.0,
    }
    values = JOINT | {f"backlash.{name}": value for name, value in link.items()}
    found = study._evaluator(1).evaluate(model, [values], resolved=False)
    estimate = replace(found.weights.estimate, carried=Process((), (), 1e-4))
    found = replace(found, weights=replace(found.weights, estimate=estimate))
    small = replace(
        found, values=found.values | {"backlash.gap": 4e-4, "backlash.stiffness": 500.0}
    )
    large = replace(found, values=small.values | {"backlash.gap": 5e-3})
    assert ("would be no play" in weighing._objection(small)) != shown
    assert weighing._objection(large) == ""


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_noise_that_one_set_found_is_tried_on_all_however_far_behind(driven):
    """Or a set that contains another would be named for the noise that it happened on."""
    study = study_of_a_pair(driven, KEYS)
    evaluator = study._evaluator(1)
    weighing = Weighing(evaluator, LIBRARY, study.baseline.keys, study.bench.rules)
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = study.baseline.values
    jobs = [Job(KBI(), [values]), Job(model, [nested_values(model, values)])]
    assert len(list(weighing.weigh(jobs))) == 2
    lead = weighing.found["cubic_stiffness",]
    # The same parameters in white noise of ten times the size, as a search that failed leaves it.
    white = evaluator.white
    loud = replace(white, estimate=replace(white.estimate, rms=10 * white.estimate.rms))
    spoilt = evaluator.evaluated(weighing.found[()].problem, weighing.found[()].x, loud)
    right = weighing.found[()]
    # What a model leaves is known; how likely that is in another noise needs no new response.
    assert evaluator.likelihood_by(right, loud) == pytest.approx(spoilt.log_likelihood)
    assert evaluator.likelihood_by(spoilt, right.weights) == pytest.approx(right.log_likelihood)
    weighing.found[()] = spoilt
    assert spoilt.log_likelihood < right.log_likelihood - 100  # else nothing is tested
    assert weighing.share_noise() == [()]
    assert weighing.found[()].log_likelihood > right.log_likelihood - 1
    assert weighing.found["cubic_stiffness",] is lead
    # What no other noise makes likelier stays as it is.
    assert weighing.share_noise() == []


PENDULUM = {"K": 0.02, "B": 0.02, "I": 0.15, "gravity.moment": 3.0, "gravity.posture": 0.0}
RUBS = {
    "coulomb_friction.torque": 0.15,
    "coulomb_friction.velocity": 0.05,
    "coulomb_friction.range": 2e-5,
    "coulomb_friction.breakaway": 0.0,
    "coulomb_friction.asymmetry": 0.0,
}


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_signatures_are_sought_beside_the_model_at_hand(driven):
    """What holds a pendulum is its weight: beside K, B and I alone a small effect is no joint's."""
    time = np.arange(600) / 200
    model = KBI() + EFFECTS["gravity"]()
    rubbing = model + EFFECTS["coulomb_friction"]()
    records = []
    for seed, hertz in enumerate((0.55, 0.7, 0.9)):
        drive = SampledTorque(0.9 * np.sin(2 * np.pi * hertz * time) * (time > 0.2)).drive(time)
        torque = drive.signals[:, 0]
        angle = simulate(rubbing, rubbing.vector(PENDULUM | RUBS), drive)
        noise = 2e-4 * np.random.default_rng(seed).standard_normal(time.size)
        pair = (torque, angle + noise) if driven == "torque" else (torque + 10 * noise, angle)
        records.append(Trial(time, *pair, driven=driven, name=f"t{seed}"))
    study = Investigation(records)
    evaluator = study._evaluator(1)
    found = evaluator.by_least_squares(evaluator.begun(model, [PENDULUM]))
    assert found.values["gravity.moment"] == pytest.approx(3.0, rel=0.2)
    others = {key: effect for key, effect in EFFECTS.items() if key != "gravity"}
    assert "coulomb_friction" in strongest(evaluator, found, others, {}, 3)


def test_a_path_beside_a_linear_tendon_shows_where_the_muscle_has_an_effect():
    linear, stiffening = EFFECTS["series_tendon"](), EFFECTS["nonlinear_tendon"]()
    hill = EFFECTS["hill_force_velocity"]()
    assert (KBI() + linear).refinable(["series_tendon", "gravity"]) == ()
    assert (KBI() + linear + EFFECTS["gravity"]()).refinable(["series_tendon"]) == ()
    assert (KBI() + linear + hill).refinable(["series_tendon"]) == ("series_tendon",)
    assert (KBI() + stiffening).refinable(["nonlinear_tendon"]) == ("nonlinear_tendon",)


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_plainer_effect_is_weighed_from_the_values_of_its_richer_form(driven):
    keys = ("hill_force_velocity", "nonlinear_tendon", "series_tendon")
    library = {key: EFFECTS[key] for key in keys}
    study = study_of_a_pair(driven, keys)
    weighing = Weighing(study._evaluator(1), library, study.baseline.keys, study.bench.rules)
    search = _Search(weighing, library, silent)
    model = KBI() + EFFECTS[keys[0]]() + EFFECTS[keys[1]]()
    # Stiffer, it is too fast for the steps that it begins with.
    start = nested_values(model, JOINT) | {"nonlinear_tendon.stiffness": 2000.0}
    search.add("two", [Job(model, [start], ["nonlinear_tendon"])])
    (job,) = search._plainer(keys[:2])
    assert job.model.effect_keys == ("hill_force_velocity", "series_tendon")
    assert tuple(job.refined) == ("series_tendon",)
    (values,), richer = job.starts, weighing.found[keys[:2]].values
    for name in ("stiffness", "bypass_stiffness", "bypass_damping"):
        assert values[f"series_tendon.{name}"] == richer[f"nonlinear_tendon.{name}"]


def test_what_cannot_be_integrated_has_no_evidence(monkeypatch):
    """However likely longer steps made it; and what was found in steps short enough stands."""
    study = study_of_a_pair("torque", KEYS)
    weighing = Weighing(study._evaluator(1), KEYS)
    one, other = (KBI() + EFFECTS[key]() for key in KEYS[:2])
    jobs = [Job(m, [nested_values(m, JOINT)]) for m in (KBI(), one, other)]
    assert len(list(weighing.weigh(jobs))) == 3
    finer = Evaluator._finer

    def refuse(problem, found, most):
        if "cubic_stiffness" in problem.model.effect_keys:
            raise InputError("too fast for its samples")
        return finer(problem, found, most)

    monkeypatch.setattr(Evaluator, "_finer", staticmethod(refuse))
    weighing.take_up([(), ("cubic_stiffness",), ("sensor_delay",)])
    assert ("cubic_stiffness",) not in weighing.found
    assert weighing.failures["cubic_stiffness"] == "too fast for its samples"
    assert () in weighing.found
    assert all(row.effects != ("cubic_stiffness",) for row in weighing.together.posterior().rows)
    # It counts as it was before, where that could be integrated.
    resolved = weighing.found["sensor_delay",]
    assert weighing.taken_up["sensor_delay",] is resolved
    better = replace(resolved, log_evidence=resolved.log_evidence + 10)
    weighing.found["sensor_delay",] = better

    def never(problem, found, most):
        raise InputError("too fast for its samples")

    monkeypatch.setattr(Evaluator, "_finer", staticmethod(never))
    weighing.take_up([("sensor_delay",)])
    assert weighing.found["sensor_delay",] is resolved


def test_what_is_behind_is_only_looked_at_until_it_comes_near(monkeypatch):
    study = study_of_a_pair("torque", KEYS)
    weighing = Weighing(study._evaluator(1), KEYS)
    one, other = (KBI() + EFFECTS[key]() for key in ("cubic_stiffness", "sensor_delay"))
    list(weighing.weigh([Job(m, [nested_values(m, JOINT)]) for m in (KBI(), one, other)]))
    steps, finer = {}, Evaluator._finer

    def asking(problem, found, most):
        steps.setdefault(problem.model.effect_keys, []).append(most)
        return finer(problem, found, most)

    monkeypatch.setattr(Evaluator, "_finer", staticmethod(asking))
    sets = [("sensor_delay",), ("cubic_stiffness",)]
    ahead, behind = sorted(sets, key=lambda keys: -weighing.found[keys].log_evidence)
    weighing.look_at(sets)
    assert set(steps[ahead]) == set(steps[behind]) == {SHOWN}
    weighing.take_up_best(sets)
    # The best as far as samples show, then to the end; the other not further.
    assert steps[ahead][-1] == MOST_SUBSTEPS
    assert set(steps[behind]) == {SHOWN}
    # Not again, unless it comes near.
    steps.clear()
    weighing.look_at(sets)
    weighing.take_up_best(sets)
    assert not steps
    weighing.take_up(sets)
    assert steps.keys() == {behind}
    assert set(steps[behind]) == {MOST_SUBSTEPS}


def test_what_leads_a_size_was_evaluated_to_the_end(monkeypatch):
    """Also where what led before falls behind once its steps are short enough."""
    study = study_of_a_pair("torque", KEYS)
    weighing = Weighing(study._evaluator(1), KEYS)
    one, other = (KBI() + EFFECTS[key]() for key in ("cubic_stiffness", "sensor_delay"))
    list(weighing.weigh([Job(m, [nested_values(m, JOINT)]) for m in (KBI(), one, other)]))
    sets = [("sensor_delay",), ("cubic_stiffness",)]
    ahead, behind = sorted(sets, key=lambda keys: -weighing.found[keys].log_evidence)
    resolved = Evaluator.resolved

    def falling(self, found, least=-np.inf, steps=MOST_SUBSTEPS):
        best = resolved(self, found, least, steps)
        if steps < MOST_SUBSTEPS or best.model.effect_keys != ahead:
            return best
        finer = best.problem.with_scheme(Scheme(MOST_SUBSTEPS))
        return replace(best, problem=finer, log_evidence=best.log_evidence - 1e4)

    monkeypatch.setattr(Evaluator, "resolved", falling)
    weighing.look_at(sets)
    weighing.take_up_best(sets)
    assert weighing.found[behind].log_evidence > weighing.found[ahead].log_evidence
    assert {ahead, behind} <= weighing.taken_up.keys()


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_what_every_likely_set_has_need_not_have_been_weighed_by_itself(driven):
    """What is sure whatever else is missing may be a set that no search came by."""
    pair, three = ("cubic_stiffness", "sensor_delay"), tuple(sorted(KEYS))
    study = study_of_a_pair(driven, pair)
    made_up = probabilities((three, 1.0))
    model = made_up.sets[three].candidate.model
    larger = replace(made_up.sets[three], candidate=unfitted(model, nested_values(model, PAIR)))
    posterior = replace(made_up, sets={**made_up.sets, three: larger})
    claim = Claim("unknown", pair, (), 1.0)
    found = found_of(study.bench, study.baseline, posterior, claim, LIBRARY)
    assert not found.failure
    assert found.final.keys == pair
    assert sorted(one.key for one in found.missing) == sorted(pair)
    assert found.final.fitted.error < 0.1 * study.baseline.fitted.error
