"""Verdicts on constructed findings: what may be said, and no more."""

from dataclasses import replace
from math import log
from types import SimpleNamespace

import pytest
from constructed import candidate, left_over, probabilities
from hidden import HELD, JOINT, trials

from identifiability.investigation.findings import Findings
from identifiability.investigation.ladder.climb import found_of
from identifiability.investigation.ladder.errors import removed_share
from identifiability.investigation.ladder.found import Found, Missing, Tried
from identifiability.investigation.models import fitted_models
from identifiability.investigation.posterior.claim import claim_of
from identifiability.investigation.posterior.discrepancy import Discrepant
from identifiability.investigation.rules import Rules
from identifiability.investigation.smallest_seen.detectable import Detectable
from identifiability.investigation.split import gather
from identifiability.investigation.verdict.judge import KINDS, judge
from identifiability.investigation.wording.consequence import consequence_sentence
from identifiability.investigation.wording.next_step import next_step_sentence
from identifiability.investigation.wording.verdict import because, verdict_sentence
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI

BEFORE = 0.1
RULES = Rules()
SEEN = (Detectable("gravity", "moment", 2.0, "Nm", "2 Nm"),)
NOTHING = [((), 0.97), (("gravity",), 0.03)]
UNKNOWN = [(None, 0.97), (("gravity",), 0.03)]


def sure(*keys):
    """Rows by which effects are there."""
    return [(keys, 0.99), ((), 0.01)]


@pytest.fixture(scope="module")
def split():
    return gather(trials(KBI(), JOINT), trials(KBI(), JOINT, seed=9, conditions=HELD))


def findings(split, rows, share=1.0, kind="none", *, rivals=(), values=(), at_bound=(), **changes):
    """What is found where rows are probable and their effects remove a share of the misfit."""
    posterior = replace(probabilities(*rows), **changes)
    claim = claim_of(posterior, EFFECTS, RULES.claimed)
    floor = split.noise_floor(split.held_out)
    after = BEFORE - share * (BEFORE - floor)
    base = candidate(BEFORE)
    final = candidate(after, *claim.effects) if claim.effects else base
    final = replace(final, values=final.values | dict(values), at_bound=tuple(at_bound))
    removed = removed_share(split, base, final)
    missing = tuple(
        Missing(
            final.model.effect(key),
            final,
            base,
            tuple(rivals) if i == 0 else (),
            next((names for names in claim.sets if key in names), (key,)),
            (),
            removed if i == 0 else 0.0,
        )
        for i, key in enumerate(claim.effects)
    )
    found = Found(base, (), final, missing, removed, len(posterior.sets))
    rest = left_over(kind, 0.0 if kind == "none" else 0.9)
    judged = judge(split, posterior, claim, found, rest, SEEN, EFFECTS)
    return Findings(
        *(split, found, None, None, None, rest, None, judged, None, EFFECTS, {}, (), 1, posterior)
    )


def in_words(found):
    """The verdict and its reasons as text."""
    return " ".join([verdict_sentence(found), *because(found)])


def reason(found, kind):
    """The first reason of a kind, if there is one."""
    return next((r for r in found.verdict.reasons if r.kind == kind), None)


def test_where_most_of_the_response_is_noise_nothing_is_said_of_effects(split):
    """What the joint does may have been taken for noise, however probable the effects are."""
    for rows in (sure("gravity"), UNKNOWN):
        noisy = findings(split, rows, noise=0.9)
        assert (noisy.verdict.kind, noisy.verdict.sets, noisy.found.missing) == (
            "undecided",
            (),
            (),
        )
        (why,) = (r for r in noisy.verdict.reasons if r.kind == "mostly noise")
        assert why.numbers["share"] == pytest.approx(0.81)
        assert "--driven angle" in in_words(noisy)
        assert "gravity" not in in_words(noisy)
    # Where nothing need be missing that is said, and how large it would have to be.
    assert findings(split, NOTHING, noise=0.9).verdict.kind == "nothing_missing"
    assert findings(split, sure("gravity"), noise=0.6).verdict.sets == (("gravity",),)


