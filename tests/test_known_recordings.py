"""The page of real recordings, and the command that makes it; the files are not needed."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden import JOINT, record_that_grows

from identifiability.benchmark import real
from identifiability.cli.main import main
from identifiability.cli.recordings import _across
from identifiability.investigation.across import weighed
from identifiability.investigation.across.weighed import SetAcross
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.report.recordings import recordings_page

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def found():
    return json.loads((ROOT / "results" / "recordings.json").read_text())


def test_the_page_is_that_of_the_record(found):
    page = (ROOT / "results" / "recordings.md").read_text(encoding="utf-8")
    assert page == recordings_page(found["recordings"], found.get("rigs"))
    for rig in found.get("rigs", {}).values():
        assert (ROOT / "results" / "recordings" / f"{rig['records'][0]['name']}_rig.png").is_file()
    for record in found["recordings"]:
        assert (ROOT / "results" / "recordings" / f"{record['name']}.png").is_file()


def test_the_list_says_where_from_and_what_is_at_hand(capsys, tmp_path):
    assert main(["recordings"]) == 0
    said = capsys.readouterr().out
    for one in real.REAL.values():
        assert one.sha256 in said
        assert one.source in said
        assert one.licence in said
    (tmp_path / real.REAL["ankle"].file).write_bytes(b"something else")
    assert main(["recordings", "--folder", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "ankle [different]" in said
    assert "silverbox [missing]" in said


def test_one_that_cannot_be_investigated_takes_no_other_with_it(capsys, tmp_path, monkeypatch):
    folder, out = tmp_path / "files", tmp_path / "out"
    folder.mkdir()
    text = b"time_s,torque_Nm\n0,1\n"
    (folder / "broken.csv").write_bytes(text)
    broken = replace(
        real.REAL["ankle"],
        name="broken",
        file="broken.csv",
        sha256=hashlib.sha256(text).hexdigest(),
        columns=(),
        variable=None,
        rate=None,
    )
    monkeypatch.setitem(real.REAL, "broken", broken)
    code = main(["recordings", "--folder", str(folder), "--out", str(out)])
    assert code == 3
    (record,) = json.loads((out / "recordings.json").read_text())["recordings"]
    assert record["name"] == "broken"
    # Of a recording that is not asked for, what was found before stays.
    arguments = ["recordings", "--folder", str(folder), "--only", "ankle", "--out", str(out)]
    assert main(arguments) == 0
    assert json.loads((out / "recordings.json").read_text())["recordings"] == [record]
    assert "angle" in record["failure"]
    assert f"failed: {record['failure']}" in (out / "recordings.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "elbow"], "found the recording elbow"),
        (["--folder", "nowhere"], "found no folder nowhere"),
        (["--out", "somewhere"], "without --folder"),
    ],
)
def test_bad_options_are_one_sentence(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["recordings", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_what_other_code_found_is_not_taken(tmp_path):
    assert real.finished(tmp_path) is None
    record = {"code": "0" * 32, "code_of": "identifiability.investigation.record"}
    (tmp_path / "investigation.json").write_text(json.dumps(record))
    assert real.finished(tmp_path) is None
    record["code"] = real.code_fingerprint("identifiability.investigation.record")
    (tmp_path / "investigation.json").write_text(json.dumps(record))
    assert real.finished(tmp_path) == record


@pytest.mark.parametrize("broken", ["{", "[]", '{"recordings": [{}]}'])
def test_a_broken_record_of_before_is_one_sentence(broken, capsys, tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "recordings.json").write_text(broken)
    arguments = ["recordings", "--folder", str(tmp_path / "files"), "--out", str(tmp_path)]
    assert main(arguments) == 2
    said = capsys.readouterr().err.strip()
    assert "cannot read what was found before" in said
    assert len(said.splitlines()) == 1
    assert (tmp_path / "recordings.json").read_text() == broken


def test_recordings_are_in_one_order_whatever_was_asked_last(tmp_path):
    names = list(real.REAL)
    before = [{"name": name, "failure": "none"} for name in reversed(names)]
    (tmp_path / "files").mkdir()
    (tmp_path / "recordings.json").write_text(json.dumps({"recordings": before}))
    arguments = ["recordings", "--folder", str(tmp_path / "files"), "--out", str(tmp_path)]
    assert main([*arguments, "--only", names[0]]) == 0
    after = json.loads((tmp_path / "recordings.json").read_text())["recordings"]
    assert [one["name"] for one in after] == names[1:]


def test_several_records_of_one_rig_are_held_against_each_other(tmp_path, monkeypatch):
    model = KBI() + EFFECTS["cubic_stiffness"]()
    files = []
    for i, stiffness in enumerate((20.0, 40.0)):
        values = JOINT | {"K": stiffness, "cubic_stiffness.coefficient": 150.0}
        values["cubic_stiffness.centre"] = 0.0
        trial = record_that_grows(model, values, seed=i)
        path = tmp_path / f"record{i}.csv"
        rows = np.stack([trial.time, trial.torque, trial.angle], axis=1)
        np.savetxt(path, rows, delimiter=",", header="time_s,torque_Nm,angle_rad", comments="")
        files.append(path)
    several = [
        replace(
            real.REAL["silverbox"],
            name=path.stem,
            file=path.name,
            columns=(),
            rate=None,
            rig="A rig",
        )
        for path in files
    ]
    for one in several:
        monkeypatch.setitem(real.REAL, one.name, one)
    assert real.rigs(["record0", "record1", "ankle"]) == {"A rig": several}
    assert real.rigs(["record0", "ankle"]) == {}
    named = SetAcross(("cubic_stiffness",), 0.9, 50.0, {"record0": 25.0, "record1": 25.0})
    monkeypatch.setattr(weighed, "weigh_across", lambda studies, progress: (named,))
    record = _across(several, tmp_path, tmp_path)
    assert record["command"] == "identifiability across record0.csv record1.csv --driven torque"
    assert (tmp_path / "record0_rig.png").is_file()
    page = recordings_page([], {"A rig": record})
    assert "## A rig: several records of it" in page
    assert "cubic stiffness.coefficient" in page
