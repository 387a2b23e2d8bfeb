"""Column names as words with units, for the headings of tables and the titles of axes."""

from __future__ import annotations

_HEADINGS = {
    "cpu_s": "CPU time, s",
    "ns_per_step": "time per step, ns",
    "order_low": "order, lower end",
    "order_high": "order, upper end",
    "growth_exponent": "growth exponent",
}

_UNITS = ("rad", "s")


def heading(column: str) -> str:
    """Return a column name as words, with its unit after a comma."""
    if column in _HEADINGS:
        return _HEADINGS[column]
    name, _, last = column.rpartition("_")
    text, unit = (name, f", {last}") if name and last in _UNITS else (column, "")
    return text.replace("_", " ") + unit
