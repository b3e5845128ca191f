"""Programs of JAX, for models that machine code does not know."""

import jax.numpy as jnp

from identifiability.joint import programs


def test_options_that_the_compiler_does_not_know_are_left_out(monkeypatch):
    known = {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(programs, "_QUICK", known | {"no_such_option": True})
    programs._understood.cache_clear()
    try:
        assert programs._understood() == known
        twice = programs.compiled(lambda factor, x: factor * x)
        assert twice(2, jnp.ones(3)).tolist() == [2.0, 2.0, 2.0]
    finally:
        programs._understood.cache_clear()
