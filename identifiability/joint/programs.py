"""Compiling with JAX what machine code does not know, and on how many threads to work."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import jax
import jax.numpy as jnp

# Such a program is called some hundred times. Costly passes save next to nothing here and take a
# third of the compiler's time; the newer emitters of fused loops take as long again; and handing
# the sums of a time step to a library of threaded kernels makes the step slower.
_QUICK: dict[str, bool | int | str] = {
    "xla_backend_optimization_level": 1,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_experimental_ynn_fusion_type": "LIBRARY_FUSION_TYPE_INVALID",
    "xla_cpu_use_fusion_emitters": False,
}

THREADS = 2
"""Threads that models are evaluated on side by side."""


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, whose first argument is static, with little optimisation.

    Parameters
    ----------
    function : callable
        Of a hashable static argument, then trees of arrays.
    """

    @cache
    def program() -> Callable[..., Any]:
        return jax.jit(function, static_argnums=0, compiler_options=_understood())

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return program()(*arguments)

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
