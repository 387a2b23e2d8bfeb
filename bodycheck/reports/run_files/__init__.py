"""The files of a run: tables, trajectories, manifest; written, and read back."""
