"""Verdicts on constructed findings: what may be said, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from test_investigation import HELD, JOINT, trials

from identifiability.investigation.fits.candidate import Candidate, Residual
from identifiability.investigation.search.gate import DISAGREE, ONLY_MENDS, TOO_LITTLE, Ranked
from identifiability.investigation.search.search import Ranking, Search
from identifiability.investigation.search.smallest_seen import Detectable
from identifiability.investigation.split import gather
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.unexplained.explanation import Family
from identifiability.investigation.verdict.judge import (
    EXPLAINED_SHARE,
    KINDS,
    LINEAR_SHARE,
    NAMED_SHARE,
    judge,
)
from identifiability.joint.effects import EFFECTS, RelaxationSpectrum
from identifiability.joint.model import KBI

BEFORE = 0.1
SEEN = (Detectable("gravity", "moment", 2.0, "Nm", "2 Nm"),)


@pytest.fixture(scope="module")
def split():
    return gather(trials(KBI(), JOINT), trials(KBI(), JOINT, seed=9, conditions=HELD))


def candidate(error, *keys):
    model = KBI()
    for key in keys:
        model = model + EFFECTS[key]()
    white = np.random.default_rng(1).standard_normal(500)
    left = Residual((white,), np.array([error]), 500 * error)
    values = dict(zip(model.parameter_names, model.nominal, strict=True)) | JOINT
    return Candidate(model, values, model.parameter_names, left, left)


def left_over(kind, share=0.9, noise_ratio=1.0):
    """A clear account of what is left; noise comes second, or a torque of each trial's own."""
    second = "unrepeatable" if kind == "none" else "none"
    families = [
        Family(k, k, k, evidence, {}, {}, False) for k, evidence in ((kind, 0.0), (second, -1.0))
    ]
    return Unexplained(tuple(families), 1.0, share, (), noise_ratio)


def verdict(
    split,
    keys,
    share,
    kind="static",
    *,
    rivals=None,
    refused=(),
    described=(),
    noise_ratio=1.0,
):
    """Verdict where effects remove a share of the misfit; rivals do as well as the model."""
    floor = split.noise_floor(split.held_out)
    after = BEFORE - share * (BEFORE - floor)
    base, final = candidate(BEFORE), candidate(after, *keys)
    alternatives = {
        key: tuple(
            Ranked(r, candidate(after, r), 0.0, 0.0, False, "") for r in (rivals or {}).get(key, ())
        )
        for key in keys
    }
    search = Search(
        baseline=base,
        steps=(Ranking(final, tuple(refused), ""),),
        final=final,
        ladder=tuple((key, final) for key in keys),
        alternatives=alternatives,
        without=dict.fromkeys(keys, base),
        descriptions=tuple(described),
        exact=share == 1.0,
        n_fits=1 + len(keys),
        ended="",
    )
    rest = left_over(kind, 0.0 if kind == "none" else 0.9, noise_ratio)
    return judge(split, search, rest, SEEN, EFFECTS)


def verdict_of(split, final, key, *rivals, exact=True):
    """Verdict on one effect that explains all, and its rivals."""
    base = candidate(BEFORE)
    alone = {key: base}
    search = Search(base, (), final, ((key, final),), {key: rivals}, alone, (), exact, 2, "")
    return judge(split, search, left_over("none", 0.0), SEEN, EFFECTS)


def test_nothing_is_missing_where_only_noise_is_left(split):
    found = verdict(split, (), 1.0, "none")
    assert found.kind == "nothing_missing"
    assert found.smallest_seen == SEEN
    assert "2 Nm" in " ".join(found.because)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("static", "unknown_static"),
        ("hysteresis", "unknown_memory"),
        ("memory", "unknown_memory"),
        ("drift", "measurement"),
        ("sensor", "measurement"),
        ("unrepeatable", "unrepeatable"),
    ],
)
def test_where_no_effect_is_admitted_the_kind_is_all_that_is_said(kind, expected, split):
    found = verdict(split, (), 0.0, kind)
    assert found.kind == expected
    assert found.kind in KINDS
    known = {"drift": (("sensor_drift",),), "sensor": (("sensor_delay", "sensor_lowpass"),)}
    assert found.equivalence_sets == known.get(kind, ())


