"""Probes: short extra cases per method, which check its readings and its loads without the truth."""
