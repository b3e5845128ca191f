"""Several records of one joint.

- `weighed`: which effects are missing, by the evidence of all records.
- `alone`, `together`: one model fitted to each record, and to all with some parameters shared.
- `agreement`: whether the records agree in what should be the same, and predict each other.
"""
