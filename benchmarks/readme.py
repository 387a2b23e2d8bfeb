"""`python -m benchmarks.readme`: put the table of benchmarks/results.csv into the README."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.store import read_results

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->\n"

# the figures in the README, in its order
_SHOWN = (
    "free.time",
    "forced.constant-body-torque.time",
    "against.MuJoCo-rk4.free.1e-09",
    "against.MuJoCo-rk4.free.1e-12",
    "against.MuJoCo-rk4.constant-world-torque.1e-12",
    "against.scipy-DOP853.free.1e-12",
    "against.heyoka-Taylor.free.1e-12",
    "against.heyoka-Taylor.constant-world-torque.1e-12",
    "batch.rk4",
    "truth.time",
    "mesh.time",
)


def terminal_table(results: pd.DataFrame) -> str:
    """Return one line per figure, including misses, with a dash if it was not measured."""
    rows = [
        (row["verdict"], _value(row) if pd.notna(row["value"]) else "-", row["target"], row["what"])
        for _, row in results.iterrows()
    ]
    rows = [("verdict", "measured", "target", "what"), *rows]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    lines = ["  ".join([*(c.ljust(w) for c, w in zip(row[:3], widths, strict=True)), row[3]]) for row in rows]
    counts = results["verdict"].value_counts()
    totals = ", ".join(
        f"{counts[word]} {word}" for word in ("pass", "miss", "not measured") if word in counts
    )
    return "\n".join([*lines, totals] if totals else lines)


def markdown_table(results: pd.DataFrame) -> str:
    """Return the table for the README: the figures of _SHOWN that were measured."""
    by_name = {row["figure"]: row for _, row in results.iterrows()}
    rows = [by_name[name] for name in _SHOWN]
    lines = [
        f"| {row['what']} | {_value(row)} | {_number(row['low'])} - {_number(row['high'])} |"
        for row in rows
        if pd.notna(row["value"])
    ]
    return "\n".join(["| what | measured | quartiles |", "|---|---|---|", *lines, ""])


def _value(row: pd.Series[Any]) -> str:
    return f"{_number(row['value'])} {row['unit']}".strip()


def _number(value: float) -> str:
    """Return the value to three digits; empty if not measured."""
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e5 else f"{value:.3g}"


def with_table(page: str, table: str) -> str:
    """Return the page with the text between its two markers replaced by the table."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page needs the markers {BEGIN.strip()} and {END.strip()}, in this order")
    return f"{before}{BEGIN}{table}{END}{after}"


def main() -> None:
    """Rewrite README.md in place."""
    argparse.ArgumentParser(prog="python -m benchmarks.readme", description=__doc__).parse_args()
    page = ROOT / "README.md"
    table = markdown_table(read_results(ROOT / "benchmarks"))
    page.write_text(with_table(page.read_text(encoding="utf-8"), table), encoding="utf-8")


if __name__ == "__main__":
    main()
