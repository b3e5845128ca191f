"""The investigation: evidence, candidates, search, verdict, on data of an independent simulator."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hidden import HELD, JOINT, TIME, record_that_grows, trials

from identifiability.benchmark.cases import hidden_cases
from identifiability.benchmark.score import matched, outcome_of, wilson
from identifiability.cli.main import main
from identifiability.errors import InputError
from identifiability.inference.starts import starting_values
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import NOTHING, Candidate, Residual
from identifiability.investigation.rules import Rules
from identifiability.investigation.search.equivalence import comes_near, could_be
from identifiability.investigation.search.fitter import Fitter
from identifiability.investigation.search.gate import Gate, Ranked
from identifiability.investigation.search.ranking import Ranker
from identifiability.investigation.search.rivals import Rivals
from identifiability.investigation.session import Investigation
from identifiability.investigation.split import Split, gather, owners
from identifiability.joint.effects import (
    EFFECTS,
    LooseCoupling,
    MaxwellBranch,
    RelaxationSpectrum,
    SecondMass,
    ShortRangeStiffness,
    StiffeningHysteresis,
)
from identifiability.joint.effects.base import Effect
from identifiability.joint.model import KBI
from identifiability.joint.parameters import Parameter
from identifiability.joint.response import simulate
from identifiability.measurement.perturbations import SampledTorque
from identifiability.measurement.trials import Trial
from identifiability.progress import silent


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
    t = np.arange(1000) / 1000
    double = Trial(
        t, np.tile(first.torque, 2), np.tile(first.angle, 2), name="long", condition="pulse"
    )
    split = gather([double])
    assert split.how_held_out == "the second half of the record"
    assert split.fitted[0].last == split.held_out[0].first == 500


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
    joint = JOINT | {"B": 2.5}  # what was before fades by exp(-12.5) in a second
    theta = model.vector(joint)
    angle = simulate(model, theta, SampledTorque(u).drive(t)) + 1e-4 * rng.standard_normal(t.size)
    record = Trial(t, u, angle, name="long")
    values = joint | {"K": 33.0}
    whole = Workbench(gather([record])).residual(model, values, gather([record]).fitted)
    monkeypatch.setattr("identifiability.investigation.split._LONGEST", 800)
    split = gather([record])
    bench = Workbench(split)
    problem = bench.problem(model, split.fitted)
    assert len(problem.observations) > 2
    assert set(owners(problem.observations)) == {0}
    cut = bench.residual(model, values, split.fitted)
    # A second before each piece is enough for the joint to forget how it was started.
    np.testing.assert_allclose(cut.by_trial[0], whole.by_trial[0], atol=2e-4 * np.ptp(angle))


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


# Search: a small library, to compile little


def ranker(bench, first, library=EFFECTS):
    return Ranker(bench, library, Fitter(bench, first), Gate(bench, first), silent)


SMALL = {k: EFFECTS[k] for k in ("cubic_stiffness", "quadratic_stiffness", "sensor_delay")}


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_is_added_where_nothing_is_missing(seed):
    study = Investigation(
        trials(KBI(), JOINT, seed=seed),
        trials(KBI(), JOINT, seed=seed + 100, conditions=HELD),
        library=SMALL,
    )
    found = study.search()
    assert found.final.keys == ()
    assert max(r.evidence for r in found.rankings[0].ranked) < study.split.rules.decisive


def test_the_missing_effect_is_found_and_the_error_falls_to_the_floor():
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    study = Investigation(
        trials(model, values), trials(model, values, seed=9, conditions=HELD), library=SMALL
    )
    found = study.search()
    assert found.final.keys == ("cubic_stiffness",)
    assert found.final.values["cubic_stiffness.coefficient"] == pytest.approx(120.0, rel=0.05)
    assert found.final.held_out.error < 1.3e-6
    assert found.baseline.held_out.error > 20e-6


@pytest.mark.parametrize(
    ("known", "plain_error", "chosen"),
    [(False, 5e-4, "plain"), (False, 5e-3, "rich"), (True, 5e-4, "rich")],
)
def test_the_plainest_is_taken_only_where_all_may_be_error_of_measurement(
    known, plain_error, chosen
):
    split = gather(trials(KBI(), JOINT))
    bench = Workbench(split if known else split.without_leads())
    searcher = ranker(bench, None)

    def admitted(key, error, n_free):
        residual = Residual((), np.array([error]), 1.0)
        found = Candidate(KBI(), {}, ("p",) * n_free, residual, residual)
        return Ranked(key, found, 100.0, 1.0)

    assert searcher.bench.split.has_noise is known
    best_first = [admitted("rich", 4e-4, 5), admitted("plain", plain_error, 4)]
    assert searcher._choose(best_first) == chosen
    assert searcher._choose([]) == ""


TWO_RELAX = {
    "relaxation_spectrum.stiffness_1": 40.0,
    "relaxation_spectrum.time_constant_1": 0.008,
    "relaxation_spectrum.stiffness_3": 30.0,
    "relaxation_spectrum.time_constant_3": 0.2,
}
WOBBLES = {
    "maxwell_branch.stiffness": 40.0,
    "maxwell_branch.time_constant": 0.03,
    "second_mass.inertia": 0.05,
    "second_mass.frequency": 8.0,
}
TURNS = {f"stiffening_hysteresis.{k}": v for k, v in {"stiffness": 30.0, "reversal": -3.0}.items()}
PLAYS = {
    "loose_coupling.inertia": 0.08,
    "loose_coupling.frequency": 15.0,
    "loose_coupling.gap": 0.01,
    "loose_coupling.own_stiffness": 200.0,
    "K": 3.0,
    "I": 0.02,
}
YIELDS = {"short_range_stiffness.stiffness": 30.0}


@pytest.mark.parametrize(
    ("true", "values", "believed", "stands"),
    [
        ((RelaxationSpectrum,), TWO_RELAX, ("maxwell_branch", "second_mass"), True),
        ((MaxwellBranch, SecondMass), WOBBLES, ("maxwell_branch", "second_mass"), False),
        ((StiffeningHysteresis,), TURNS, ("short_range_stiffness",), True),
        ((ShortRangeStiffness,), YIELDS, ("short_range_stiffness",), False),
        ((LooseCoupling,), PLAYS, ("second_mass",), True),
        # One effect with memory is simpler than any description.
        ((MaxwellBranch,), WOBBLES, ("maxwell_branch",), False),
    ],
)
def test_descriptions_unmask_the_effects_that_stand_for_them(true, values, believed, stands):
    model = sum((kind() for kind in true), KBI())
    full = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT
    full |= {name: value for name, value in values.items() if name in full}
    few = [("pulse", 8), ("pulse", -16), ("step", -6)]
    study = Investigation(
        trials(model, full, conditions=few), trials(model, full, seed=9, conditions=HELD[1:])
    )
    searcher = ranker(study.bench, study.baseline)
    model = sum((EFFECTS[key]() for key in believed), KBI())
    final = searcher.fitter.fit(model, study.baseline, refined=believed)
    rivals = Rivals(searcher, study.baseline)
    exact = searcher.gate.leaves_noise(final)
    tried = [r for r in rivals.descriptions(final, exact) if r.passes]
    best = max(tried, key=lambda r: r.evidence, default=None)
    assert (best and best.key) == (true[0].key if stands else None)


def test_where_the_model_without_an_effect_has_no_fit_its_rivals_are_fitted_all_the_same(
    monkeypatch,
):
    model = KBI() + EFFECTS["cubic_stiffness"]()
    data = trials(
        model, JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    )
    study = Investigation(data, library=SMALL)
    first, final = study.baseline, study.fit(model + EFFECTS["sensor_delay"]())
    library = {key: EFFECTS[key] for key in ("cubic_stiffness", "series_tendon")}
    searcher = ranker(study.bench, first, library)
    searcher.rank(first)  # what was tried alone may stand in another's place
    whole = Workbench.fit

    def failing(bench, model, starts, **options):
        found = whole(bench, model, starts, **options)
        if model.effect_keys != ("sensor_delay",):
            return found
        return replace(found, values={}, failure="no finite response")

    monkeypatch.setattr(Workbench, "fit", failing)
    rivals = Rivals(searcher, first).in_place_of("cubic_stiffness", final)
    assert rivals
    assert not any(r.candidate.failure for r in rivals)


def test_a_ranking_does_not_depend_on_what_was_asked_before():
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    study = Investigation(
        trials(model, values), trials(model, values, seed=9, conditions=HELD), library=SMALL
    )
    larger = study.fit(model)

    def answers():
        return [
            (r.key, r.evidence, r.refusal, dict(r.candidate.values))
            for current in (study.baseline, larger)
            for r in study.rank(current).ranked
        ]

    first = answers()
    study.search()
    assert answers() == first
    # The further effects removed nothing of what the first one did: by itself that may be said.
    assert {r[2] for r in first[len(SMALL) :]} <= {"no evidence", "disagrees", "only mends"}


def test_a_convention_can_be_changed():
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    hidden = trials(model, values), trials(model, values, seed=9, conditions=HELD)
    library = {"cubic_stiffness": EFFECTS["cubic_stiffness"]}
    for decisive, keys in ((10.0, ("cubic_stiffness",)), (1e6, ())):
        found = Investigation(*hidden, library=library, rules=Rules(decisive=decisive)).search()
        assert found.final.keys == keys


def test_no_search_below_an_error_of_measurement():
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = JOINT | {"cubic_stiffness.coefficient": 120.0, "cubic_stiffness.centre": 0.0}
    study = Investigation([record_that_grows(model, values)], library=SMALL)
    found = study.search()
    assert found.final.keys == ("cubic_stiffness",)
    assert len(found.rankings) == 1
    assert found.ended == "at the floor"


def test_a_users_own_effect_competes_with_the_others():
    model = KBI() + LateSpring()
    values = JOINT | {"late_spring.stiffness": 12.0}
    study = Investigation(
        trials(model, values),
        trials(model, values, seed=9, conditions=HELD),
        library=SMALL | {LateSpring.key: LateSpring},
    )
    found = study.search()
    assert found.final.keys == ("late_spring",)


def test_what_the_library_does_not_know_is_not_named():
    model = KBI() + LateSpring()
    values = JOINT | {"late_spring.stiffness": 12.0}
    study = Investigation(
        trials(model, values),
        trials(model, values, seed=9, conditions=HELD),
        library={"sensor_delay": EFFECTS["sensor_delay"]},
    )
    found = study.search()
    assert found.final.held_out.error > 3 * study.split.noise_floor(study.split.held_out)


def test_a_segment_shorter_than_any_is_not_gravity():
    # Within the reach of these trials an exponential spring is a pendulum's weight, of 8 mm.
    model = KBI() + EFFECTS["quadratic_stiffness"]()
    values = JOINT | {"quadratic_stiffness.coefficient": 30.0, "quadratic_stiffness.hardening": 2.0}
    gravity = KBI() + EFFECTS["gravity"]()
    for moment, allowed in ((6.0, True), (200.0, False)):
        fitted = JOINT | {"gravity.moment": moment, "gravity.posture": 1.0}
        assert (gravity.objection(fitted) == "") is allowed
    library = {key: EFFECTS[key] for key in ("quadratic_stiffness", "gravity")}
    study = Investigation(
        trials(model, values), trials(model, values, seed=9, conditions=HELD), library=library
    )
    found = study.search()
    assert found.final.keys == ("quadratic_stiffness",)
    assert found.final.refined == ("quadratic_stiffness",)
    weight = next(r for r in found.rankings[0].ranked if r.key == "gravity")
    assert weight.refusal == "objection"
    assert weight.objection == weight.candidate.model.objection(weight.candidate.values)
    # Of an imposed motion the inertia may be unknown, and nothing is held against it.
    angle_driven = [replace(t, driven="angle") for t in trials(model, values)]
    assert Workbench(gather(angle_driven)).objection(weight.candidate) == ""


@pytest.mark.parametrize(
    ("current", "floor", "mends"),
    [
        (0.0015, 5e-4, True),  # more than noise is left with it
        (0.0015, 9e-4, False),  # only noise is left with it, and clearly more without it
        (0.0010, 9e-4, True),  # hardly more was left without it
        (0.05, 5e-4, False),  # it removes about as much as those before it
    ],
)
def test_a_further_effect_that_removes_little_may_only_mend_the_others(
    current, floor, mends, monkeypatch
):
    # The floor is known within 5 %: half as much again is clearly above it, a tenth is not.
    monkeypatch.setattr(Split, "noise_floor", lambda self, part=None: floor)
    monkeypatch.setattr(Split, "floor_uncertainty", lambda self: 0.05)

    def candidate(error, *keys):
        model = KBI()
        for key in keys:
            model = model + EFFECTS[key]()
        return Candidate(model, {}, (), Residual((), np.array([error]), 1.0), NOTHING)

    gate = Gate(Workbench(gather(trials(KBI(), JOINT))), candidate(0.1))
    before, larger = candidate(current, "gravity"), candidate(9e-4, "gravity", "second_mass")
    assert gate.only_mends(larger, before) is mends
    # The first effect has none before it that it could mend.
    assert not gate.only_mends(before, gate.first)


@pytest.mark.parametrize(
    ("exact", "rival_error", "objection", "member"),
    [
        (False, 0.0105, "", True),  # removes all but 0.6 % of what the effect removes
        (False, 0.0115, "", False),  # all but 1.7 %
        (True, 0.0105, "", False),  # the final model leaves only noise: no excuse
        (False, 0.0105, "no segment is so short", False),
    ],
)
def test_inexact_equations_exclude_no_rival_that_comes_near(exact, rival_error, objection, member):
    rng = np.random.default_rng(1)

    def candidate(error):
        residual = rng.standard_normal(500)
        return Candidate(
            KBI(), JOINT, (), Residual((residual,), np.array([error]), 500 * error), NOTHING
        )

    rival = Ranked("cubic_stiffness", candidate(rival_error), -100.0, 0.0, "no evidence", objection)
    before, final = candidate(0.1), candidate(0.01)
    gate = Gate(Workbench(gather(trials(KBI(), JOINT))), before)
    form = gate.rules.form
    near = () if exact or not comes_near(final, before, rival, form) else (rival.key,)
    assert (rival.key in could_be("gravity", final, (rival,), near, gate, EFFECTS)) is member


@pytest.fixture(scope="module")
def tendon():
    """A search in which a tendon is missing, and the models that are rivals to it."""
    model = KBI() + EFFECTS["series_tendon"]()
    values = JOINT | {"series_tendon.stiffness": 60.0}
    hidden = trials(model, values), trials(model, values, seed=9, conditions=HELD)
    bench = Workbench(gather(*hidden))
    base = bench.fit(KBI(), [JOINT])
    searcher = ranker(bench, base)
    keys = ("series_tendon", "maxwell_branch", "gravity")
    fitted = {key: searcher.fitter.fit(KBI() + EFFECTS[key](), base) for key in keys}
    return Rivals(searcher, base), fitted


@pytest.mark.parametrize(
    ("key", "fits", "equal"),
    [
        ("maxwell_branch", True, True),  # of the same form: fitted to all trials it is equal
        ("gravity", True, False),  # cannot fit these trials, held out or not
        ("gravity", False, None),  # its fit speaks against it already
    ],
)
def test_a_rival_that_only_predicts_worse_is_judged_with_all_trials(tendon, key, fits, equal):
    rivals, fitted = tendon
    final, rival = fitted["series_tendon"], fitted[key]
    far = replace(final.held_out, weighted=9 * final.held_out.weighted)
    left = final.fitted if fits else rival.fitted
    rival = replace(rival, fitted=left, held_out=far)
    ranked = Ranked(key, rival, -100.0, -np.log(9), "disagrees")
    refitted = rivals.with_all_trials(ranked, final).refitted
    gate = rivals.ranker.gate
    assert gate.only_held_out_objects(ranked, final) is (equal is not None)
    assert (None if refitted is None else refitted > -gate.rules.decisive) is equal


def test_the_shortest_delay_that_a_reflex_has_is_in_doubt():
    model = KBI() + EFFECTS["stretch_reflex"]()
    left = Residual((), np.array([0.1]), 1.0)
    for delay, doubted in ((0.02, True), (0.025, False), (0.06, False)):
        values = dict(zip(model.parameter_names, model.nominal, strict=True))
        values["stretch_reflex.delay"] = delay
        found = Candidate(model, values, model.parameter_names, left, left)
        torque_driven = trials(KBI(), JOINT)
        bench = Workbench(gather(torque_driven))
        assert bool(bench.doubt(found, "stretch_reflex")) is doubted
        # Of an imposed motion the delay may lie anywhere on a ridge.
        imposed = Workbench(gather([replace(t, driven="angle") for t in torque_driven]))
        assert imposed.doubt(found, "stretch_reflex") == ""


def test_what_is_in_doubt_is_taken_only_where_nothing_else_is_admitted():
    searcher = ranker(Workbench(gather(trials(KBI(), JOINT))), None)
    left = Residual((), np.array([0.1]), 1.0)
    quick, other = (
        Ranked(key, Candidate(KBI(), {}, (), left, left), evidence, 1.0, doubt=doubt)
        for key, evidence, doubt in (("stretch_reflex", 200.0, "too quick"), ("gravity", 50.0, ""))
    )
    assert searcher._choose([quick, other]) == "gravity"
    assert searcher._choose([quick]) == "stretch_reflex"


# Scores


@pytest.mark.parametrize(
    ("kind", "truth", "verdict", "named", "expected"),
    [
        ("known", ("gravity",), "explained", [["gravity"]], "right"),
        (
            "known",
            ("gravity",),
            "one_of",
            [["quadratic_stiffness", "gravity"]],
            "right among others",
        ),
        ("known", ("gravity", "second_mass"), "explained", [["gravity"]], "partly"),
        ("known", ("gravity",), "explained", [["gravity"], ["second_mass"]], "wrong"),
        ("known", ("gravity",), "unknown_static", [["gravity"]], "abstained"),
        ("none", (), "nothing_missing", [], "right"),
        ("none", (), "explained", [["gravity"]], "wrong"),
        ("unknown", (), "unknown_memory", [], "right"),
        ("unknown", (), "explained", [["gravity"]], "wrong"),
        ("unknown", (), "nothing_missing", [], "abstained"),
        ("unrepeatable", (), "unrepeatable", [], "right"),
    ],
)
def test_outcomes(kind, truth, verdict, named, expected):
    assert outcome_of(kind, truth, verdict, named) == expected


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


@pytest.mark.usefixtures("few_effects")
def test_the_command_finds_a_hidden_effect(tmp_path, capsys):
    spec = next(s for s in hidden_cases("quick", 1) if s.kind == "known")
    case = spec.build()
    folder = tmp_path / "trials"
    folder.mkdir()
    for trial in case.fit:
        write(folder, trial)
    held = []
    for trial in case.held_out:
        held += ["--hold-out", str(write(tmp_path, replace(trial, name=f"held_{trial.name}")))]
    out = tmp_path / "out"
    code = main(["investigate", str(folder), *held, "--no-widths", "--out", str(out)])
    assert code == 0
    plain = json.loads((out / "investigation.json").read_text())
    assert plain["schema"] == 2
    assert sum(row["probability"] for row in plain["posterior"]) == pytest.approx(1.0)
    assert set(plain["discrepancy"]) >= {"size", "share", "kind"}
    assert "search" in plain["timings"]
    assert {"effects", "error_fit", "error_held_out", "noise_floor"} <= set(plain["baseline"])
    assert plain["failures"] == {}
    verdict = plain["verdict"]
    assert outcome_of(case.kind, case.truth, verdict["kind"], verdict["equivalence_sets"]) in (
        "right",
        "right among others",
    )
    errors = [plain["baseline"]["error_held_out"], *(s["error_held_out"] for s in plain["steps"])]
    assert errors[-1] < 0.2 * errors[0]
    page = (out / "report.html").read_text()
    assert verdict["sentence"][:40] in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert 'src="data:image/png' in page
    assert verdict["sentence"] in capsys.readouterr().out


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
