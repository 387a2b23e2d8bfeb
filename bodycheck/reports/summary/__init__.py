"""What a run comes to in short: its tables, cells, worst results and advice."""