def test_a_clue_beside_what_is_claimed_is_said_to_be_one(split):
    found = findings(split, [(("gravity", "coulomb_friction"), 0.8), (("gravity",), 0.2)])
    assert found.verdict.sets == (("gravity",),)
    assert found.verdict.kind == "explained"
    assert reason(found, "clue").numbers == {"coulomb_friction": pytest.approx(0.8)}
    said = verdict_sentence(found)
    assert "misses gravity" in said
    assert "It may well miss dry (Coulomb) friction (80 %) besides." in said
    assert "tell whether it misses dry (Coulomb) friction as well" in next_step_sentence(found)
    # What is at a bound of nothing is no number of many digits.
    base = found.found.baseline
    held = replace(base, values=base.values | {"B": 1e-12}, at_bound=("B",))
    said = consequence_sentence(replace(found, found=replace(found.found, baseline=held)))
    assert said.startswith("With all of that, K = ")
    assert "0 (at its bound)" in said
    assert "10⁻¹²" not in said
    # What is sure has no clue beside it.
    assert reason(findings(split, sure("gravity")), "clue") is None


def test_what_may_be_in_the_place_of_a_clue_is_said(split):
    rows = [(("coulomb_friction", "gravity"), 0.35), (("gravity", "second_mass"), 0.25)]
    found = findings(split, [*rows, (("gravity",), 0.4)])
    assert found.verdict.sets == (("gravity",),)
    assert reason(found, "clue").numbers == {"coulomb_friction": pytest.approx(0.35)}
    assert reason(found, "instead of the clue").numbers == {"second_mass": pytest.approx(0.25)}
    said = verdict_sentence(found)
    assert "may well miss dry (Coulomb) friction (35 %) or a second mass" in said
    assert "In the place of that clue there may be second mass 25 %." in in_words(found)
    assert "dry (Coulomb) friction or a second mass" in next_step_sentence(found)


def test_nothing_is_missing_where_that_is_probable(split):
    found = findings(split, NOTHING)
    assert found.verdict.kind == "nothing_missing"
    assert found.verdict.smallest_seen == SEEN
    assert "2 Nm" in in_words(found)
    assert "Nothing is missing that these data could show" in in_words(found)
    # It may be, and something else is more probable: that is said.
    found = findings(split, [((), 0.3), (("gravity",), 0.7)])
    assert found.verdict.kind == "nothing_missing"
    assert "cannot be excluded (30 %)" in in_words(found)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("static", "unknown_static"),
        ("hysteresis", "unknown_memory"),
        ("memory", "unknown_memory"),
        # It is the measurement where an effect of the recorder is named, and not before.
        ("drift", "unrepeatable"),
        ("sensor", "unknown_memory"),
        ("unrepeatable", "unrepeatable"),
    ],
)
def test_of_something_unknown_the_kind_is_all_that_is_said(kind, expected, split):
    found = findings(split, UNKNOWN, 0.0, kind)
    assert found.verdict.kind == expected
    assert found.verdict.kind in KINDS
    assert found.verdict.sets == ()
    assert "Something is missing, and no effect known here is sure to be it" in in_words(found)


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ({"memory": 0.1, "static": 0.05}, "unknown_memory"),
        # One torque for all trials is spoken of as far as there is one.
        ({"static": 0.01, "unrepeatable": 0.2}, "unrepeatable"),
        ({"varying": 0.2}, "unrepeatable"),
    ],
)
def test_where_the_rest_is_noise_the_discrepancy_has_the_kind(sizes, expected, split):
    beside = Discrepant(0.0, sizes, max(sizes.values()))
    assert findings(split, UNKNOWN, discrepancy=beside).verdict.kind == expected


def test_something_unknown_is_said_to_be_like_a_description(split):
    found = findings(split, UNKNOWN, 0.0, "static", description="stiffening_hysteresis")
    assert found.verdict.kind == "unknown_memory"
    assert "In form it comes nearest to a hysteresis that stiffens at" in in_words(found)


def test_what_comes_nearest_to_something_unknown_is_a_clue(split):
    """The error is shown to fall with it, and it is not named."""
    found = findings(
        split, UNKNOWN, 0.8, "static", unknown=("gravity",), beside_unknown={("gravity",): 0.6}
    )
    assert found.found.final.keys == ("gravity",)
    assert found.verdict.sets == ()
    assert reason(found, "clue").numbers == pytest.approx({"gravity": 0.63})
    assert "of which these are not sure: gravity 63 %. Treat them as a clue" in in_words(found)


