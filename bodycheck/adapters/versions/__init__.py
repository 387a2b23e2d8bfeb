"""Pinned versions of engines: pins, environments, releases."""
