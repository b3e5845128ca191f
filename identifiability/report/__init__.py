"""Reports that a browser shows without a network."""