def test_beside_what_is_sure_the_most_probable_is_a_clue(split):
    """The ladder goes on where one effect is sure and the next is not."""
    beside = {("coulomb_friction", "gravity"): 0.6, ("coulomb_friction",): 0.4}
    found = findings(
        *(split, ((None, 1.0),), 0.8, "static"),
        unknown=("coulomb_friction", "gravity"),
        beside_unknown=beside,
        sets=probabilities((("coulomb_friction", "gravity"), 1.0), (("coulomb_friction",), 0)).sets,
    )
    assert found.found.final.keys == ("coulomb_friction", "gravity")
    assert reason(found, "whatever else").effects == ("coulomb_friction",)
    assert reason(found, "clue").numbers == pytest.approx({"gravity": 0.6})
    assert found.verdict.sets == ()
    assert "coulomb_friction" not in reason(found, "clue").effects


@pytest.mark.parametrize(
    ("keys", "share", "expected"),
    [
        (("coulomb_friction",), RULES.explained_share + 0.01, "explained"),
        (("coulomb_friction",), RULES.explained_share - 0.01, "unknown_static"),
        (("sensor_drift",), RULES.explained_share + 0.01, "measurement"),
    ],
)
def test_probable_effects_that_leave_much_are_a_clue(keys, share, expected, split):
    found = findings(split, sure(*keys), share, "static")
    assert found.verdict.kind == expected
    assert bool(found.verdict.sets) == (share > RULES.explained_share)
    assert ("reat them as a clue" in in_words(found)) != bool(found.verdict.sets)
    assert found.verdict.share == pytest.approx(share, abs=1e-3)


def test_effects_that_are_as_probable_are_named_together(split):
    either = [(("cubic_stiffness",), 0.6), (("gravity",), 0.4)]
    found = findings(split, either)
    assert found.verdict.kind == "one_of"
    assert found.verdict.sets == (("cubic_stiffness", "gravity"),)
    # Of one form are a tendon and a relaxing branch: that is one explanation.
    found = findings(split, sure("maxwell_branch"))
    assert found.verdict.kind == "explained"
    assert found.verdict.sets == (("maxwell_branch", "series_tendon"),)
    assert "are of one form: torque and angle can never tell them apart" in in_words(found)


def test_joint_and_instruments_that_are_as_probable_are_said_to_be_one_of_both(split):
    found = findings(split, [(("sensor_delay",), 0.6), (("second_mass",), 0.4)])
    assert found.verdict.kind == "one_of"
    assert "instruments" in in_words(found)


def test_the_next_best_is_said_with_its_probability(split):
    other = candidate(0.01, "cubic_stiffness")
    rivals = [Tried("cubic_stiffness", other, -7.5, 0.01, 0.004)]
    found = findings(split, sure("gravity"), rivals=rivals)
    words = in_words(found)
    assert "In the place of gravity the next best is cubic stiffness" in words
    assert "less probable, and its probability is 0.4 %" in words


def test_a_named_effect_whose_equations_are_not_exact_is_said_to_leave_something(split):
    beside = Discrepant(0.0, {"static": 0.02}, 0.02)
    found = findings(split, sure("gravity"), discrepancy=beside, noise=0.1, response=0.5)
    assert reason(found, "equations not exact").numbers == pytest.approx(
        {"size": 0.01, "share": 0.02}
    )
    assert "0.01 rad that nothing names, 2 % of the response" in in_words(found)
    beside = Discrepant(0.0, {"static": 0.0}, 0.0)
    assert (
        reason(findings(split, sure("gravity"), discrepancy=beside), "equations not exact") is None
    )


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
    found = findings(split, sure("gravity"), values=values.items(), at_bound=at_bound)
    said = reason(found, "edge of bounds")
    assert (said and (said.remark, said.numbers["value"])) == edge


def test_a_reflex_at_the_shortest_delay_is_said_to_be_in_doubt(split):
    for delay, doubted in ((0.02, True), (0.06, False)):
        values = {"stretch_reflex.delay": delay}
        found = findings(split, sure("stretch_reflex"), values=values.items())
        said = reason(found, "doubt")
        assert (said and said.effects) == (("stretch_reflex",) if doubted else None)


def test_what_each_of_several_effects_removes_is_said(split):
    found = reason(findings(split, sure("stretch_reflex", "series_tendon"), 0.9), "removes in turn")
    assert found.numbers == pytest.approx({"stretch_reflex": 0.9, "series_tendon": 0.0}, abs=1e-6)
    assert reason(findings(split, sure("gravity"), 0.9), "removes in turn") is None


