"""Programs as they were traced, kept on disk beside what was compiled of them.

Tracing a model, with all its derivatives, is Python and takes as long as everything else that a
program costs once it was compiled before. What is kept is StableHLO, by JAX's own serialisation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jaxlib
from jax import export

from identifiability.files import replacing
from identifiability.provenance import code_fingerprint

_FOLDER = "traced"


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
        """A function as it was traced for arrays of these shapes, now or earlier.

        Parameters
        ----------
        identity : str
            All that it depends on besides code and shapes.
        function : callable
            Of arrays.
        arguments : sequence of array
        """
        shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in arguments]
        path = self._path(f"{identity} {shapes}")
        if path is None:
            return function
        try:
            return export.deserialize(bytearray(path.read_bytes())).call
        except Exception:
            pass  # not there, or not what this version of JAX wrote
        try:
            exported = export.export(jax.jit(function))(*shapes)
            with replacing(path) as temporary:
                temporary.write_bytes(exported.serialize())
        except (ValueError, OSError):
            return function  # not all that a compiler knows can be kept; nor has every disk room
        return exported.call

    def _path(self, text: str) -> Path | None:
        """File of a program; none where nothing that is compiled is kept."""
        cache = getattr(jax.config, "jax_compilation_cache_dir", None)
        if not cache:
            return None
        parts = (
            self.name,
            code_fingerprint(self.module),
            jax.__version__,
            jaxlib.__version__,
            jax.default_backend(),
            text,
        )
        digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
        return Path(cache) / _FOLDER / digest
