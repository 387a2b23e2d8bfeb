"""What the report shows, put together from a run: one idea a file."""
