"""Verdicts on constructed findings: what may be said, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import HELD, JOINT, trials

from identifiability.investigation.findings import Findings
from identifiability.investigation.fits.bench import Workbench
from identifiability.investigation.fits.candidate import Candidate, Residual
from identifiability.investigation.rules import Rules
from identifiability.investigation.search.criterion import removed_share
from identifiability.investigation.search.equivalence import could_be
from identifiability.investigation.search.found import Found, Missing, Ranking
from identifiability.investigation.search.gate import Gate, Ranked
from identifiability.investigation.search.smallest_seen import Detectable
from identifiability.investigation.split import gather
from identifiability.investigation.unexplained.account import Unexplained
from identifiability.investigation.unexplained.explanation import Family
from identifiability.investigation.verdict.judge import KINDS, judge
from identifiability.investigation.wording.verdict import because, verdict_sentence
from identifiability.joint.effects import EFFECTS, RelaxationSpectrum
from identifiability.joint.model import KBI

BEFORE = 0.1
RULES = Rules()
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


def findings(
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
    """What is found where effects remove a share of the misfit, and rivals do as well."""
    floor = split.noise_floor(split.held_out)
    after = BEFORE - share * (BEFORE - floor)
    base, final = candidate(BEFORE), candidate(after, *keys)
    exact = share == 1.0
    tried = {
        key: tuple(Ranked(r, candidate(after, r), 0.0, 0.0) for r in (rivals or {}).get(key, ()))
        for key in keys
    }
    found = Found(
        base,
        (Ranking(final, tuple(refused), "", RULES.decisive),),
        final,
        missing_of(split, base, final, tried, exact),
        removed_share(split, base, final),
        tuple(described),
        exact,
        1 + len(keys),
        "nothing admitted",
    )
    return found, left_over(kind, 0.0 if kind == "none" else 0.9, noise_ratio)


def missing_of(split, base, final, tried, exact):
    """Records of effects of which the first removes everything that is removed."""
    gate = Gate(Workbench(split), base)
    out = []
    for key, rivals in tried.items():
        near = tuple(r.key for r in rivals if not exact and not gate.does_as_well(r, final))
        equals = could_be(key, final, rivals, near, gate, EFFECTS)
        share = None if out else removed_share(split, base, final)
        effect = final.model.effect(key)
        out.append(Missing(effect, final, base, rivals, equals, near, share or 0.0))
    return tuple(out)


def verdict(split, *args, **options):
    found, rest = findings(split, *args, **options)
    return judge(split, found, rest, SEEN, EFFECTS)


def in_words(split, *args, **options):
    """The verdict and its reasons as text."""
    found, rest = findings(split, *args, **options)
    judged = judge(split, found, rest, SEEN, EFFECTS)
    whole = Findings(
        *(split, found, None, None, None, rest, None, judged, None, EFFECTS, {}, (), 1)
    )
    return verdict_sentence(whole), because(whole)


def verdict_of(split, final, key, *rivals, exact=True):
    """Verdict on one effect that explains all, and its rivals."""
    base = candidate(BEFORE)
    missing = missing_of(split, base, final, {key: rivals}, exact)
    found = Found(base, (), final, missing, 1.0, (), exact, 2, "at the floor")
    return judge(split, found, left_over("none", 0.0), SEEN, EFFECTS)


def reason(verdict, kind):
    """The first reason of a kind, if there is one."""
    return next((r for r in verdict.reasons if r.kind == kind), None)


def test_nothing_is_missing_where_only_noise_is_left(split):
    found = verdict(split, (), 1.0, "none")
    assert found.kind == "nothing_missing"
    assert found.smallest_seen == SEEN
    assert any("2 Nm" in line for line in in_words(split, (), 1.0, "none")[1])


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
    assert found.sets == known.get(kind, ())


def test_a_filter_that_leaves_more_than_noise_stands_for_something_else(split):
    assert verdict(split, (), 0.0, "sensor", noise_ratio=3.0).kind != "measurement"


@pytest.mark.parametrize(
    ("keys", "share", "expected", "named"),
    [
        (("coulomb_friction",), RULES.explained_share + 0.01, "explained", True),
        (("coulomb_friction",), RULES.explained_share - 0.01, "unknown_static", True),
        (("coulomb_friction",), RULES.named_share - 0.01, "unknown_static", False),
        # A linear relation has no shape that could be another.
        (("second_mass",), RULES.linear_share + 0.01, "explained", True),
        (("second_mass",), RULES.linear_share - 0.01, "unknown_static", True),
        (("second_mass", "coulomb_friction"), RULES.linear_share - 0.01, "explained", True),
        # But a drift of the recording has.
        (("sensor_drift",), RULES.explained_share + 0.01, "measurement", True),
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
    assert (found.kind, found.sets) == ("one_of", (("cubic_stiffness", "gravity"),))
    # Of one form are a tendon and a relaxing branch: that is one explanation.
    found = verdict(split, ("maxwell_branch",), 1.0, "none")
    assert found.kind == "explained"
    assert found.sets == (("series_tendon", "maxwell_branch"),)


def test_joint_and_instruments_that_do_as_well_are_said_to_be_one_of_both(split):
    asked = split, ("sensor_delay",), 1.0, "none"
    rivals = {"sensor_delay": ("second_mass",)}
    assert verdict(*asked, rivals=rivals).kind == "one_of"
    assert "instruments" in in_words(*asked, rivals=rivals)[0]


@pytest.mark.parametrize("keys", [(), ("coulomb_friction",)])
@pytest.mark.parametrize(
    ("refusal", "objection", "remark", "said"),
    [
        ("objection", "a delay of 15 ms is short", "a delay of 15 ms is short", "a delay of 15 ms"),
        ("only mends", "", "only mends", "at most a clue"),
        ("too little", "", "too little", "too little of what is left to be more than a clue"),
        ("disagrees", "", "disagrees", "neither better nor worse"),
        # What the data do not ask for is not worth a word, possible or not.
        ("no evidence", "a delay of 15 ms is short", "", ""),
        ("no evidence", "", "", ""),
    ],
)
def test_what_was_refused_for_its_values_or_its_size_is_a_clue(
    keys, refusal, objection, remark, said, split
):
    gain = 0.0 if refusal == "disagrees" else 1.0
    rank = Ranked("stretch_reflex", candidate(0.01), 50.0, gain, refusal, objection)
    clue = reason(verdict(split, keys, 0.9, refused=[rank]), "clue")
    assert (clue is not None) == bool(remark)
    if clue:
        assert (clue.effects, clue.remark) == (("stretch_reflex",), remark)
        assert clue.numbers["error"] == 0.01
    words = " ".join(in_words(split, keys, 0.9, refused=[rank])[1])
    assert ("With stretch reflex too, E would fall to 0.01" in words) == bool(said)
    assert said in words


def test_an_effect_that_the_held_out_trials_refute_is_no_clue(split):
    rank = Ranked("stretch_reflex", candidate(0.01), 50.0, -0.5, "disagrees")
    assert reason(verdict(split, (), 0.9, refused=[rank]), "clue") is None


@pytest.mark.parametrize(
    ("values", "at_bound", "edge"),
    [
        ({"I": 0.005}, ("I",), ("I", 0.005)),
        ({"K": 2000.0}, ("K",), ("K", 2000.0)),
        # That a joint has no stiffness is no bound that could be widened.
        ({"K": 1e-9, "B": 0.0}, ("K", "B"), None),
        ({"I": 0.005}, (), None),
    ],
)
def test_a_joint_at_the_edge_of_what_was_allowed_is_said(values, at_bound, edge, split):
    final = candidate(0.001, "gravity")
    final = replace(final, values=final.values | values, at_bound=at_bound)
    found = reason(verdict_of(split, final, "gravity"), "edge of bounds")
    assert (found and (found.remark, found.numbers["value"])) == edge


@pytest.mark.parametrize(
    ("against", "stands", "does"),
    [(20.0, True, "better than"), (-9.0, True, "as well as"), (-11.0, False, "")],
)
def test_effects_that_a_description_stands_for_are_not_named(against, stands, does, split):
    left = candidate(0.001).fitted
    model = KBI() + EFFECTS["coulomb_friction"]() + RelaxationSpectrum()
    rival = Candidate(model, {}, model.parameter_names, left, left)
    refusal = "" if stands else "no evidence"
    described = [Ranked("relaxation_spectrum", rival, against, 0.0, refusal)]
    keys = ("maxwell_branch", "stretch_reflex", "coulomb_friction")
    found = verdict(split, keys, 1.0, "none", described=described)
    assert found.kind == ("unknown_memory" if stands else "explained")
    if stands:
        assert not found.effects
        words = in_words(split, keys, 1.0, "none", described=described)[0]
        assert f"does {does} maxwell branch and stretch reflex." in words
        assert "misses coulomb friction" in words


def test_a_reflex_at_the_shortest_delay_is_said_to_be_in_doubt(split):
    final = candidate(1e-6, "stretch_reflex")
    rank = Ranked("gravity", candidate(1e-6, "gravity"), -99.0, 0.0)
    for delay, doubted in ((0.02, True), (0.06, False)):
        final.values["stretch_reflex.delay"] = delay
        found = reason(verdict_of(split, final, "stretch_reflex", rank), "doubt")
        assert (found and found.effects) == (("stretch_reflex",) if doubted else None)


def test_a_rival_in_doubt_is_no_equal_and_the_doubt_is_said(split):
    final = candidate(1e-6, "gravity")
    for doubt in ("", "it is too quick"):
        rank = Ranked("stretch_reflex", candidate(1e-6, "stretch_reflex"), 0.0, 0.0, doubt=doubt)
        found = verdict_of(split, final, "gravity", rank)
        assert ("stretch_reflex" in found.sets[0]) is not bool(doubt)
        said = reason(found, "doubt")
        assert (said.remark if said else "") == doubt


@pytest.mark.parametrize(("refitted", "said"), [(-3.0, True), (-30.0, False)])
def test_of_a_rival_that_only_comes_near_it_is_not_said_that_it_does_as_well(split, refitted, said):
    final = candidate(1e-6, "gravity")
    rank = Ranked(
        *("cubic_stiffness", candidate(1e-6, "cubic_stiffness"), -40.0, -1.0),
        refitted=refitted,
    )
    # The final model leaves more than noise: what comes as near is in the set either way.
    found = verdict_of(split, final, "gravity", rank, exact=False)
    assert "cubic_stiffness" in found.sets[0]
    assert bool(reason(found, "only prediction worse")) is said


@pytest.mark.parametrize(("refitted", "member"), [(None, False), (-3.0, True), (-30.0, False)])
def test_a_rival_that_does_as_well_fitted_to_all_trials_is_named(split, refitted, member):
    final = candidate(1e-6, "gravity")
    rank = Ranked(
        *("cubic_stiffness", candidate(1e-6, "cubic_stiffness"), -40.0, -1.0),
        refitted=refitted,
    )
    found = verdict_of(split, final, "gravity", rank)
    assert ("cubic_stiffness" in found.sets[0]) is member
    said = reason(found, "only prediction worse")
    assert (said and said.effects) == (("gravity", "cubic_stiffness") if member else None)


def test_what_each_of_several_effects_removes_is_said(split):
    found = reason(verdict(split, ("stretch_reflex", "series_tendon"), 0.9), "removes in turn")
    assert found.numbers == pytest.approx({"stretch_reflex": 0.9, "series_tendon": 0.0}, abs=1e-6)
    assert reason(verdict(split, ("gravity",), 0.9), "removes in turn") is None
