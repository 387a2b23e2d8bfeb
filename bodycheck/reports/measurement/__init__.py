"""Measures of one case, and verdicts from all cases of a method."""
