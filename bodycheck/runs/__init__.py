"""Runs: options, selection of cases, execution, storage in a folder, and choice of a stored run."""
