"""Render a run as text, Markdown, HTML and figures."""
