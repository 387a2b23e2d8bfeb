"""Summaries of a run: its tables, cells, worst results and advice."""
