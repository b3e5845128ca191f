"""Findings in words: the one place where data become sentences."""
