"""Whether the stiffness, damping and inertia fitted to a joint can be believed.

The public names are those of ``__init__.pyi``; each is imported when it is first used, so that the
command line answers at once.
"""

from typing import Any

import lazy_loader

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from identifiability.provenance import package_version

        return package_version()
    return _public(name)
