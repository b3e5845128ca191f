"""The registry: every effect the package knows, by key."""

from identifiability.joint.effects.base import Effect, Motion
from identifiability.joint.effects.series_tendon import SeriesTendon

EFFECTS: dict[str, type[Effect]] = {effect.key: effect for effect in (SeriesTendon,)}

__all__ = ["EFFECTS", "Effect", "Motion", "SeriesTendon"]
