"""Probes: short additional cases of each method, which check its readings and its loads without the truth."""
