"""How fast bodycheck's mathematics is at a given error, beside engines and others: `python -m benchmarks`."""
