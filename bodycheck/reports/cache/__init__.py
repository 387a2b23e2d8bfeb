"""Cached engine answers and truths, and the journal of a run."""
