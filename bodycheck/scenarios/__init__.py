"""Scenarios: the model, its TOML reader, and a library of built-in scenarios with sources."""
