"""The demo: what it says of the joint it made, and what it leaves."""

import json
import re

import pytest

from identifiability.cli.main import main
from identifiability.measurement import perturbations
from identifiability.measurement.example import B_CE, INERTIA, K_CE, K_SE


@pytest.mark.usefixtures("few_effects")
def test_the_demo_finds_the_joint_that_was_made(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(perturbations, "WINDOWS", (0.1, 0.2))
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out)]) == 0
    said = capfd.readouterr().out
    found = json.loads((out / "investigation" / "investigation.json").read_text())
    assert found["verdict"]["kind"] == "explained"
    assert found["verdict"]["effects"] == ["series_tendon"]
    assert found["steps"][-1]["error_held_out"] < 0.02 * found["baseline"]["error_held_out"]
    truth = {"K": K_CE, "B": B_CE, "I": INERTIA, "series_tendon.stiffness": K_SE}
    for name, true in truth.items():
        value, shown = re.search(rf"{name} = ([0-9.]+) \(([0-9.]+)\)", said).groups()
        assert float(shown) == true
        # The noise leaves each parameter an uncertainty of some tenths of a per cent.
        assert float(value) == pytest.approx(true, rel=0.01)
    # A good fit, whose windows contradict each other.
    recording = json.loads((out / "trials" / "fit.json").read_text())
    assert recording["vaf"] > 98
    K = {w["T"]: w["parameters"]["K"]["posterior_95"] for w in recording["windows"]}
    assert K[0.1][0] > K[0.2][1]
    assert recording["consistency"]["kind"] == "depends on the window"
    assert "it is not a property of this joint" in (out / "trials" / "report.html").read_text()
    assert (out / "investigation" / "report.html").stat().st_size > 10_000
    assert {p.name for p in out.iterdir()} == {"T100", "T200", "trials", "investigation"}
