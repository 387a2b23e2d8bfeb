"""Runs: what was requested, carried out, stored in a folder, chosen again."""
