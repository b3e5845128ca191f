"""In which kinds of perturbation a model fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from identifiability.investigation.where.by_trial import TrialView
from identifiability.investigation.where.scene import Scene


@dataclass(frozen=True, eq=False)
class ConditionView(TrialView):
    """Error of each kind of perturbation, as `TrialView` has that of each trial."""

    name: ClassVar[str] = "conditions"
    singular: ClassVar[str] = "kind of perturbation"
    plural: ClassVar[str] = "kinds of perturbation"
    width: ClassVar[int] = 1

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Test the residual of every kind of perturbation."""
        names = dict.fromkeys(load.condition for load in scene.loads)
        return cls.of_groups(
            scene,
            [
                (name, [i for i, load in enumerate(scene.loads) if load.condition == name])
                for name in names
            ],
        )
