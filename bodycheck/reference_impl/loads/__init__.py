"""Loads that vary with time and motion, and what any load does at an instant."""
