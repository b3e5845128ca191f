"""Programs as they were traced, kept on disk beside what was compiled of them.

Tracing a model, with all its derivatives, is Python and takes as long as everything else that a
program costs once it was compiled before. What is kept is StableHLO, by JAX's own serialisation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jaxlib
from jax import export

from identifiability.errors import InputError
from identifiability.files import replacing
from identifiability.provenance import code_fingerprint

_FOLDER = "traced"
_LONG = 64  # from which a size is that of a recording, not of a model


def _open_shapes(arguments: Sequence[Any]) -> list[jax.ShapeDtypeStruct]:
    """Shapes in which what is long has any length, the same wherever it is the same here."""
    long = sorted({size for a in arguments for size in a.shape if size >= _LONG})
    scope = export.SymbolicScope([f"n{i} >= {_LONG}" for i in range(len(long))])
    return [
        jax.ShapeDtypeStruct(
            export.symbolic_shape(
                ", ".join(f"n{long.index(s)}" if s in long else str(s) for s in a.shape),
                scope=scope,
            ),
            a.dtype,
        )
        for a in arguments
    ]


@dataclass(frozen=True)
class Traced:
    """Traced programs of one function.

    Attributes
    ----------
    name, module : str
        Of the function.
    identity : callable
        Text that says all that a static argument stands for, its code included; None where no
        text does, as of an effect of one's own: that is traced anew.
    """

    name: str
    module: str
    identity: Callable[[Any], str | None]

    def program(
        self, identity: str, function: Callable[..., Any], arguments: Sequence[Any]
    ) -> Callable[..., Any]:
        """A function as it was traced for arrays of such shapes, now or earlier.

        Numbers of samples are left open, so that recordings of all lengths share it; it must not
        ask whether such a number equals another.

        Parameters
        ----------
        identity : str
            All that it depends on besides code and shapes.
        function : callable
            Of arrays.
        arguments : sequence of array
        """
        exact = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arguments]
        cache = getattr(jax.config, "jax_compilation_cache_dir", None)
        if not cache:
            return function  # nothing that is compiled is kept
        folder, shapes = Path(cache) / _FOLDER, (_open_shapes(arguments), exact)
        paths = {folder / self._digest(f"{identity} {s}"): s for s in shapes}
        for path in paths:
            try:
                return export.deserialize(bytearray(path.read_bytes())).call
            except Exception:
                continue  # not there, or not what this version of JAX wrote
        for path, specs in paths.items():
            try:
                exported = export.export(jax.jit(function))(*specs)
                written = exported.serialize()
            except Exception:
                continue  # not one for all lengths, or not to be kept
            # Where there is no room for it, it serves this process.
            with suppress(OSError, InputError), replacing(path) as temporary:
                temporary.write_bytes(written)
            return exported.call
        return function

    def _digest(self, text: str) -> str:
        """Name of a program's file."""
        parts = (
            self.name,
            code_fingerprint(self.module),
            jax.__version__,
            jaxlib.__version__,
            jax.default_backend(),
            text,
        )
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
