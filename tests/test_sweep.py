from __future__ import annotations

import ctypes
import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from identifiability.errors import InputError
from identifiability.sweep.outcome import Outcome
from identifiability.sweep.run import sweep

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Task:
    number: int
    deed: str = "square"
    note: str = ""
    folder: str = ""


def work(task: Task) -> dict[str, np.ndarray]:
    if task.folder:
        with open(Path(task.folder) / "calls", "a") as calls:
            calls.write(f"{task.number}\n")
    if task.deed == "raise":
        raise ZeroDivisionError("nothing to divide by\nsecond line")
    if task.deed == "exit":
        os._exit(7)
    if task.deed == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if task.deed == "segfault":
        ctypes.string_at(0)
    if task.deed == "hang":
        time.sleep(600)
    if task.deed == "nap":
        time.sleep(0.1)
    if task.deed == "object":
        return {"value": np.array([object()])}
    if task.deed == "environment":
        names = ("OMP_NUM_THREADS", "JAX_COMPILATION_CACHE_DIR")
        return {name: np.array(os.environ[name]) for name in names}
    return {"value": np.array(task.number**2), "text": np.array(["ä", task.note])}


def run(tasks: dict[str, Task], folder: Path | None, **options) -> dict[str, Outcome]:
    options = {"workers": 2, "label": "test", "progress": False} | options
    return sweep(work, tasks, folder=folder, **options)


