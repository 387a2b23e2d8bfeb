"""What changed between two runs: pure functions of their tables, then the words and the page."""
