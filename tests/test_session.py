"""A session goes back and forth, compares, fits nothing twice, and is opened where it was left."""

import numpy as np
import pytest
from hidden import HELD, JOINT, trials
from IPython.core.interactiveshell import InteractiveShell

from identifiability.errors import InputError
from identifiability.investigation.posterior.claim import Claim
from identifiability.investigation.posterior.evidence import Evaluator
from identifiability.investigation.wording.describe import describe
from identifiability.joint.effects import EFFECTS, CubicStiffness
from identifiability.joint.model import KBI
from identifiability.joint.response import simulate
from identifiability.workbench.notebook import show_in_notebooks
from identifiability.workbench.session import Session
from identifiability.workbench.show import page

KEYS = ("series_tendon", "cubic_stiffness", "sensor_delay", "gravity")
LIBRARY = {key: EFFECTS[key] for key in KEYS}
VALUES = JOINT | {"cubic_stiffness.coefficient": 150.0, "cubic_stiffness.centre": 0.0}


def begun(driven="torque", **how):
    model = KBI() + EFFECTS["cubic_stiffness"]()
    values = dict(zip(model.parameter_names, model.nominal, strict=True)) | VALUES
    fitted = trials(model, values, driven=driven)
    held_out = trials(model, values, seed=2, conditions=HELD, driven=driven)
    return Session(fitted, held_out, library=LIBRARY, **how)


@pytest.fixture(scope="module", params=["torque", "angle"])
def session(request):
    """One that has ranked everything, and added what is missing."""
    one = begun(request.param)
    list(one.rank())
    one.add("cubic_stiffness")
    return one


@pytest.fixture
def counted(monkeypatch):
    """Models that are fitted by the one likelihood, as they are."""
    asked, evaluate = [], Evaluator.evaluate

    def counting(self, model, *args, **how):
        asked.append(model.effect_keys)
        return evaluate(self, model, *args, **how)

    monkeypatch.setattr(Evaluator, "evaluate", counting)
    return asked


def test_what_is_missing_brings_most(session):
    session.undo()
    assert session.ranking[0].key == "cubic_stiffness"
    gains = [one.gained for one in session.ranking]
    assert gains == sorted(gains, reverse=True)
    assert gains[0] > 10 + gains[1]
    before = session.now
    session.redo()
    assert session.now.added == ("cubic_stiffness",)
    assert session.now.candidate.held_out.error < 0.01 * before.candidate.held_out.error
    assert session.now.values["cubic_stiffness.coefficient"] == pytest.approx(
        150.0, abs=4 * session.now.sds["cubic_stiffness.coefficient"]
    )


def test_ranking_yields_as_it_lands_and_can_be_stopped(counted):
    one = begun()
    steps = one.rank()
    first = next(steps)
    steps.close()
    assert first.key == KEYS[0]
    assert ("sensor_delay",) not in counted
    assert ("gravity",) not in counted
    assert {r.key for r in one.ranking} <= set(KEYS[:2])
    (only,) = one.rank("gravity")
    assert only.key == "gravity"
    assert ("sensor_delay",) not in counted


def test_it_goes_back_and_forth_and_fits_nothing_twice(counted):
    one = begun()
    one.add("cubic_stiffness")
    with_delay = one.add("sensor_delay")
    n = len(counted)
    assert one.undo().added == ("cubic_stiffness",)
    assert one.undo().added == ()
    with pytest.raises(InputError, match="nothing to undo"):
        one.undo()
    assert one.redo().added == ("cubic_stiffness",)
    assert one.redo() is with_delay
    with pytest.raises(InputError, match="nothing to redo"):
        one.redo()
    assert one.drop("sensor_delay").added == ("cubic_stiffness",)
    assert one.place == 3
    assert one.add("sensor_delay").log_evidence == with_delay.log_evidence
    assert len(counted) == n
    # What was undone is no more once another way is taken.
    one.undo()
    one.undo()
    assert len(one.history) == 5
    one.drop("cubic_stiffness", "sensor_delay")
    assert [attempt.added for attempt in one.history][-1] == ()
    assert len(one.history) == 4


@pytest.mark.parametrize(
    ("what", "sentence"),
    [
        (lambda s: s.add("cubic"), "'cubic' is no effect of the library: the effects are"),
        (lambda s: s.add("cubic_stiffness"), "cubic_stiffness is part of the model already"),
        (lambda s: s.drop("gravity"), "what can be dropped is cubic_stiffness"),
        (lambda s: next(s.rank("tendon")), "'tendon' is no effect"),
    ],
)
def test_what_cannot_be_done_leaves_it_as_it_was(session, what, sentence):
    before = repr(session)
    with pytest.raises(InputError, match=sentence):
        what(session)
    assert repr(session) == before