def log(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def squares(n: int, **fields) -> dict[str, Task]:
    return {f"t{i}": Task(i, **fields) for i in range(n)}


@pytest.fixture
def threads(monkeypatch):
    """Sweeps in threads of this process, where nothing needs to die."""
    return {"executor": lambda: ThreadPoolExecutor(2)}


def test_one_bad_task_takes_no_other_with_it(tmp_path):
    deeds = {3: "raise", 7: "exit", 8: "kill", 12: "hang", 15: "segfault", 18: "object"}
    tasks = {f"t{i}": Task(i, deeds.get(i, "square")) for i in range(24)}
    outcomes = run(tasks, tmp_path, timeout_s=3.0)
    assert list(outcomes) == list(tasks)
    assert {name: o.status for name, o in outcomes.items() if o.status != "done"} == {
        "t3": "failed",
        "t7": "crashed",
        "t8": "crashed",
        "t12": "timed out",
        "t15": "crashed",
        "t18": "failed",
    }
    assert outcomes["t3"].cause == "ZeroDivisionError: nothing to divide by"
    assert outcomes["t7"].cause == "its process ended with exit code 7"
    assert "SIGKILL" in outcomes["t8"].cause
    assert outcomes["t12"].cause == "no result within 3 s"
    assert "SIGSEGV" in outcomes["t15"].cause
    assert "no array" in outcomes["t18"].cause
    for i in set(range(24)) - set(deeds):
        assert outcomes[f"t{i}"].arrays["value"] == i**2
    lines = {line["task"]: line for line in log(tmp_path)}
    assert len(log(tmp_path)) == len(lines) == 24
    assert "in work" in lines["t3"]["trace"]
    assert "in work" in lines["t12"]["trace"]


def test_failed_tasks_and_only_those_are_tried_again(tmp_path, threads):
    calls = tmp_path / "calls"
    bad = Task(1, "raise", folder=str(tmp_path))
    good = Task(2, folder=str(tmp_path))
    first = run({"bad": bad, "good": good}, tmp_path / "kept", **threads)
    again = run({"bad": bad, "good": good}, tmp_path / "kept", **threads)
    assert Counter(calls.read_text().split()) == {"1": 2, "2": 1}
    assert (first["good"].resumed, again["good"].resumed) == (False, True)
    assert again["bad"].status == "failed"
    for key, value in first["good"].arrays.items():
        np.testing.assert_array_equal(again["good"].arrays[key], value)


def test_what_failed_is_not_tried_again_where_that_is_not_asked_for(tmp_path, monkeypatch):
    calls = tmp_path / "calls"
    deeds = {0: "raise", 1: "square", 2: "exit"}
    tasks = {deed: Task(i, deed, folder=str(tmp_path)) for i, deed in deeds.items()}
    first = run(tasks, tmp_path / "kept")
    again = run(tasks, tmp_path / "kept", retry_failed=False)
    assert Counter(calls.read_text().split())["0"] == Counter(calls.read_text().split())["1"] == 1
    assert (again["raise"].status, again["raise"].resumed) == ("failed", True)
    assert again["raise"].cause == first["raise"].cause
    # That a process died hangs on the machine.
    assert (again["exit"].status, again["exit"].resumed) == ("crashed", False)
    # Other code may do better.
    monkeypatch.setattr("identifiability.sweep.keep.code_fingerprint", lambda module: "other")
    threads = {"executor": lambda: ThreadPoolExecutor(2)}
    other = run({"raise": tasks["raise"]}, tmp_path / "kept", retry_failed=False, **threads)
    assert (other["raise"].status, other["raise"].resumed) == ("failed", False)


@pytest.mark.parametrize("change", ["task", "code"])
def test_a_changed_configuration_never_reads_old_results(tmp_path, threads, monkeypatch, change):
    run({"a": Task(3)}, tmp_path, **threads)
    task = Task(3)
    if change == "task":
        task = Task(3, note="changed")
    else:
        monkeypatch.setattr("identifiability.sweep.keep.code_fingerprint", lambda module: "other")
    assert not run({"a": task}, tmp_path, **threads)["a"].resumed
    assert run({"a": task}, tmp_path, **threads)["a"].resumed


def test_the_name_of_a_task_is_not_part_of_its_configuration(tmp_path, threads):
    run({"a": Task(3)}, tmp_path, **threads)
    assert run({"b": Task(3)}, tmp_path, **threads)["b"].resumed


def test_a_damaged_file_is_computed_again(tmp_path, threads):
    run({"a": Task(3), "b": Task(4)}, tmp_path, **threads)
    files = sorted(tmp_path.glob("*.npz"))
    files[0].write_bytes(files[0].read_bytes()[:100])
    files[1].write_bytes(b"")
    again = run({"a": Task(3), "b": Task(4)}, tmp_path, **threads)
    assert [o.resumed for o in again.values()] == [False, False]
    assert [int(o.arrays["value"]) for o in again.values()] == [9, 16]


def test_half_a_line_in_the_log_spoils_no_other(tmp_path, threads):
    run({"a": Task(3)}, tmp_path, **threads)
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"task": "b", "sta')
    run({"c": Task(5)}, tmp_path, **threads)
    lines = (tmp_path / "log.jsonl").read_text().splitlines()
    assert len(lines) == 3
    assert [json.loads(lines[i])["task"] for i in (0, 2)] == ["a", "c"]


def test_a_full_disk_is_one_sentence_and_takes_nothing_finished_with_it(
    tmp_path, threads, monkeypatch
):
    tasks = {str(i): Task(i) for i in range(6)}
    written, savez = [], np.savez

    def full(file, **arrays):
        file.write(b"half of it")
        if len(written) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(file.name)
        file.seek(0)
        savez(file, **arrays)

    monkeypatch.setattr("numpy.savez", full)
    with pytest.raises(InputError, match=r"found no room on the disk for .*make room"):
        sweep(work, tasks, folder=tmp_path, label="full", workers=1, **threads)
    kept = {path.name: path.read_bytes() for path in tmp_path.glob("*.npz")}
    assert len(kept) == 3
    assert not list(tmp_path.glob(".*"))
    monkeypatch.undo()
    again = sweep(work, tasks, folder=tmp_path, label="full", workers=1, **threads)
    assert sum(outcome.resumed for outcome in again.values()) == 3
    assert {name: (tmp_path / name).read_bytes() for name in kept} == kept
    assert all(outcome.status == "done" for outcome in again.values())


def test_without_a_folder_nothing_is_written(tmp_path, threads, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run({"a": Task(3)}, None, **threads)["a"].arrays["value"] == 9
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_the_users_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot make the output folder"):
        run({"a": Task(3)}, tmp_path / "file" / "below")


def test_a_limit_needs_processes_that_may_be_ended(threads):
    with pytest.raises(InputError, match="only the default one"):
        run({"a": Task(3)}, None, timeout_s=1.0, **threads)


def test_workers_have_one_thread_and_one_cache_and_the_parent_keeps_its_environment(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NPROC", raising=False)
    outcome = run({"a": Task(1, "environment")}, None)["a"]
    assert outcome.arrays["OMP_NUM_THREADS"] == "1"
    assert outcome.arrays["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "identifiability")
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ
    assert os.environ["OMP_NUM_THREADS"] == "5"
    assert "NPROC" not in os.environ


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys, threads):
    tasks = squares(3) | {"bad": Task(9, "raise")}
    run(tasks, None, progress=True, **threads)
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("test: 4 of 4, 1 failed, ")
    run(tasks, None, progress=False, **threads)
    assert capsys.readouterr().err == ""


SCRIPT = """
import signal
import sys
from pathlib import Path
# A run in the background, as that of the tests may be, is started with interrupts ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {tests!r})
from test_sweep import Task, run
if __name__ == "__main__":
    tasks = {{f"t{{i}}": Task(i, "nap", folder=sys.argv[1]) for i in range(60)}}
    run(tasks, Path(sys.argv[1]) / "kept")
"""


@pytest.fixture
def started(tmp_path):
    """A sweep of 60 naps in a process of its own, some of which are over."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent)))
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    kept, deadline = tmp_path / "kept", time.monotonic() + 60
    while len(list(kept.glob("[!.]*.npz"))) < 10 and time.monotonic() < deadline:
        time.sleep(0.02)
    yield process
    process.kill()
    process.wait()


@pytest.mark.parametrize("end", ["kill", "interrupt"])
def test_an_ended_run_is_resumed_with_nothing_lost(tmp_path, started, end):
    if end == "kill":
        started.kill()
    else:
        os.killpg(started.pid, signal.SIGINT)
    _, error = started.communicate(timeout=20)
    if end == "interrupt":
        assert b"KeyboardInterrupt" in error
    _wait_until_still(tmp_path / "calls")
    kept = list((tmp_path / "kept").glob("[!.]*.npz"))
    assert 10 <= len(kept) < 60
    stamps = {path: path.stat().st_mtime_ns for path in kept}
    before = Counter((tmp_path / "calls").read_text().split())

    outcomes = run(squares(60, deed="nap", folder=str(tmp_path)), tmp_path / "kept")
    assert [int(o.arrays["value"]) for o in outcomes.values()] == [i**2 for i in range(60)]
    assert sum(o.resumed for o in outcomes.values()) == len(kept)
    assert stamps == {path: path.stat().st_mtime_ns for path in kept}
    # Only what was under way when the end came, at most two tasks and two that waited, ran twice.
    after = Counter((tmp_path / "calls").read_text().split())
    assert set(after) == {str(i) for i in range(60)}
    twice = {number for number, count in after.items() if count > 1}
    assert len(twice) <= 4
    assert twice <= set(before)


def _wait_until_still(path: Path) -> None:
    """Wait for workers to end with their parent: nothing is appended any more."""
    size, since = -1, time.monotonic()
    while time.monotonic() - since < 0.5:
        now = path.stat().st_size
        if now != size:
            size, since = now, time.monotonic()
        time.sleep(0.05)
