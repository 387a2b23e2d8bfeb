"""Tolerance gates: a file of bounds, each with its reason, checked against a run."""
