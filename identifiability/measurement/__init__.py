"""What was done to a joint, and what was seen: trials, and the files they come from."""
