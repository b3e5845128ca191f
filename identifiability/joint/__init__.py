"""The joint: parameters, effects, models and their responses.

Models are computed in double precision; JAX is told so here, before any of them is traced.
"""

import jax

jax.config.update("jax_enable_x64", True)
