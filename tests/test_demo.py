"""The demo: what it says of the joint it made, and what it leaves."""

import json
from pathlib import Path

import pytest

from identifiability.cli.main import main
from identifiability.measurement import perturbations
from identifiability.measurement.example import B_CE, INERTIA, K_CE, K_SE

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.usefixtures("few_effects", "shown_alone")
def test_the_demo_finds_the_joint_that_was_made(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(perturbations, "WINDOWS", (0.1, 0.2))
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out)]) == 0
    said = capfd.readouterr().out
    found = json.loads((out / "investigation" / "investigation.json").read_text())
    assert found["verdict"]["kind"] == "explained"
    assert found["verdict"]["effects"] == ["series_tendon"]
    assert found["steps"][-1]["error_held_out"] < 0.02 * found["baseline"]["error_held_out"]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["truth"] == {"K": K_CE, "B": B_CE, "I": INERTIA, "series_tendon.stiffness": K_SE}
    last = summary["models"][1]
    for name, true in summary["truth"].items():
        # The noise leaves each parameter an uncertainty of some tenths of a per cent.
        assert last["parameters"][name] == pytest.approx(true, rel=0.01)
        assert abs(last["parameters"][name] - true) < 4 * last["sd"][name]
    assert len(said.strip().splitlines()) <= 40
    assert max(map(len, said.replace(str(tmp_path), "").splitlines())) < 130
    # What is published is what the command finds.
    stored = json.loads((ROOT / "results" / "demo" / "summary.json").read_text())
    for one, other in zip(summary["models"][:2], stored["models"], strict=False):
        assert one["parameters"] == pytest.approx(other["parameters"], rel=1e-3, abs=1e-6)
        assert one["error_held_out"] == pytest.approx(other["error_held_out"], rel=1e-3)
    by_window = {w["T"]: w["K"] for w in stored["K_by_window"]}
    for w in summary["K_by_window"]:
        assert by_window[w["T"]] == pytest.approx(w["K"], rel=1e-3)
    # A good fit, whose windows contradict each other.
    recording = json.loads((out / "trials" / "fit.json").read_text())
    assert recording["vaf"] > 98
    K = {w["T"]: w["parameters"]["K"]["posterior_95"] for w in recording["windows"]}
    assert K[0.1][0] > K[0.2][1]
    assert recording["consistency"]["kind"] == "depends on the window"
    assert "it is not a property of this joint" in (out / "trials" / "report.html").read_text()
    assert (out / "investigation" / "report.html").stat().st_size > 10_000
    assert {p.name for p in out.iterdir()} == {
        *("T100", "T200", "trials", "investigation"),
        *("summary.svg", "summary.png", "summary.json"),
    }


def test_the_readme_quotes_the_demo():
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    found = json.loads((ROOT / "results" / "demo" / "summary.json").read_text())
    plain, final = found["models"][0], found["models"][1]
    assert f"{found['vaf']:.1f} % of the variance" in readme
    assert f"K is {found['K_least_squares']:.1f} Nm/rad where" in readme
    assert f"the muscle's is {found['truth']['K']:.0f}" in readme
    assert f"K = {final['parameters']['K']:.2f} ± {final['sd']['K']:.2f}" in readme
    assert f"falls from {plain['error_held_out']:.4f} to {final['error_held_out']:.5f}" in readme
