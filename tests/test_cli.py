"""Bad input to every command: one sentence, exit code 2, no traceback, nothing half-written."""

import shlex

import numpy as np
import pytest

import identifiability
from identifiability.benchmark.blind import blind_cases
from identifiability.benchmark.calibration import failed
from identifiability.cli.exits import PARTIAL
from identifiability.cli.main import main, parser
from identifiability.joint.effects import EFFECTS
from identifiability.provenance import package_version, read_record
from identifiability.report.calibration import calibration_page
from identifiability.sweep.outcome import Outcome

HEADER = "time_s,torque_Nm,angle_rad"


def rows(n=200):
    time = np.arange(n) * 1e-3
    torque = np.where((time > 0.02) & (time < 0.04), 5.0, 0.0)
    angle = np.where(time > 0.02, 0.05 * np.sin(20 * (time - 0.02)), 0.0)
    return [f"{t:.3f},{m:g},{a:.6f}" for t, m, a in zip(time, torque, angle, strict=True)]


def changed(index, text):
    lines = rows()
    lines[index] = text
    return lines


BAD_FILES = {
    "empty": ("", "empty"),
    "header only": (HEADER, "no data|header|sample"),
    "text in numbers": ("\n".join([HEADER, *changed(7, "0.007,five,0.1")]), "five"),
    "unequal rows": ("\n".join([HEADER, *changed(7, "0.007,5")]), "columns|values|fields"),
    "time that goes back": ("\n".join([HEADER, *changed(50, "0.010,5,0.1")]), "increas"),
    "NaN": ("\n".join([HEADER, *changed(9, "0.009,5,nan")]), "nan|NaN|finite"),
    "one sample": ("\n".join([HEADER, *rows(1)]), "1 sample|found 1|one sample"),
    "constant angle": (
        "\n".join([HEADER, *(r.rsplit(",", 1)[0] + ",0.1" for r in rows())]),
        "constant|does not move|same",
    ),
    "no units": ("\n".join(["time,torque,angle", *rows()]), "--columns"),
}


def refuse(arguments, capsys, tmp_path, words):
    """The command refuses with one sentence that contains one of the words."""
    out = tmp_path / "out"
    assert main([*map(str, arguments), "--out", str(out)]) == 2
    message = capsys.readouterr().err.strip()
    assert message.startswith("identifiability: ")
    assert message.count("\n") == 0
    assert "Traceback" not in message
    assert any(word.lower() in message.lower() for word in words.split("|")), message
    assert not list(out.rglob("*.*")) if out.exists() else True


@pytest.mark.parametrize("case", BAD_FILES)
def test_fit_refuses_a_bad_file(case, tmp_path, capsys):
    text, words = BAD_FILES[case]
    path = tmp_path / "trial.csv"
    path.write_text(text)
    refuse(["fit", path], capsys, tmp_path, words)


def test_fit_refuses_a_missing_file(tmp_path, capsys):
    refuse(["fit", tmp_path / "nowhere.csv"], capsys, tmp_path, "nowhere.csv")


@pytest.fixture
def trial(tmp_path):
    path = tmp_path / "trial.csv"
    path.write_text("\n".join([HEADER, *rows()]))
    return path


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--columns", "time=time_s:s", "angle=angle_rad:Nm", "torque=torque_Nm:Nm"], "Nm"),
        (
            ["--columns", "time=time_s:s", "angle=angle_rad:furlong", "torque=torque_Nm:Nm"],
            "furlong",
        ),
        (["--columns", "time=time_s:s", "angle=nothing:rad", "torque=torque_Nm:Nm"], "nothing"),
        (["--window", "5"], "window of 5 s"),
        (["--window", "-1"], "window of -1 s"),
        (["--window", "0.001"], "fewer than five samples"),
        (["--rate", "500"], "rate"),
        (["--bounds", "K=3"], "NAME=LOW:HIGH"),
        (["--bounds", "X=1:2"], "'X'"),
        (["--bounds", "K=5:2"], "lower < upper"),
        (["--driven", "angle", "--lowpass", "600"], "low-pass of 600"),
        (["--lowpass", "loud"], "loud"),
        (["--seed", "-1"], "seed -1"),
    ],
)
def test_fit_refuses_bad_options(options, words, trial, tmp_path, capsys):
    refuse(["fit", trial, *options], capsys, tmp_path, words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--msm", 32, -3.2, 100, 0.1], "B_CE = -3.2"),
        (["--msm", "nan", 3.2, 100, 0.1], "K_CE = nan"),
        (["--msm", 32, 3.2, 100, 0.1, "--perturbation", "kick"], "'kick'"),
        (["--msm", 32, 3.2, 100, 0.1, "--window", 0.0015], "window of 0.0015"),
        (["--msm", 32, 3.2, 100, 0.1, "--noise", "loud"], "'loud'"),
        (["--msm", 32, 3.2, 100, 0.1, "--dE", -1], "dE = -1"),
        (["--msm", 32, 3.2, 100, 0.1, "--correlation-time", -1], "correlation time"),
        (
            ["--msm", 32, 3.2, 100, 0.1, "--perturbation", "pulse", "--rate", 130, "--window", 0.1],
            "between",
        ),
        (["--msm", 32, 3.2, 100, 0.1, "--seed", -2], "seed -2"),
    ],
)
def test_widths_refuses_bad_options(options, words, tmp_path, capsys):
    refuse(["widths", *options], capsys, tmp_path, words)