@pytest.mark.parametrize(
    ("rows", "kind", "said"),
    [
        (
            [(("gravity",), 0.97), ((), 0.03)],
            "explained",
            "The probability of this is 97 %; that nothing is missing, 3 %",
        ),
        (
            [(("gravity",), 0.6), ((), 0.4)],
            "nothing_missing",
            "Probabilities: nothing is missing, 40 %; gravity, 60 %; something unknown, ",
        ),
        (
            [(("gravity",), 0.6), (None, 0.4)],
            "unknown_static",
            "Probabilities: nothing is missing, less than 0.1 %; gravity, 60 %; something ",
        ),
    ],
)
def test_probabilities_are_said_first(rows, kind, said, split):
    found = findings(split, rows, kind="static")
    assert found.verdict.kind == kind
    assert bool(found.verdict.sets) == (kind == "explained")
    assert because(found)[0].startswith(said)


@pytest.mark.parametrize(
    ("left", "expected"),
    [(0.0039, ("cubic_stiffness",)), (0.0010, ("cubic_stiffness", "coulomb_friction"))],
)
def test_a_clue_that_no_error_falls_by_is_no_rung(left, expected, split):
    """Beside something unknown, which effect makes a model a little more probable is chance."""
    both = ("coulomb_friction", "cubic_stiffness")
    errors = {(): BEFORE, ("cubic_stiffness",): 0.004, both: left}
    posterior = probabilities(
        (None, 1.0),
        *((keys, 0.0) for keys in errors),
        evidence={keys: 1.0 + i for i, keys in enumerate(errors)},
    )
    fitted = {keys: candidate(error, *keys) for keys, error in errors.items()}
    sets = {k: replace(s, candidate=fitted[k]) for k, s in posterior.sets.items() if k in fitted}
    sets["coulomb_friction",] = replace(sets[()], candidate=candidate(0.09, "coulomb_friction"))
    beside = {both: 1.0}
    posterior = replace(posterior, sets=sets, unknown=both, beside_unknown=beside)
    claim = claim_of(posterior, EFFECTS, RULES.claimed)
    assert (claim.kind, claim.present) == ("unknown", both)
    bench = SimpleNamespace(split=split, rules=RULES, finish=lambda candidate: candidate)
    found = found_of(bench, fitted[()], posterior, claim, EFFECTS)
    assert tuple(m.key for m in found.missing) == expected
    verdict = judge(split, posterior, claim, found, left_over("static"), (), EFFECTS)
    (there,) = [r for r in verdict.reasons if r.kind == "whatever else"]
    assert set(there.effects) == set(expected)


@pytest.mark.parametrize(
    ("rows", "nearest"),
    [
        ([(None, 1 - 1e-6), (("gravity",), 1e-6), ((), 1e-9)], ("gravity",)),
        # Nothing is more than a known effect there, or something is named.
        ([(None, 1 - 1e-6), ((), 1e-6), (("gravity",), 1e-9)], None),
        ([(("gravity",), 0.99), (None, 0.01)], None),
    ],
)
def test_where_nothing_is_named_the_nearest_of_what_is_known_is_shown(rows, nearest, split):
    """The user sees how far it goes, and how much more probable a torque of any form is."""
    posterior = probabilities(*rows)
    fitted = {(): candidate(BEFORE), ("gravity",): candidate(0.004, "gravity")}
    sets = {k: replace(s, candidate=fitted[k]) for k, s in posterior.sets.items()}
    posterior = replace(posterior, sets=sets)
    claim = claim_of(posterior, EFFECTS, RULES.claimed)
    bench = SimpleNamespace(split=split, rules=RULES, finish=lambda candidate: candidate)
    found = found_of(bench, fitted[()], posterior, claim, EFFECTS)
    rest = left_over("static")
    judged = judge(split, posterior, claim, found, rest, (), EFFECTS)
    whole = Findings(
        *(split, found, None, None, None, rest, None, judged, None, EFFECTS, {}, (), 1, posterior)
    )
    said = reason(whole, "nearest known")
    roles = [one.role for one in fitted_models(whole)]
    if nearest is None:
        assert (found.nearest, said) == (None, None)
        assert "nearest" not in roles
        return
    assert found.final is found.baseline
    assert judged.sets == ()
    assert found.nearest.keys == said.effects == nearest
    assert roles == ["baseline", "nearest"]
    assert said.numbers == pytest.approx(
        {"behind": log(1e6), "after": 0.004, "held_out_after": 0.004}, rel=1e-5
    )
    words = in_words(whole)
    assert "Of what is known gravity comes nearest: with it E is 0.004 on the fitted" in words
    assert "10⁶ times more probable, so that nothing is named" in words
    assert "Do not quote K" in consequence_sentence(whole)
