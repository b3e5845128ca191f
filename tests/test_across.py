"""Several records of one joint agree in what is the same, and differ where it is not."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import CONDITIONS, TIME, trials

from identifiability.cli.main import main
from identifiability.errors import InputError
from identifiability.investigation.across import agreement
from identifiability.investigation.across import weighed as weighed_across
from identifiability.investigation.across.agreement import across
from identifiability.investigation.across.weighed import weigh_across
from identifiability.investigation.session import Investigation
from identifiability.investigation.wording.across import across_sentences
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.plots.across import across_figure
from identifiability.report.across import across_page, across_record, across_text

KEY = "cubic_stiffness"
MODEL = KBI() + EFFECTS[KEY]()
SAME = {"I": 0.1, f"{KEY}.coefficient": 150.0}
OWN = {"rest": {"K": 20.0, "B": 0.8}, "half": {"K": 40.0, "B": 1.5}, "full": {"K": 70.0, "B": 2.5}}


def records_of(driven, seed=0, model=MODEL, same=SAME, **other):
    """Records at three levels of activation; in the last one some parameters may be others."""
    found = {}
    plain = {f"{KEY}.centre": 0.0} if model is MODEL else {}
    for i, (name, own) in enumerate(OWN.items()):
        values = same | plain | own | (other if name == "full" else {})
        some = trials(model, values, seed=10 * seed + i, noise=3e-3, driven=driven)
        found[name] = Investigation(some, library={KEY: EFFECTS[KEY]})
    return found


@pytest.fixture(scope="module", params=["torque", "angle"])
def agreeing(request):
    return across(records_of(request.param), MODEL)


def test_what_is_the_same_is_told_by_all(agreeing):
    rows = {one.name: one for one in agreeing.parameters}
    assert [record.name for record in agreeing.records] == list(OWN)
    assert not agreeing.differing
    assert agreeing.p > 0.01
    assert agreeing.degrees == 4
    for name, value in SAME.items():
        assert rows[name].shared
        assert abs(rows[name].value - value) < 4 * rows[name].sd
        # No record alone tells it as well.
        assert rows[name].sd < min(record.sds[name] for record in agreeing.records)
    assert not rows["K"].shared
    assert not rows["B"].shared
    for record in agreeing.records:
        assert abs(record.values["K"] - OWN[record.name]["K"]) < 4 * record.sds["K"]
        assert record.log_evidence > 10


def test_a_record_is_predicted_best_by_its_own_fit(agreeing):
    for record in agreeing.records:
        assert max(record.vaf, key=record.vaf.get) == record.name
        assert record.vaf[record.name] > 99.9
        assert min(record.vaf.values()) < 99.0  # K is another there


@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_a_joint_that_is_not_the_same_is_told(driven):
    found = across(records_of(driven, seed=1, I=0.13), MODEL)
    assert [one.name for one in found.differing] == ["I"]
    assert found.p < 1e-6
    assert "differ in what should be the same: I (" in across_sentences(found)[0]
    again = across(records_of(driven, seed=1, I=0.13), MODEL, may_differ=("K", "B", "I"))
    assert not again.differing


@pytest.mark.long
@pytest.mark.parametrize("driven", ["torque", "angle"])
def test_chance_makes_no_more_differences_than_it_says(driven):
    """Of records that differ by noise alone p is uniform, or higher.

    Where the angle is imposed the noise is taken for larger: motion between samples is not known.
    """
    chances = np.sort([across(records_of(driven, seed=100 + i), MODEL).p for i in range(20)])
    # One-sided distance of Kolmogorov and Smirnov: 0.33 at 1 % for twenty draws.
    assert np.max(np.arange(1, 21) / 20 - chances) < 0.33


def test_a_ridge_of_parameters_is_no_difference():
    """What weight and stiffness do to small angles is nearly the same."""
    model = KBI() + EFFECTS["gravity"]()
    same = {"I": 0.1, "gravity.moment": 8.0, "gravity.posture": 0.6}
    for seed in range(2):
        found = across(records_of("torque", seed=seed, model=model, same=same), model)
        assert found.p > 1e-3
        assert not found.differing


def test_what_one_record_hides_another_shows():
    """In small motions a cubic spring cannot be seen; large ones show it, and so both do."""
    some = {"small": 0.1, "large": 1.0}
    records = {}
    for i, (name, size) in enumerate(some.items()):
        values = SAME | {f"{KEY}.centre": 0.0} | OWN["half"]
        conditions = [(kind, size * value) for kind, value in CONDITIONS]
        made = trials(MODEL, values, seed=i, noise=3e-3, conditions=conditions)
        library = {key: EFFECTS[key] for key in (KEY, "sensor_delay", "series_tendon")}
        records[name] = Investigation(made, library=library)
    alone = records["small"].weigh()
    assert alone.rows[0].effects == ()
    rows = weigh_across(records)
    assert rows[0].effects == (KEY,)
    assert rows[0].probability > 0.8
    assert sum(row.probability for row in rows) == pytest.approx(1.0)
    assert rows[0].by_record["large"] > 10 > abs(rows[0].by_record["small"])
    record = across_record(across(records, MODEL), rows, command="identifiability across")
    page = across_page(record, "across.svg")
    assert "| cubic stiffness |" in page


def test_what_cannot_be_compared_is_one_sentence():
    records = records_of("torque")
    with pytest.raises(InputError, match="found 1 record, expected two or more"):
        across({"rest": records["rest"]}, MODEL)
    with pytest.raises(InputError, match="weight may differ, but the model has K, B, I"):
        across(records, MODEL, may_differ=("weight",))


def test_the_page_the_record_and_the_figure_hold_what_was_found(agreeing):
    plain = across_record(agreeing, command="identifiability across")
    page = across_page(plain, "across.svg")
    for record in agreeing.records:
        assert record.name in page
    assert "cubic stiffness.coefficient [Nm/rad³] |" in page
    assert json.loads(json.dumps(plain)) == plain
    assert plain["p"] == agreeing.p
    assert [one["verdict"] for one in plain["parameters"] if one["shared"]] == ["agree"] * 2
    assert "may differ" in across_text(plain)
    figure = across_figure(agreeing)
    assert sum(panel.get_visible() for panel in figure.axes) == len(agreeing.parameters)


def folders_of(folder):
    """Two records as files."""
    for name, own in list(OWN.items())[:2]:
        (folder / name).mkdir()
        for trial in trials(MODEL, SAME | own | {f"{KEY}.centre": 0.0}, noise=3e-3):
            rows = np.stack([TIME, trial.torque, trial.angle], axis=1)
            path = folder / name / f"{trial.name}.csv"
            np.savetxt(path, rows, delimiter=",", header="time_s,torque_Nm,angle_rad", comments="")
    return [str(folder / name) for name in list(OWN)[:2]]


def test_a_record_is_taken_as_what_it_misses_says_its_torque_ran(tmp_path, monkeypatch):
    """As one record is by an investigation of its own."""
    asked, taken = [], {}
    monkeypatch.setattr(Investigation, "weigh", lambda self, **how: None)

    def otherwise(self, posterior, *, seed=1):
        asked.append(self)
        if len(asked) > 1:
            return None
        return Investigation(self._recorded[0], torque_between="smooth")

    def all_of(records, **options):
        taken.update({name: study.torque_between for name, study in records.items()})
        return [SimpleNamespace(effects=())]

    monkeypatch.setattr(Investigation, "otherwise", otherwise)
    monkeypatch.setattr(weighed_across, "weigh_across", all_of)
    monkeypatch.setattr(agreement, "across", lambda records, *given, **options: sys.exit(7))
    with pytest.raises(SystemExit):
        main(["across", *folders_of(tmp_path), "--out", str(tmp_path / "out")])
    assert taken == {"rest": "smooth", "half": "straight"}


def test_on_the_command_line(tmp_path, capsys):
    folders = folders_of(tmp_path)
    out = tmp_path / "out"
    assert main(["across", *folders, "--effects", KEY, "--out", str(out)]) == 0
    assert sorted(f.name for f in out.iterdir()) == ["across.json", "across.md", "across.svg"]
    assert "The 2 records agree" in capsys.readouterr().out
    assert main(["across", folders[0], "--out", str(out)]) == 2
    assert main(["across", *folders, "--effects", "weight", "--out", str(out)]) == 2
    assert "is no effect that is known" in capsys.readouterr().err
