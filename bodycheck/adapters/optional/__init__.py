"""Engines that run only if requested by name, each in an environment of its own where it is not installed."""
