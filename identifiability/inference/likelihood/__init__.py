"""Noise of a recording in both channels: its colour, its level, and what it does to a fit."""
