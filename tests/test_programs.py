"""Compiled programs are kept as they were traced, and dropped before memory maps run out."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from identifiability.joint import programs
from identifiability.joint.effects import EFFECTS
from identifiability.joint.model import KBI
from identifiability.joint.response import Program
from identifiability.joint.traced import Traced


@pytest.fixture
def dropped(monkeypatch):
    """Count how often the caches are cleared."""
    calls = []
    monkeypatch.setattr(jax, "clear_caches", lambda: calls.append(1))
    return calls


def limit(tmp_path: Path, monkeypatch, maps: int) -> None:
    path = tmp_path / "max_map_count"
    path.write_text(f"{maps}\n")
    monkeypatch.setattr(programs, "_LIMIT", path)


def test_programs_are_dropped_near_the_limit(tmp_path, monkeypatch, dropped):
    limit(tmp_path, monkeypatch, 10)
    for _ in range(programs._EVERY):
        programs.make_room()
    assert len(dropped) == 1


def test_programs_are_kept_far_from_it(tmp_path, monkeypatch, dropped):
    limit(tmp_path, monkeypatch, 10**9)
    for _ in range(programs._EVERY):
        programs.make_room()
    assert not dropped


def test_without_the_limits_file_nothing_is_dropped(tmp_path, monkeypatch, dropped):
    monkeypatch.setattr(programs, "_LIMIT", tmp_path / "absent")
    for _ in range(programs._EVERY):
        programs.make_room()
    assert not dropped


@pytest.mark.skipif(not programs._MAPS.exists(), reason="memory maps are listed on Linux only")
def test_dropping_frees_maps():
    def maps() -> int:
        return len(programs._MAPS.read_bytes().splitlines())

    for n in range(2, 12):
        jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones(n)).block_until_ready()
    before = maps()
    jax.clear_caches()
    assert maps() < before


def test_options_that_the_compiler_does_not_know_are_left_out(monkeypatch):
    known = {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(programs, "_QUICK", known | {"no_such_option": True})
    programs._understood.cache_clear()
    try:
        assert programs._understood() == known
        twice = programs.quickly_compiled(lambda factor, x: factor * x)
        assert twice(2, jnp.ones(3)).tolist() == [2.0, 2.0, 2.0]
    finally:
        programs._understood.cache_clear()


@pytest.fixture
def kept(tmp_path):
    """A function whose programs are kept, and how often it was traced."""
    traced = []
    identity = {2: "two", 3: None}.get
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))

    def scaled(factor, x):
        traced.append(factor)
        return factor * jnp.sin(x)

    yield programs.quickly_compiled(scaled, Traced("scaled", __name__, identity)), traced
    jax.config.update("jax_compilation_cache_dir", before)


def forget():
    """What this process has compiled; what is on disk stays."""
    programs._kept.clear()


def test_a_program_is_traced_once(kept):
    scaled, traced = kept
    first = [scaled(2, np.linspace(0, 1, n)) for n in (5, 5, 6)]
    assert traced == [2, 2]
    forget()
    again = [scaled(2, np.linspace(0, 1, n)) for n in (5, 5, 6)]
    assert traced == [2, 2]
    assert [one.tobytes() for one in first] == [one.tobytes() for one in again]
    assert first[0] == pytest.approx(2 * np.sin(np.linspace(0, 1, 5)))


def test_recordings_of_all_lengths_share_what_was_traced(kept):
    scaled, traced = kept
    for n in (100, 200, 1000):
        x = np.linspace(0, 1, n)
        assert np.asarray(scaled(2, x)) == pytest.approx(2 * np.sin(x))
    assert traced == [2]


def test_what_depends_on_the_length_is_traced_for_each(kept):
    _, traced = kept

    def summed(static, x):
        traced.append(x.shape[0])
        return sum(x[i] for i in range(x.shape[0]))

    summed = programs.quickly_compiled(summed, Traced("summed", __name__, str))
    for _ in range(2):
        assert [float(summed(2, np.ones(n))) for n in (100, 101)] == [100, 101]
        forget()
    # Once for all lengths, in vain, and once for each.
    assert traced[1::2] == [100, 101]
    assert len(traced) == 4


def test_one_that_cannot_be_named_is_not_kept(kept, tmp_path):
    scaled, _ = kept
    assert scaled(3, np.ones(2)) == pytest.approx(3 * np.sin(1) * np.ones(2))
    assert not list((tmp_path / "traced").glob("*"))


def test_other_code_is_traced_anew(kept, monkeypatch):
    scaled, traced = kept
    scaled(2, np.ones(4))
    forget()
    monkeypatch.setattr("identifiability.joint.traced.code_fingerprint", lambda module: "other")
    scaled(2, np.ones(4))
    assert traced == [2, 2]


def test_a_damaged_file_is_traced_anew(kept, tmp_path):
    scaled, traced = kept
    before = scaled(2, np.ones(4))
    forget()
    (file,) = (tmp_path / "traced").iterdir()
    file.write_bytes(file.read_bytes()[:50])
    assert scaled(2, np.ones(4)).tobytes() == before.tobytes()
    forget()
    scaled(2, np.ones(4))
    assert traced == [2, 2]


def test_what_cannot_be_written_is_traced_once_all_the_same(kept, monkeypatch):
    scaled, traced = kept

    def full(path):
        raise OSError("no space left on device")

    monkeypatch.setattr("identifiability.joint.traced.replacing", full)
    assert scaled(2, np.ones(4)) == pytest.approx(2 * np.sin(1) * np.ones(4))
    assert traced == [2]


def test_an_effect_of_ones_own_is_not_kept():
    """Its code may be edited where no fingerprint sees it."""

    class Own(EFFECTS["cubic_stiffness"]):
        key = "own"

    of_the_package, own = (
        Program(KBI() + effect(), (0, 1, 2)) for effect in (EFFECTS["cubic_stiffness"], Own)
    )
    assert programs._identity(of_the_package)
    assert programs._identity(own) is None
    others = (of_the_package._replace(free=(0, 1)), of_the_package._replace(order=2))
    assert len({programs._identity(one) for one in (of_the_package, *others)}) == 3
