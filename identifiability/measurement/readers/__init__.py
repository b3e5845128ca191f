"""Files of measured torque and angle, read into trials: one file a format, one line in the table.

- `formats`: the table, and what a reader has to do; how to add one.
- `text`, `opensim`, `hdf5`, `matlab`, `matlab5`, `matlab73`: the formats.
- `variables`: one of the variables that a file holds.
- `tables`, `columns`: a file's columns as they were written; which of them hold what, in what unit.
- `trial_file`: from a file to a trial, whatever its format.
"""

from identifiability.measurement.readers.columns import parse_columns
from identifiability.measurement.readers.formats import READERS, Reader, readable_files
from identifiability.measurement.readers.tables import Options, Table
from identifiability.measurement.readers.trial_file import read_trial

__all__ = ["READERS", "Options", "Reader", "Table", "parse_columns", "read_trial", "readable_files"]
