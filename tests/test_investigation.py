"""The investigation: evidence, candidates, search, verdict, on data of an independent simulator."""

import argparse
import inspect
import json
from dataclasses import replace

import numpy as np
import pytest
from constructed import probabilities
from hidden import CONDITIONS, HELD, JOINT, TIME, record_that_grows, trials

from identifiability.benchmark.score import matched, wilson
from identifiability.cli import investigate as command
from identifiability.cli.main import main
from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.investigate import investigate
from identifiability.investigation.pieces import owners
from identifiability.investigation.rules import Rules
from identifiability.investigation.session import Investigation
from identifiability.investigation.split import gather
from identifiability.joint.effects import (
    EFFECTS,
)
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import KBI
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial
from identifiability.report.investigation import investigation_text


class LateSpring(Effect):
    """A user's own effect: a stiffness that acts on one side only."""

    key = "late_spring"
    title = "a spring on one side"
    place = "joint"
    linear = False
    parameters = (
        Parameter("stiffness", "k", "Nm/rad", 10.0, 0.0, 500.0, "stiffness of the stop", null=0.0),
    )

    def torque(self, p, motion, states, delayed):
        return p[0] * _positive(motion.angle)


def _positive(angle):
    import jax.numpy as jnp

    return jnp.maximum(angle, 0.0)


# Evidence


def test_held_out_trials_are_chosen_by_amplitude():
    chosen = gather(trials(KBI(), JOINT))
    names = {r.name for r in chosen.held_out}
    assert "t1" in names  # the largest: an extrapolation
    assert 1 <= len(names) <= 2
    assert len(chosen.fitted) + len(chosen.held_out) == 4


def test_noise_floor_is_that_of_the_noise():
    # 50 samples a trial: the variance is known to 2/sqrt(2*50*4) = 10 % (one standard error 7 %).
    floors = [gather(trials(KBI(), JOINT, seed=s)).noise_floor() for s in range(20)]
    assert np.mean(floors) == pytest.approx(1e-6, rel=4 * 0.1 / np.sqrt(20))


def test_one_record_is_split_in_halves():
    both = [("pulse", 8)]
    first = trials(KBI(), JOINT, conditions=both)[0]
    t = np.arange(500) / 500
    double = Trial(
        t, np.tile(first.torque, 2), np.tile(first.angle, 2), name="long", condition="pulse"
    )
    split = gather([double])
    assert split.how_held_out == "the second half of the record"
    assert split.fitted[0].last == split.held_out[0].first == 250


@pytest.mark.parametrize(("share", "fitted"), [(0.4, "first"), (0.6, "second")])
def test_the_half_is_fitted_that_reaches_most_of_the_other(share, fitted):
    # So much of the second half swings beyond what the first reaches.
    t = np.arange(2000) / 1000
    angle = 0.1 * np.sin(2 * np.pi * 2 * t)
    angle[1000 : 1000 + round(1000 * share)] += 1.0
    record = Trial(t, np.cos(2 * np.pi * 2 * t), angle, name="long")
    split = gather([record])
    assert (split.fitted[0].first == 0) == (fitted == "first")
    assert (split.held_out[0].last == 1000) == (fitted == "second")
    assert ("beyond its angles" in split.how_held_out) == (fitted == "second")


def test_a_trial_that_moves_in_one_half_only_is_refused():
    one = trials(KBI(), JOINT, conditions=[("pulse", 8)])[0]
    still = replace(one, angle=np.where(TIME < 0.25, one.angle, 0.0))
    with pytest.raises(InputError, match="one half only"):
        gather([still])


def test_pieces_of_a_long_record_leave_what_the_whole_leaves(monkeypatch):
    t = np.arange(3000) / 1000
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-2.0, 2.0], 60), 50)
    model = KBI()
    joint = JOINT | {"B": 0.5}  # what was before fades by exp(-2.5) in a second
    theta = model.vector(joint)
    angle = simulate(model, theta, SampledTorque(u).drive(t)) + 1e-4 * rng.standard_normal(t.size)
    record = Trial(t, u, angle, name="long")
    values = joint | {"K": 33.0}
    whole = Workbench(gather([record])).residual(model, values, gather([record]).fitted)
    monkeypatch.setattr("identifiability.investigation.pieces._LONGEST", 800)
    # Shorter than what precedes each.
    monkeypatch.setattr("identifiability.investigation.pieces.MOST_SAMPLES", 400)
    split = gather([record])
    bench = Workbench(split)
    problem = bench.problem(model, split.fitted)
    assert len(problem.observations) > 2
    assert set(owners(problem.observations)) == {0}
    cut = bench.residual(model, values, split.fitted)
    np.testing.assert_allclose(cut.by_trial[0], whole.by_trial[0], atol=1e-5 * np.ptp(angle))


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_motion_before_the_onset_is_not_taken_for_noise(noise):
    growing = record_that_grows(KBI(), JOINT, noise=noise)
    assert gather([growing]).has_noise  # the control: by size alone its beginning seems at rest
    assert not Investigation([growing]).split.has_noise


