"""One module per kind of load."""
