"""Compiled programs are dropped before the process runs out of memory maps."""

from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from identifiability.joint import programs


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
