"""Workers that are separate programs, reached through a scheduler."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray

from identifiability.cli.main import main

PLAN = """\
K_CE = [10, 200]
B_CE = [5]
ratio = [2]
T = [0.05]
perturbations = ["impulse"]
readings = ["energy"]
corner = []
"""


@pytest.fixture
def started():
    """Programs that are ended when the test is."""
    programs = []

    def start(*arguments):
        command = [sys.executable, "-m", "dask", *map(str, arguments)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        programs.append(subprocess.Popen(command, **quiet))
        return programs[-1]

    yield start
    for program in programs:
        program.kill()
        program.wait()


def address_in(path, patience=60.0):
    """Where a scheduler says in a file that it is."""
    until = time.monotonic() + patience
    while not path.is_file():
        assert time.monotonic() < until, "the scheduler did not start"
        time.sleep(0.2)
    return path


def cells_of(folder):
    with xarray.open_dataset(folder / "atlas.nc") as data:
        return data.drop_vars("seconds").load()


@pytest.mark.long
def test_a_cluster_computes_the_same_cells(tmp_path, started, capsys):
    from distributed import Client

    config = tmp_path / "plan.toml"
    config.write_text(PLAN)
    where = tmp_path / "scheduler.json"
    started("scheduler", "--port", 0, "--dashboard-address", ":0", "--scheduler-file", where)
    address_in(where)
    workers = [
        started("worker", "--scheduler-file", where, "--nthreads", 1, "--no-dashboard")
        for _ in range(2)
    ]
    with Client(scheduler_file=str(where), set_as_default=False) as client:
        address = client.scheduler.address
        client.wait_for_workers(2, timeout=60)
    there, here = tmp_path / "there", tmp_path / "here"
    assert main(["atlas", str(config), "--out", str(there), "--scheduler", address]) == 0
    assert main(["atlas", str(config), "--out", str(here), "--workers", "1"]) == 0
    xarray.testing.assert_identical(cells_of(there).drop_attrs(), cells_of(here).drop_attrs())
    # Nothing that is finished is computed again, whoever did it.
    before = (there / "atlas.cells" / "log.jsonl").read_bytes()
    assert main(["atlas", str(config), "--out", str(there), "--workers", "1"]) == 0
    assert (there / "atlas.cells" / "log.jsonl").read_bytes() == before
    assert np.all(cells_of(there)["status"] == "done")
    # A worker that is killed takes nothing with it, and one that is left goes on.
    workers[0].kill()
    config.write_text(PLAN.replace("[10, 200]", "[10, 50, 100, 200]"))
    larger = ["atlas", str(config), "--replace", "--out"]
    assert main([*larger, str(there), "--scheduler", address]) == 0
    assert main([*larger, str(here), "--workers", "1"]) == 0
    xarray.testing.assert_identical(cells_of(there).drop_attrs(), cells_of(here).drop_attrs())
    capsys.readouterr()
    # Without workers there is nobody to compute.
    workers[1].kill()
    time.sleep(5)
    assert main(["atlas", str(config), "--out", str(there), "--scheduler", address]) == 2
    assert "has no workers" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("killed", ["scheduler", "command"])
def test_what_dies_takes_no_finished_cell_with_it(killed, tmp_path, started):
    """A scheduler's death is one sentence; the same command goes on, without one as well."""
    from distributed import Client

    config = tmp_path / "plan.toml"
    config.write_text(PLAN.replace("[10, 200]", str(list(range(10, 210, 5)))))
    where = tmp_path / "scheduler.json"
    options = ("--port", 0, "--dashboard-address", ":0", "--scheduler-file", where)
    scheduler = started("scheduler", *options)
    address = json.loads(address_in(where).read_text())["address"]
    started("worker", "--scheduler-file", where, "--nthreads", 1, "--no-dashboard")
    there, here = tmp_path / "there", tmp_path / "here"
    atlas = [sys.executable, "-m", "identifiability", "atlas", str(config), "--out"]
    with Client(scheduler_file=str(where), set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    command = subprocess.Popen(
        [*atlas, str(there), "--scheduler", address], stderr=subprocess.PIPE, text=True
    )
    cells = there / "atlas.cells"
    while len(list(cells.glob("*.npz"))) < 5:
        assert command.poll() is None
        time.sleep(0.05)
    (scheduler if killed == "scheduler" else command).kill()
    said = command.communicate(timeout=120)[1]
    finished = {path.name: path.read_bytes() for path in cells.glob("*.npz")}
    assert 5 <= len(finished) < 40
    if killed == "scheduler":
        assert command.returncode == 2
        assert "lost the scheduler" in said.splitlines()[-1]
        assert "Traceback" not in said
    assert main(["atlas", str(config), "--out", str(there), "--workers", "1"]) == 0
    assert {name: (cells / name).read_bytes() for name in finished} == finished
    assert main(["atlas", str(config), "--out", str(here), "--workers", "1"]) == 0
    xarray.testing.assert_identical(cells_of(there).drop_attrs(), cells_of(here).drop_attrs())


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "found no scheduler at 'tcp://127.0.0.1:9'"),
        (["--scheduler", "here", "--workers", "2"], "found --workers and --scheduler"),
    ],
)
def test_a_wrong_scheduler_is_told_in_one_sentence(
    arguments, expected, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("identifiability.cli.workers._PATIENCE_S", 1)
    assert main(["atlas", "--out", str(tmp_path / "out"), *arguments]) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
