"""How probable every set of effects is, by one likelihood of the whole band of the recordings."""
