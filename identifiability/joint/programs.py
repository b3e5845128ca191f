"""Compiled programs: how they are compiled and kept, and the memory maps that they hold."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache, wraps
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from identifiability.joint.traced import Traced

# A search for effects compiles a hundred programs, and calls each some dozens of times. Costly
# passes save next to nothing here and take a third of the compiler's time; the newer emitters of
# fused loops take as long again; and handing the sums of a time step to a library of threaded
# kernels makes the step slower.
THREADS = 2
"""Threads that call compiled programs side by side: one program uses no more than a core or so."""

_QUICK: dict[str, bool | int | str] = {
    "xla_llvm_disable_expensive_passes": True,
    "xla_backend_optimization_level": 1,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_experimental_ynn_fusion_type": "",
}

_MAPS, _LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")

# Counting maps takes milliseconds; between two counts fewer are added than are left free.
_EVERY, _SHARE = 16, 0.6

_calls = count()

_kept: dict[Hashable, Callable[..., Any]] = {}
_locks: dict[Hashable, Lock] = {}
_guard = Lock()


def quickly_compiled(
    function: Callable[..., Any], traced: Traced | None = None
) -> Callable[..., Any]:
    """Compile a function, whose first argument is static, with little optimisation.

    Parameters
    ----------
    function : callable
        Of a hashable static argument, then trees of arrays.
    traced : Traced, optional
        Where it is kept as it was traced: tracing takes as long as reading what was compiled
        before.
    """

    @cache
    def compiled() -> Callable[..., Any]:
        return jax.jit(function, static_argnums=0, compiler_options=_understood())

    @wraps(function)
    def call(static: Hashable, *arguments: Any) -> Any:
        identity = traced and traced.identity(static)
        if traced is None or identity is None:
            return compiled()(static, *arguments)
        leaves, tree = jax.tree.flatten(arguments)
        leaves = [leaf if hasattr(leaf, "dtype") else np.asarray(leaf) for leaf in leaves]
        key = (function, static, tree, *((leaf.shape, str(leaf.dtype)) for leaf in leaves))
        with _guard:
            lock = _locks.setdefault(key, Lock())
        with lock:
            if key not in _kept:

                def flat(*leaves: Any) -> Any:
                    return function(static, *jax.tree.unflatten(tree, leaves))

                found = traced.program(f"{identity} {tree}", flat, leaves)
                _kept[key] = jax.jit(found, compiler_options=_understood())
            program = _kept[key]
        return program(*leaves)

    return call


@cache
def _understood() -> dict[str, bool | int | str]:
    """Those of the quick options that this version of the compiler knows."""
    kept = {}
    for name, value in _QUICK.items():
        try:
            jax.jit(lambda x: x, compiler_options={name: value})(jnp.zeros(())).block_until_ready()
        except RuntimeError:
            continue
        kept[name] = value
    return kept


def make_room() -> None:
    """Drop compiled programs before they use up the process's memory maps.

    Each holds about a hundred maps. Linux allows a process 65,530 by default, and the compiler
    aborts the process that asks for more: a long session, with models and records of many sizes,
    gets there. What is dropped is compiled again, or read from the cache on disk, when needed.
    """
    if next(_calls) % _EVERY == 0 and _nearly_full():
        _kept.clear()
        jax.clear_caches()


def _nearly_full() -> bool:
    try:
        limit = int(_LIMIT.read_text())
        with _MAPS.open("rb") as lines:
            return sum(1 for _ in lines) > _SHARE * limit
    except (OSError, ValueError):
        return False  # not Linux: nothing is known of such a limit
