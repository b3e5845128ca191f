"""Compiled loops: what is kept of them belongs to the sources of all."""

import shutil
from pathlib import Path

import numba
import numpy as np
import pytest

from identifiability import loops
from identifiability.joint.native.duals import exponential
from identifiability.joint.native.steps import integrated
from identifiability.loops import compiled_loop, stamp

PACKAGE = Path(loops.__file__).parent


@pytest.mark.parametrize("callee", ["joint/native/duals.py", "inference/likelihood/banded.py"])
def test_what_calls_an_edited_loop_is_compiled_anew(callee, tmp_path):
    for pattern in loops._LOOPS:
        for path in PACKAGE.glob(pattern):
            copy = tmp_path / path.relative_to(PACKAGE)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    assert stamp(tmp_path) == stamp()
    with (tmp_path / callee).open("a") as edited:
        edited.write("# edited\n")
    assert stamp(tmp_path) != stamp()


def test_every_file_with_loops_has_a_say():
    with_loops = {p for p in PACKAGE.rglob("*.py") if "import compiled_" in p.read_text()}
    assert len(with_loops) > 5
    assert with_loops <= {p for pattern in loops._LOOPS for p in PACKAGE.glob(pattern)}


def test_they_are_kept_under_that_stamp():
    for loop in (exponential, integrated):
        assert stamp() in loop._cache.cache_path


def test_without_a_folder_they_are_compiled_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    before = numba.config.CACHE_DIR

    @compiled_loop
    def twice(x):
        return 2 * x

    assert twice(np.ones(2)).tolist() == [2.0, 2.0]
    assert before == numba.config.CACHE_DIR
