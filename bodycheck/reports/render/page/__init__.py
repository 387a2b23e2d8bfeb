"""Build the data of the report's sections from a run."""
