"""Fits of long records are begun on fewer samples, and end no worse than those of all samples."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import JOINT, LONG, long_record

from identifiability.inference.starts import starting_values
from identifiability.investigation.posterior import band
from identifiability.investigation.posterior.band import band_of
from identifiability.investigation.posterior.evidence import EVALUATIONS, Evaluator
from identifiability.investigation.posterior.jobs import enlarged
from identifiability.investigation.posterior.reference import evaluator_of
from identifiability.investigation.posterior.signatures import strongest
from identifiability.investigation.posterior.weighing import LOST, Job, Weighing
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_fit_that_was_begun_on_fewer_samples_is_no_worse(driven):
    trial, model = long_record(driven)
    evaluator = evaluator_of(band_of([trial], []), JOINT)
    assert evaluator.coarse is not None
    assert evaluator.coarse.band.n_samples < 0.5 * evaluator.band.n_samples
    whole = replace(evaluator, coarse=None)
    starts = starting_values(model, JOINT, wide=True)
    one, other = (e.evaluate(model, starts, resolved=False) for e in (evaluator, whole))
    one = evaluator.evaluate(model, [one.values], noise=one.weights)
    assert one.log_evidence > other.log_evidence - 0.5
    for name, sd in one.sds.items():
        assert abs(one.values[name] - (JOINT | LONG[driven])[name]) < 5 * sd
    # Fewer samples know less: the rest of the record has had its say.
    assert evaluator.coarse.evaluate(model, starts).sds["K"] > 1.3 * one.sds["K"]


@pytest.mark.parametrize(
    ("driven", "more", "given_up"),
    [
        ("angle", {"sensor_delay.delay": 0.01}, 1),
        ("torque", {"gravity.moment": 5.0, "gravity.posture": 0.3}, 0),
    ],
)
def test_noise_that_falls_far_behind_at_once_is_given_up(driven, more, given_up, monkeypatch):
    """The fit ends where it would with both, here of a model that misses one of two effects."""
    trial, truth = long_record(driven, (21, 11), more)
    evaluator = evaluator_of(band_of([trial], []), JOINT)
    model = KBI() + truth.effect(next(iter(more)).split(".")[0])
    starts = starting_values(model, JOINT, wide=True)
    settled, fits = Evaluator.settled, []

    def counted(self, *args, **how):
        fits.append(how["further"])
        return settled(self, *args, **how)

    monkeypatch.setattr(Evaluator, "settled", counted)
    every = evaluator.roughly(model, starts, every_noise=True)
    assert fits == 2 * [EVALUATIONS]
    fits.clear()
    ahead = evaluator.roughly(model, starts)
    assert fits == 2 * [0] + (2 - given_up) * [EVALUATIONS]
    assert ahead.log_evidence > every.log_evidence - 0.5


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_fewer_samples_show_whose_signature_is_the_strongest(driven):
    trial, model = long_record(driven)
    evaluator = evaluator_of(band_of([trial], []), JOINT)
    whole = replace(evaluator, coarse=None)
    found = whole.evaluate(KBI(), [JOINT])
    one, other = (set(strongest(e, found, EFFECTS, {}, 3)) for e in (evaluator, whole))
    assert model.effect_keys[0] in one & other
    assert len(one & other) >= len(other) - 1


def test_short_trials_are_fitted_as_they_are():
    trial, _ = long_record("torque")
    time, torque, angle = (x[:3000] for x in (trial.time, trial.torque, trial.angle))
    short = [replace(trial, time=time, torque=torque, angle=angle)]
    assert evaluator_of(band_of(short, []), JOINT).coarse is None


def test_noise_and_fit_go_on_in_turn_until_that_brings_nothing_more():
    """After two rounds noise of long memory has a part of the misfit, and K is far off."""
    trial, model = long_record("angle", smoothing=(21, 11))
    evaluator = replace(evaluator_of(band_of([trial], []), JOINT), coarse=None)
    problem = evaluator.band.problem(model, probes=evaluator.reference.probes)
    start = problem.free_vector(JOINT | LONG["angle"]) * [0.96, 1.0, 1.0, 1.04, 1.1]
    two, all_of_them = (
        evaluator.settled(problem, start[None], evaluator.starts[0], most=n) for n in (2, 12)
    )
    assert all_of_them.log_evidence > two.log_evidence + 100
    off = abs(two.values["K"] - all_of_them.values["K"])
    assert off > 10 * two.sds["K"]
    assert abs(all_of_them.values["K"] - JOINT["K"]) < 0.1 * off


@pytest.mark.long
def test_a_few_pieces_tell_how_much_noise_a_model_makes_of_an_angle(monkeypatch):
    trial, _ = long_record("angle", smoothing=(21, 11))
    noise = 3e-4 * np.random.default_rng(3).standard_normal(trial.angle.size)
    noisy = replace(trial, angle=trial.angle + noise)
    found = []
    for most in (2048, 10**9):
        monkeypatch.setattr(band, "_MOST_PROBED", most)
        evaluator = replace(evaluator_of(band_of([noisy], []), JOINT), coarse=None)
        one = evaluator.evaluate(KBI(), [JOINT], resolved=False)
        found.append((len(evaluator.reference.probes), one))
    (few, one), (every, other) = found
    assert few < 0.5 * every
    # The noise is told from the response's own by what it adds, which decides here.
    assert one.weights.excess > 1000
    assert one.log_evidence == pytest.approx(other.log_evidence, abs=0.5)
    for name, sd in other.sds.items():
        assert abs(one.values[name] - other.values[name]) < 0.2 * sd


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_sets_that_a_part_of_the_samples_excludes_are_far_behind_by_all(driven):
    """Beside what is known the sensor is late; nothing else that is tried is like that."""
    trial, model = long_record(driven, (21, 11), {"sensor_delay.delay": 0.004})
    evaluator = evaluator_of(band_of([trial], []), JOINT)
    first = next(key for key in model.effect_keys if key != "sensor_delay")
    weighing = Weighing(evaluator, EFFECTS)
    list(weighing.weigh([Job(KBI(), [JOINT])]))
    list(weighing.weigh([enlarged(weighing.found[()], EFFECTS[first](), {})]))
    current = weighing.found[first,]
    tried = ("sensor_delay", "gravity", "coulomb_friction")
    jobs = [enlarged(current, EFFECTS[key](), {}) for key in tried]
    kept = [key for job in weighing.in_reach(jobs) for key in job.model.effect_keys if key != first]
    assert kept == ["sensor_delay"]
    assert {key for keys in weighing.screened for key in keys} == {first, *tried} - {"sensor_delay"}
    list(weighing.weigh(jobs))
    best = max(found.log_evidence for found in weighing.found.values())
    for keys in weighing.screened:
        assert best - weighing.found[keys].log_evidence > LOST
    # Nothing is excluded where all samples are few, nor before a better one was begun.
    short = Weighing(replace(evaluator, coarse=None), EFFECTS, found=dict(weighing.found))
    assert short.in_reach(jobs) == jobs
    alone = Weighing(evaluator, EFFECTS, found={(): weighing.found[()]})
    assert len(alone.in_reach(jobs[1:2])) == 1
