"""What was found, in sentences: from results to words, and nowhere else."""
