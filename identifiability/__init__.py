"""Whether the stiffness, damping and inertia fitted to a joint can be believed.

The public names are those of ``__init__.pyi``; each is imported when it is first used, so that the
command line answers at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
