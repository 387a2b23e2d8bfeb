"""Engines in versions of their own: pins, environments, releases."""
