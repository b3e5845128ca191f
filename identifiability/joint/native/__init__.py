"""Responses with their derivatives in machine code: what a fit asks for one point at a time."""
