"""Engines that run only if requested by name, each in a separate environment if it is not installed."""
