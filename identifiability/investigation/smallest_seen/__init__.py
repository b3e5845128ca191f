"""What would have been seen, where nothing is missing."""