@pytest.mark.parametrize("command", ["paper", "atlas", "demo"])
def test_an_output_folder_that_is_a_file_is_refused(command, tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("")
    assert main([command, "--out", str(taken)]) == 2
    assert "taken" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--seed", -2], "seed -2"),
        (["--cases", 0], "--cases 0"),
        (["--workers", 0], "--workers 0"),
        (["--seed", 3, 4, 3], "every seed once"),
    ],
)
def test_benchmark_refuses_bad_options(options, words, tmp_path, capsys):
    refuse(["benchmark", "calibration", *options], capsys, tmp_path, words)


def test_benchmark_writes_what_failed_too_and_says_so(tmp_path, capsys, monkeypatch):
    def fails(n, *, seed, folder, workers, executor):
        outcomes = [Outcome("a case", "timed out", cause="no result within 2 s")]
        return [failed(blind_cases("nulls", seed, 1)[0], outcomes[0].cause)], outcomes

    monkeypatch.setattr("identifiability.benchmark.calibration.measure", fails)
    arguments = ["benchmark", "calibration", "--cases", "8", "--seed", "3"]
    assert main([*arguments, "--out", str(tmp_path)]) == PARTIAL
    assert "no result within 2 s" in capsys.readouterr().err
    record, remark = read_record(tmp_path / "calibration.json")
    assert remark == ""
    assert sum(tier["failed"] for tier in record["tiers"]) == 1
    assert (tmp_path / "calibration.md").read_text(encoding="utf-8") == calibration_page(record)


def test_atlas_refuses_a_missing_or_broken_configuration(tmp_path, capsys):
    refuse(["atlas", tmp_path / "nowhere.toml"], capsys, tmp_path, "nowhere.toml")
    (tmp_path / "broken.toml").write_text("K_CE = [")
    refuse(["atlas", tmp_path / "broken.toml"], capsys, tmp_path, "broken.toml")


def test_unknown_commands_and_options_exit_with_two(capsys):
    for arguments in (["nonsense"], ["fit"], ["widths", "--msm", "1", "2"]):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2


def test_widths_writes_what_it_says(tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--perturbation", "impulse", "--window", "0.05", "--noise", "contour", "--seed", "1"]
    assert main(["widths", "--msm", "32", "3.2", "100", "0.1", *options, "--out", str(out)]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["corner.png", "posterior.nc", "widths.json"]
    record, remark = read_record(out / "widths.json")
    assert remark == ""
    assert set(record["parameters"]) == {"K", "B", "I"}
    stiffness = record["parameters"]["K"]
    # A deterministic reference: three-dimensional Gauss-Legendre quadrature with 250³ nodes.
    assert stiffness["quadrature_sd"] == pytest.approx(23.39, rel=2e-3)
    assert abs(stiffness["posterior_sd"] - 23.39) < 4 * stiffness["posterior_sd_mcse"]
    assert stiffness["verdict"] == "truncated"
    assert "truncated" in capsys.readouterr().out


COMMANDS = (
    "demo",
    "fit",
    "investigate",
    "across",
    "widths",
    "paper",
    "atlas",
    "sensitivity",
    "effects",
    "recordings",
    "benchmark",
)


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_ends_with_examples_that_are_understood(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"] if command else ["--help"])
    lines = capsys.readouterr().out.split("examples:\n")[1].splitlines()
    typed = [shlex.split(line) for line in lines]
    assert typed
    for name, *arguments in typed:
        assert name == "identifiability"
        if not {"--list-effects", "--help"} & {*arguments}:
            assert parser().parse_args(arguments).command == (command or arguments[0])


def test_version_and_effects_are_told(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out.split() == ["identifiability", package_version()]
    assert identifiability.__version__ == package_version()
    for command in ([], ["investigate"]):
        with pytest.raises(SystemExit, match="0"):
            main([*command, "--list-effects"])
        lines = capsys.readouterr().out.splitlines()
        assert [line.split()[0] for line in lines] == list(EFFECTS)
        assert all(EFFECTS[line.split()[0]].title in line for line in lines)
