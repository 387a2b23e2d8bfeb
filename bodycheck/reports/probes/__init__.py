"""Probes: one short extra case per method, which checks its readings and its loads without the truth."""
