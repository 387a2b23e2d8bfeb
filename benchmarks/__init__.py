"""Measure the speed of bodycheck at a given error against engines and solvers: `python -m benchmarks`."""
