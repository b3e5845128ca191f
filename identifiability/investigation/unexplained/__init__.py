"""The torque that a model lacks and its kind, with no effect named: Gaussian processes."""