def test_a_filter_that_leaves_more_than_noise_stands_for_something_else(split):
    assert verdict(split, (), 0.0, "sensor", noise_ratio=3.0).kind != "measurement"


@pytest.mark.parametrize(
    ("keys", "share", "expected", "named"),
    [
        (("coulomb_friction",), EXPLAINED_SHARE + 0.01, "explained", True),
        (("coulomb_friction",), EXPLAINED_SHARE - 0.01, "unknown_static", True),
        (("coulomb_friction",), NAMED_SHARE - 0.01, "unknown_static", False),
        # A linear relation has no shape that could be another.
        (("second_mass",), LINEAR_SHARE + 0.01, "explained", True),
        (("second_mass",), LINEAR_SHARE - 0.01, "unknown_static", True),
        (("second_mass", "coulomb_friction"), LINEAR_SHARE - 0.01, "explained", True),
        # But a drift of the recording has.
        (("sensor_drift",), EXPLAINED_SHARE + 0.01, "measurement", True),
    ],
)
def test_an_effect_explains_if_it_removes_enough(keys, share, expected, named, split):
    found = verdict(split, keys, share)
    assert (found.kind, bool(found.effects)) == (expected, named)
    assert found.share == pytest.approx(share, abs=1e-3)


def test_effects_that_do_as_well_are_named_together(split):
    found = verdict(
        split, ("cubic_stiffness",), 1.0, "none", rivals={"cubic_stiffness": ("gravity",)}
    )
    assert (found.kind, found.equivalence_sets) == ("one_of", (("cubic_stiffness", "gravity"),))
    # Of one form are a tendon and a relaxing branch: that is one explanation.
    found = verdict(split, ("maxwell_branch",), 1.0, "none")
    assert found.kind == "explained"
    assert found.equivalence_sets == (("series_tendon", "maxwell_branch"),)


def test_joint_and_instruments_that_do_as_well_are_said_to_be_one_of_both(split):
    found = verdict(
        split, ("sensor_delay",), 1.0, "none", rivals={"sensor_delay": ("second_mass",)}
    )
    assert found.kind == "one_of"
    assert "instruments" in found.sentence


@pytest.mark.parametrize("keys", [(), ("coulomb_friction",)])
@pytest.mark.parametrize(
    ("reason", "objection", "said"),
    [
        ("a delay of 15 ms would be short", "a delay of 15 ms would be short", "a delay of 15 ms"),
        (ONLY_MENDS, "", "at most a clue"),
        (TOO_LITTLE, "", "too little of what is left to be more than a clue"),
        (DISAGREE, "", "neither better nor worse"),
        # What the data do not ask for is not worth a word, possible or not.
        ("no decisive evidence", "a delay of 15 ms would be short", ""),
        ("no decisive evidence", "", ""),
    ],
)
def test_what_was_refused_for_its_values_or_its_size_is_said(keys, reason, objection, said, split):
    gain = 0.0 if reason == DISAGREE else 1.0
    rank = Ranked("stretch_reflex", candidate(0.01), 50.0, gain, False, reason, objection)
    because = " ".join(verdict(split, keys, 0.9, refused=[rank]).because)
    assert ("With stretch reflex too, E would fall to 0.01" in because) == bool(said)
    assert said in because


def test_an_effect_that_the_held_out_trials_refute_is_no_clue(split):
    rank = Ranked("stretch_reflex", candidate(0.01), 50.0, -0.5, False, DISAGREE)
    assert "stretch reflex" not in " ".join(verdict(split, (), 0.9, refused=[rank]).because)


@pytest.mark.parametrize(
    ("values", "at_bound", "said"),
    [
        ({"I": 0.005}, ("I",), "I lies at the edge of the values that it was allowed, 0.005 kg m²"),
        ({"K": 2000.0}, ("K",), "--bounds K=LOW:HIGH"),
        # That a joint has no stiffness is no bound that could be widened.
        ({"K": 1e-9, "B": 0.0}, ("K", "B"), ""),
        ({"I": 0.005}, (), ""),
    ],
)
def test_a_joint_at_the_edge_of_what_was_allowed_is_said(values, at_bound, said, split):
    final = candidate(0.001, "gravity")
    final = replace(final, values=final.values | values, at_bound=at_bound)
    because = " ".join(verdict_of(split, final, "gravity").because)
    assert ("--bounds" in because) == bool(said)
    assert said in because


