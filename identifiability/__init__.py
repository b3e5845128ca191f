"""Can the stiffness, damping and inertia fitted to a joint be believed?"""

from __future__ import annotations
