"""Question 1: whether K, B and I fitted to a known joint can be believed."""