def test_two_models_side_by_side(session):
    right = session.now
    wrong = session.undo()
    session.redo()
    one, other = session.compare(right, wrong), session.compare(wrong, right)
    assert one.nats == -other.nats > 100
    assert one.probability == pytest.approx(1 - other.probability)
    assert "is more probable than K, B, I: more than 99.9 %" in repr(one)
    assert repr(one) == repr(other)
    # The curves are those of the two models' own simulations.
    rivals = one.rivals
    number, sample = rivals.most
    ready = rivals.trials[number]
    curves = [
        simulate(a.model, a.model.vector(a.values), ready.drive)[ready.first : ready.last]
        for a in (right, wrong)
    ]
    np.testing.assert_allclose(
        np.diff(rivals.by_trial[number]), np.diff(curves[0] - curves[1]), atol=1e-6
    )
    assert np.abs(rivals.by_trial[number][sample]) == np.abs(rivals.by_trial[number]).max()
    assert one.experiment().pair == ("cubic_stiffness", "K, B, I")


def test_it_shows_itself(session):
    session.pin()
    for shown, says in [
        (session, "noise alone"),
        (session.now, "cubic stiffness: coefficient"),
        (session.compare(session.history[0]), "data:image/png"),
        (session.ranking, "nothing was ranked yet"),
    ]:
        page = shown._repr_html_()
        assert says in page
        assert page.count("<tr>") == page.count("</tr>")
    session.undo()
    assert "sensor delay" in session.ranking._repr_html_()
    session.redo()


@pytest.mark.parametrize("session", ["torque"], indirect=True)
def test_what_it_finds_shows_itself_where_ipython_runs(session, monkeypatch):
    shell, shown = InteractiveShell(), []
    monkeypatch.setattr("IPython.display.display", shown.append)
    monkeypatch.setattr("IPython.get_ipython", lambda: shell)
    show_in_notebooks()
    probabilities, first = session.probabilities(), session.history[0]
    for result, says, drawn in [
        (session.now, "cubic stiffness: coefficient", True),
        (session.compare(first), "is more probable than K, B, I", True),
        (session.compare(first).experiment(), "Nm", False),
        (session.locate(), "noise", True),
        (session.constancy(), "K", True),
        (session.unexplained(), "left", True),
        (probabilities, "That cubic stiffness is missing has", False),
        (session.claim(probabilities), "Missing is cubic stiffness, with a probability", False),
    ]:
        shown.clear()
        assert shell.display_formatter.format(result) == ({}, {})
        assert says in shown[0].data, result
        assert [one.data[1:4] for one in shown[1:]] == [b"PNG"] * drawn, result


@pytest.mark.parametrize("session", ["angle"], indirect=True)
def test_the_widths_of_its_model_show_themselves(session):
    found = session.widths()
    assert found.names == session.now.candidate.free
    shown = page(found)
    assert all(row.name.replace(".", ": ").replace("_", " ") in shown for row in found.rows)
    assert "ellipse holds" in shown
    assert "data:image/png" in shown


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        (
            Claim("effects", ("a_b",), (("a_b", "c"), ("d",)), 0.97),
            "Missing is a b or c; and d, with a probability of 97 %.",
        ),
        (
            Claim("nothing", (), (), 0.8),
            "Nothing is named: that nothing is missing has a probability of 80 %.",
        ),
        (
            Claim("unknown", ("a",), (), 0.9, present=("a",)),
            "Nothing is named: that it is no effect of the library has a probability of 90 %. "
            "Beside it, there is a.",
        ),
        (
            Claim("undecided", ("a",), (), 0.4),
            "Nothing is named: the most probable set has a probability of 40 % only.",
        ),
    ],
)
def test_what_can_be_named_is_said(claim, words):
    assert describe(claim) == (words,)


def test_the_model_that_is_most_probable_of_those_tried(session):
    found = session.probabilities()
    assert found.rows[0].effects == ("cubic_stiffness",)
    assert found.of(["cubic_stiffness"]) > 0.95


def test_it_is_opened_where_it_was_left(tmp_path, counted):
    left = begun(folder=tmp_path / "kept")
    list(left.rank("cubic_stiffness", "series_tendon"))
    left.add("cubic_stiffness")
    left.pin()
    left.add("sensor_delay")
    left.undo()
    del counted[:]
    opened = Session.open(tmp_path / "kept", library=LIBRARY)
    assert counted == []
    assert repr(opened) == repr(left)
    assert [a.added for a in opened.pinned] == [("cubic_stiffness",)]
    assert opened.redo().log_evidence == pytest.approx(left.redo().log_evidence)
    with pytest.raises(InputError, match="holds a session already"):
        begun(folder=tmp_path / "kept")


def test_one_without_a_folder_is_saved(tmp_path, counted):
    left = begun()
    left.add("sensor_delay")
    left.save(tmp_path / "saved")
    del counted[:]
    opened = Session.open(tmp_path / "saved", library=LIBRARY)
    assert counted == []
    assert repr(opened) == repr(left)


def test_what_is_no_session_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="holds no session that can be read"):
        Session.open(tmp_path)
    begun(folder=tmp_path / "kept").add("sensor_delay")
    few = {"cubic_stiffness": CubicStiffness}
    with pytest.raises(InputError, match=r"effects that the library has not \(sensor_delay\)"):
        Session.open(tmp_path / "kept", library=few)
    (tmp_path / "kept" / "session.json").write_text("{")
    with pytest.raises(InputError, match="holds no session that can be read"):
        Session.open(tmp_path / "kept", library=LIBRARY)
