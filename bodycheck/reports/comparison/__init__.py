"""Compare two runs: pure functions of their tables, then text, Markdown and HTML."""
