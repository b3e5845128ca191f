"""The registry: every view of where a model fails, in the order in which they are shown."""

from identifiability.investigation.where.by_amplitude import AmplitudeView
from identifiability.investigation.where.by_condition import ConditionView
from identifiability.investigation.where.by_direction import DirectionView
from identifiability.investigation.where.by_trial import TrialView
from identifiability.investigation.where.in_frequency import FrequencyView
from identifiability.investigation.where.in_state import StateView
from identifiability.investigation.where.in_time import TimeView
from identifiability.investigation.where.view import View

VIEWS: tuple[type[View], ...] = (
    TimeView,
    FrequencyView,
    StateView,
    DirectionView,
    AmplitudeView,
    TrialView,
    ConditionView,
)
