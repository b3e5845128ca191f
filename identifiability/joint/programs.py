"""Compiled programs: how they are compiled and kept, and the memory maps that they hold."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache, wraps
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from identifiability.joint.model import Model
from identifiability.joint.traced import Traced
from identifiability.provenance import code_fingerprint

# An investigation compiles dozens of programs, and calls each some dozens of times. Costly
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

_SHORTEST, _RATIO = 64, 1.25  # of the lengths that recordings are padded to

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
    def plain() -> Callable[..., Any]:
        return jax.jit(function, static_argnums=0, compiler_options=_understood())

    @wraps(function)
    def call(static: Hashable, *arguments: Any) -> Any:
        if traced is None:
            return plain()(static, *arguments)
        leaves, tree = jax.tree.flatten(arguments)
        leaves = [leaf if hasattr(leaf, "dtype") else np.asarray(leaf) for leaf in leaves]
        key = (function, static, tree, *((leaf.shape, str(leaf.dtype)) for leaf in leaves))
        program = _kept.get(key)
        if program is not None:
            return program(*leaves)
        identity = traced.identity(static)
        if identity is None:
            return plain()(static, *arguments)

        def flat(*leaves: Any) -> Any:
            return function(static, *jax.tree.unflatten(tree, leaves))

        with _guard:
            lock = _locks.setdefault(key, Lock())
        with lock:
            if key not in _kept:
                found = traced.program(f"{identity} {tree}", flat, leaves)
                _kept[key] = jax.jit(found, compiler_options=_understood())
            program = _kept[key]
        return program(*leaves)

    return call


class _OfModel(Protocol):
    """What a program of a model is specialised to; its representation says it all."""

    @property
    def model(self) -> Model: ...


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of a model and arrays, and keep on disk what was traced of it.

    Parameters
    ----------
    function : callable
        Of a named tuple with a model in it, then trees of arrays.
    """
    module = function.__module__
    return quickly_compiled(function, Traced(f"{module}.{function.__name__}", module, _identity))


def _identity(program: _OfModel) -> str | None:
    modules = sorted({type(effect).__module__ for effect in program.model.effects})
    if not all(module.startswith("identifiability.") for module in modules):
        return None
    return f"{program} {code_fingerprint(__name__, *modules)}"


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


def roomy(n: int) -> int:
    """One of few lengths that so many samples fit into.

    Where recordings have any length, a compiled program for each would take longer than the samples
    that are computed for nothing.
    """
    lengths = np.ceil(_SHORTEST * _RATIO ** np.arange(60)).astype(int)
    return int(lengths[np.searchsorted(lengths, n)])


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