def test_noise_of_both_sensors_at_rest_is_taken_for_noise():
    rng = np.random.default_rng(5)
    still = [
        replace(t, torque=t.torque + 0.05 * rng.standard_normal(t.torque.size))
        for t in trials(KBI(), JOINT)
    ]
    study = Investigation(still)
    assert study.split.moves_early
    assert study.split.has_noise


# Candidates


def test_starts_contain_the_smaller_model():
    model = KBI() + EFFECTS["cubic_stiffness"]()
    starts = starting_values(model, JOINT)
    assert all(start["K"] == 30.0 for start in starts)
    assert abs(starts[0]["cubic_stiffness.coefficient"]) < 1.0


def test_a_tendon_starts_with_a_muscle_that_makes_up_for_it():
    model = KBI() + EFFECTS["series_tendon"]()
    for start in starting_values(model, JOINT):
        soft = start["series_tendon.stiffness"]
        assert start["K"] * soft / (start["K"] + soft) == pytest.approx(30.0, rel=0.1)


def test_a_candidate_without_a_finite_response_is_recorded_not_raised():
    class Explosive(LateSpring):
        key = "explosive"

        def torque(self, p, motion, states, delayed):
            return p[0] * _positive(motion.angle) / 0.0

    bench = Workbench(gather(trials(KBI(), JOINT)))
    model = KBI() + Explosive()
    found = bench.fit(model, starting_values(model, JOINT))
    assert found.failure
    assert not np.isfinite(found.fitted.error)


# The error ladder: a small library, to compile little


SMALL = {k: EFFECTS[k] for k in ("cubic_stiffness", "quadratic_stiffness", "sensor_delay")}
CUBIC = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}


ALL, FEW = (CONDITIONS, HELD), (CONDITIONS[::3], HELD[:1])


def study_of(model, values, library, some=ALL, **options):
    fitted, held = (
        trials(model, values, s, conditions=c) for s, c in zip((1, 9), some, strict=True)
    )
    return Investigation(fitted, held, library=library, **options)


@pytest.fixture(scope="module")
def cubic_study():
    """A study of a joint with a cubic spring, and what is probable."""
    study = study_of(KBI() + EFFECTS["cubic_stiffness"](), CUBIC, SMALL)
    return study, study.weigh()


def test_nothing_is_added_where_nothing_is_missing():
    study = study_of(KBI(), JOINT, SMALL)
    found = study.weigh()
    assert study.claim(found).kind == "nothing"
    climbed = study.climb(found)
    assert climbed.final is climbed.baseline
    assert {t.key for t in climbed.alone} == set(SMALL)


def test_the_missing_effect_is_found_and_the_error_falls_to_the_floor(cubic_study):
    study, posterior = cubic_study
    assert study.claim(posterior).sets == (("cubic_stiffness",),)
    found = study.climb(posterior)
    assert found.final.keys == ("cubic_stiffness",)
    assert found.final.values["cubic_stiffness.coefficient"] == pytest.approx(120.0, rel=0.05)
    assert found.final.held_out.error < 1.3e-6
    assert found.baseline.held_out.error > 20e-6
    (missing,) = found.missing
    assert missing.rung is found.final
    assert missing.without is found.baseline
    assert [r.key for r in missing.rivals] == ["quadratic_stiffness", "sensor_delay"]
    assert all(r.evidence < 0 for r in missing.rivals)
    assert found.alone[0].key == "cubic_stiffness"


@pytest.mark.long
def test_every_rung_leaves_less_than_the_one_before():
    model = KBI() + EFFECTS["cubic_stiffness"]() + EFFECTS["sensor_delay"]()
    values = CUBIC | {"sensor_delay.delay": 0.004}
    both = ("cubic_stiffness", "sensor_delay")
    study = study_of(model, values, {key: SMALL[key] for key in both})
    found = study.climb(study.weigh())
    assert len(found.missing) == 2
    errors = [rung.fitted.error for rung in found.ladder]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1.3e-6
    first, second = found.missing
    assert second.without.keys == (first.key,)
    assert second.rung is found.final
    assert first.share + second.share == pytest.approx(found.share)


