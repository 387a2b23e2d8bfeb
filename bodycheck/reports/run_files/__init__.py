"""Write and read the files of a run: tables, trajectories and manifest."""
