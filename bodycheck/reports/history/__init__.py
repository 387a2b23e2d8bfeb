"""What every night found, kept for good, and what tonight is beside it."""
