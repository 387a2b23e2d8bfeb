"""Tolerance gates: a file of bounds with a reason each, and what a run has to say to them."""
