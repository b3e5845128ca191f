"""What was done to a joint, and what was seen: trials, and the files they come from."""

from identifiability.measurement.filtering import noise_cutoff
from identifiability.measurement.readers import parse_columns, read_trial
from identifiability.measurement.trials import Trial, onsets, quiet_lead
from identifiability.measurement.units import parse_unit

__all__ = [
    "Trial",
    "noise_cutoff",
    "onsets",
    "parse_columns",
    "parse_unit",
    "quiet_lead",
    "read_trial",
]
