"""Which effects are believed to be missing: candidates added, judged, swapped and dropped."""