def test_a_set_that_was_not_weighed_is_fitted_from_the_final_values():
    study = study_of(KBI() + EFFECTS["cubic_stiffness"](), CUBIC, SMALL)
    pair = ("cubic_stiffness", "sensor_delay")
    final = study.fit(KBI() + EFFECTS[pair[0]]() + EFFECTS[pair[1]]())
    made_up = probabilities((pair, 1.0))
    weighed = replace(made_up.sets[pair], candidate=final)
    posterior = replace(made_up, sets={**made_up.sets, pair: weighed})
    found = study.climb(posterior)
    assert found.final.keys == pair
    assert [m.without.keys for m in found.missing] == [("sensor_delay",), ("cubic_stiffness",)]
    assert found.missing[1].without.fitted.error == pytest.approx(
        study.fit(KBI() + EFFECTS["cubic_stiffness"]()).fitted.error, rel=1e-3
    )


def failing_fits(monkeypatch):
    """Have every fit of a model with effects fail."""
    whole = Workbench.fit

    def failing(bench, model, starts, **options):
        found = whole(bench, model, starts, **options)
        return replace(found, failure="no finite response") if model.effect_keys else found

    monkeypatch.setattr(Workbench, "fit", failing)


def test_a_final_model_that_cannot_be_fitted_stands_as_it_was_weighed(monkeypatch, cubic_study):
    _, posterior = cubic_study
    study = study_of(KBI() + EFFECTS["cubic_stiffness"](), CUBIC, SMALL)  # without its fits
    failing_fits(monkeypatch)
    found = study.climb(posterior)
    assert not found.failure
    assert found.final.values == posterior.sets["cubic_stiffness",].candidate.values
    assert found.final.held_out.error < 0.01 * found.baseline.held_out.error
    assert study.judge(posterior, found, study.unexplained(found.final)).kind == "explained"


def test_a_final_model_of_no_error_is_recorded_not_raised(monkeypatch, cubic_study):
    _, posterior = cubic_study
    study = study_of(KBI() + EFFECTS["cubic_stiffness"](), CUBIC, SMALL)
    failing_fits(monkeypatch)
    monkeypatch.setattr(Workbench, "_unmoved", lambda bench, candidate, failed: failed)
    found = study.climb(posterior)
    assert found.failure == "no finite response"
    assert found.final is found.baseline
    # However probable, an effect is not named for an error that is not known.
    assert study.claim(posterior).effects == ("cubic_stiffness",)
    verdict = study.judge(posterior, found, study.unexplained(found.final))
    assert (verdict.kind, verdict.effects) == ("undecided", ())
    (why,) = (reason for reason in verdict.reasons if reason.kind == "no error")
    assert (why.effects, why.remark) == (("cubic_stiffness",), "no finite response")


def test_the_command_adds_as_many_effects_as_python():
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    options = parser.parse_args(["investigate", "trial.csv", "--out", "found"])
    assert options.most == inspect.signature(investigate).parameters["most"].default is None


def test_a_convention_can_be_changed():
    made_up = probabilities((("cubic_stiffness",), 0.8), ((), 0.2))
    for claimed, kind in ((0.75, "effects"), (0.95, "nothing")):
        study = study_of(KBI(), JOINT, SMALL, rules=Rules(claimed=claimed))
        assert study.claim(made_up).kind == kind


def test_a_users_own_effect_competes_with_the_others():
    model = KBI() + LateSpring()
    library = {"quadratic_stiffness": SMALL["quadratic_stiffness"], LateSpring.key: LateSpring}
    study = study_of(model, JOINT | {"late_spring.stiffness": 12.0}, library, FEW)
    assert study.claim(study.weigh()).sets == (("late_spring",),)


def test_what_the_library_does_not_know_is_not_named():
    library = {"sensor_delay": EFFECTS["sensor_delay"]}
    study = study_of(KBI() + LateSpring(), JOINT | {"late_spring.stiffness": 12.0}, library, FEW)
    found = study.weigh()
    assert study.claim(found).kind == "unknown"
    assert found.none_of_these > 0.95


