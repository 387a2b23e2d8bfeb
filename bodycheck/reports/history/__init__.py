"""Store nightly runs, and compare the newest with its baseline runs."""
