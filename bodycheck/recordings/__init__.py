"""Trajectories that other programs recorded: their files, the map of their columns, their frames."""
