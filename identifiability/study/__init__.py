"""Question 1: can K, B and I fitted to a known joint be believed?"""