@pytest.mark.parametrize(
    ("against", "stands", "does"),
    [(20.0, True, "better than"), (-9.0, True, "as well as"), (-11.0, False, "")],
)
def test_effects_that_a_description_stands_for_are_not_named(against, stands, does, split):
    left = candidate(0.001).fitted
    model = KBI() + EFFECTS["coulomb_friction"]() + RelaxationSpectrum()
    rival = Candidate(model, {}, model.parameter_names, left, left)
    described = [Ranked("relaxation_spectrum", rival, against, 0.0, stands, "")]
    keys = ("maxwell_branch", "stretch_reflex", "coulomb_friction")
    found = verdict(split, keys, 1.0, "none", described=described)
    assert found.kind == ("unknown_memory" if stands else "explained")
    if stands:
        assert not found.effects
        assert f"does {does} maxwell branch and stretch reflex." in found.sentence
        assert "misses coulomb friction" in found.sentence


def test_a_reflex_at_the_shortest_delay_is_said_to_be_in_doubt(split):
    final = candidate(1e-6, "stretch_reflex")
    rank = Ranked("gravity", candidate(1e-6, "gravity"), -99.0, 0.0, False, "")
    for delay, doubted in ((0.02, True), (0.06, False)):
        final.values["stretch_reflex.delay"] = delay
        because = verdict_of(split, final, "stretch_reflex", rank).because
        assert any("may stand for something quicker" in s for s in because) is doubted


def test_a_rival_in_doubt_is_no_equal_and_the_doubt_is_said(split):
    final = candidate(1e-6, "gravity")
    for doubt in ("", "it is too quick"):
        rank = Ranked(
            "stretch_reflex", candidate(1e-6, "stretch_reflex"), 0.0, 0.0, False, "", doubt=doubt
        )
        found = verdict_of(split, final, "gravity", rank)
        assert ("stretch_reflex" in found.equivalence_sets[0]) is not bool(doubt)
        said = "With stretch reflex in the place of gravity, it is too quick."
        assert (said in found.because) is bool(doubt)


@pytest.mark.parametrize(("refitted", "said"), [(-3.0, True), (-30.0, False)])
def test_of_a_rival_that_only_comes_near_it_is_not_said_that_it_does_as_well(split, refitted, said):
    final = candidate(1e-6, "gravity")
    rank = Ranked(
        *("cubic_stiffness", candidate(1e-6, "cubic_stiffness"), -40.0, -1.0, False, ""),
        refitted=refitted,
    )
    # The final model leaves more than noise: what comes as near is in the set either way.
    found = verdict_of(split, final, "gravity", rank, exact=False)
    assert "cubic_stiffness" in found.equivalence_sets[0]
    assert any("are predicted worse, but fitted as well" in s for s in found.because) is said


@pytest.mark.parametrize(("refitted", "member"), [(None, False), (-3.0, True), (-30.0, False)])
def test_a_rival_that_does_as_well_fitted_to_all_trials_is_named(split, refitted, member):
    final = candidate(1e-6, "gravity")
    rank = Ranked(
        *("cubic_stiffness", candidate(1e-6, "cubic_stiffness"), -40.0, -1.0, False, ""),
        refitted=refitted,
    )
    found = verdict_of(split, final, "gravity", rank)
    assert ("cubic_stiffness" in found.equivalence_sets[0]) is member
    said = "With cubic stiffness in the place of gravity the held-out trials are predicted worse"
    assert any(said in line for line in found.because) is member


def test_what_each_of_several_effects_removes_is_said(split):
    found = verdict(split, ("stretch_reflex", "series_tendon"), 0.9)
    assert any("stretch reflex 90.0 %; series tendon 0.0 %" in line for line in found.because)
    assert not any("in turn" in s for s in verdict(split, ("gravity",), 0.9).because)
