"""The cause of a wrong motion: candidate faults, fitted to the trajectory of a case."""
