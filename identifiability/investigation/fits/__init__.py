"""Fits of models to the trials: what is fitted, from where, and kept once it is done."""
