"""Text, Markdown, HTML and figures of a run."""
