"""Files of measured torque and angle, read into trials: one file a format, one line in the table.

- `formats`: the table, and what a reader has to do; how to add one.
- `text`, `opensim`, `bids`, `hdf5`, `matlab` (`matlab5`, `matlab73`), `c3d`, `tdms`: the formats.
- `apart`: parsers that a damaged file may end, in a process of their own.
- `variables`: one of the variables that a file holds.
- `tables`, `columns`: a file's columns as they were written; which of them hold what, in what unit.
- `trial_file`: from a file to a trial, whatever its format.
"""
