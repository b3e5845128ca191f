"""What is left, explained by Gaussian processes that no named effect stands behind."""