@pytest.mark.long
def test_a_segment_shorter_than_any_is_not_gravity():
    # Within the reach of these trials an exponential spring is a pendulum's weight, of 8 mm.
    model = KBI() + EFFECTS["quadratic_stiffness"]()
    values = JOINT | {"quadratic_stiffness.coefficient": 30.0, "quadratic_stiffness.hardening": 2.0}
    gravity = KBI() + EFFECTS["gravity"]()
    for moment, allowed in ((6.0, True), (200.0, False)):
        fitted = JOINT | {"gravity.moment": moment, "gravity.posture": 1.0}
        assert (gravity.objection(fitted) == "") is allowed
    study = study_of(
        model, values, {key: EFFECTS[key] for key in ("quadratic_stiffness", "gravity")}
    )
    found = study.climb(study.weigh())
    assert found.final.keys == ("quadratic_stiffness",)
    assert found.final.refined == ("quadratic_stiffness",)


def test_the_shortest_delay_that_a_reflex_has_is_in_doubt():
    effect = EFFECTS["stretch_reflex"]()
    model = KBI() + effect
    for delay, doubted in ((0.02, True), (0.025, False), (0.06, False)):
        values = dict(zip(model.parameter_names, model.nominal, strict=True))
        assert bool(effect.doubt(values | {"stretch_reflex.delay": delay})) is doubted


@pytest.mark.parts_fail
def test_what_cannot_be_weighed_is_said_and_nothing_is_named(monkeypatch):
    def fails(*args, **options):
        raise InputError("the angle is too coarse")

    monkeypatch.setattr(Investigation, "weigh", fails)
    found = investigate(trials(KBI() + EFFECTS["cubic_stiffness"](), CUBIC), with_widths=False)
    assert found.verdict.kind == "undecided"
    assert found.verdict.sets == ()
    assert found.failures == {"probabilities": "the angle is too coarse"}
    assert "could not be weighed: the angle is too coarse" in investigation_text(found)


# Scores


def test_each_effect_needs_a_set_of_its_own():
    assert matched(("a", "b"), [["a", "b"]]) == 1
    assert matched(("a", "b"), [["a", "b"], ["b"]]) == 2


def test_wilson_interval():
    # Newcombe 1998, Stat Med 17: 857-872, table I: 15 of 148, 0.0624 to 0.1605.
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=1e-4)
    assert wilson(0, 20)[0] == 0.0


# The command


def write(folder, trial):
    path = folder / f"{trial.name}.csv"
    rows = np.column_stack([trial.time, trial.torque, trial.angle])
    np.savetxt(
        path, rows, delimiter=",", header="time_s,torque_Nm,angle_rad", comments="", fmt="%.9g"
    )
    return path


@pytest.mark.usefixtures("few_effects", "shown_alone")
def test_the_command_finds_a_hidden_effect(tmp_path, capsys):
    values = JOINT | {"series_tendon.stiffness": 60.0}
    hidden = KBI() + EFFECTS["series_tendon"]()
    folder = tmp_path / "trials"
    folder.mkdir()
    for trial in trials(hidden, values, conditions=CONDITIONS[::3]):
        write(folder, trial)
    held = []
    for trial in trials(hidden, values, seed=9, conditions=HELD[:1]):
        held += ["--hold-out", str(write(tmp_path, replace(trial, name=f"held_{trial.name}")))]
    out = tmp_path / "out"
    code = main(["investigate", str(folder), *held, "--no-widths", "--out", str(out)])
    assert code == 0
    plain = json.loads((out / "investigation.json").read_text())
    assert plain["schema"] == 2
    assert sum(row["probability"] for row in plain["posterior"]) == pytest.approx(1.0)
    assert set(plain["discrepancy"]) >= {"size", "share", "kind"}
    assert "probabilities" in plain["timings"]
    assert {"effects", "error_fit", "error_held_out", "noise_floor"} <= set(plain["baseline"])
    assert plain["failures"] == {}
    verdict = plain["verdict"]
    assert verdict["equivalence_sets"] == [["series_tendon"]]
    errors = [plain["baseline"]["error_held_out"], *(s["error_held_out"] for s in plain["steps"])]
    assert errors[-1] < 0.2 * errors[0]
    page = (out / "report.html").read_text()
    assert verdict["sentence"][:40] in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert 'src="data:image/svg+xml' in page
    said = capsys.readouterr().out
    assert verdict["sentence"] in said
    assert len(said.strip().splitlines()) <= 40


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.csv"], "missing.csv"),
        (["."], "found none of .csv"),
    ],
)
def test_bad_input_is_one_sentence(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    assert main(["investigate", *arguments, "--out", str(out)]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "Traceback" not in error
    assert not out.exists()
